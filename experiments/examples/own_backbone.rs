//! `sage` with your own backbone. It scores goals by their features alone. The trajectory to a goal is the
//! initial trajectory of smooth heads, without learned changes.
//!
//! ```sh
//! cargo run --release -p experiments --example own_backbone -- pretrain --backbone goal-scorer \
//!     --procedural 20 --epochs 2 --out own-prior
//! ```

use std::{process::ExitCode, sync::Arc};

use sage_backbones::{
    Backbone, Error, MotionModel, Parameters, Trainable,
    backbone::{Loss, ParameterGroup, Sample, tensor},
    candle::{Module as _, Result as CandleResult, Tensor},
    encoding::Encoding,
    features::{Features, GOAL_COLUMNS},
    labels,
    nn::{Linear, Mlp, log_softmax},
    parameters::{ParameterSpec, Scope},
    smooth_path,
};
use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};
use serde_json::Value;

#[derive(Clone, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Options {
    /// Width of the hidden layers.
    hidden: usize,
    /// Seed of the initial weights.
    seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { hidden: 32, seed: 0 }
    }
}

/// The layers. A [`Scope`] gives their parameters by name, so one constructor lists, initialises and loads
/// them.
struct Layers {
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl Layers {
    fn new(scope: &Scope, hidden: usize) -> CandleResult<Self> {
        Ok(Self {
            first: Mlp::new(&scope.at("first"), GOAL_COLUMNS, hidden)?,
            second: Mlp::new(&scope.at("second"), hidden, hidden)?,
            last: Linear::new(&scope.at("last"), hidden, 1)?,
        })
    }
}

struct GoalScorer {
    options: Options,
    json: Value,
    specs: Arc<[ParameterSpec]>,
    parameters: Parameters,
    layers: Layers,
}

impl GoalScorer {
    fn over(options: Options, specs: Arc<[ParameterSpec]>, parameters: Parameters) -> Result<Self, Error> {
        let layers = Layers::new(&Scope::of(&parameters), options.hidden)?;
        let json = serde_json::to_value(&options).unwrap_or_default();
        Ok(Self { options, json, specs, parameters, layers })
    }
}

impl Backbone for GoalScorer {
    fn name(&self) -> &'static str {
        <Self as Entry<dyn Backbone>>::NAME
    }

    fn options(&self) -> &Value {
        &self.json
    }

    fn parameter_specs(&self) -> &[ParameterSpec] {
        &self.specs
    }

    fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self::over(self.options.clone(), self.specs.clone(), parameters)?))
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        let goals = tensor(&features.goal_features, self.layers.last.weight.dtype())?;
        Ok(Encoding::new(self.tag(), features, vec![goals]))
    }

    fn trainable(&self) -> Option<&dyn Trainable> {
        Some(self)
    }
}

impl MotionModel for GoalScorer {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let [goals] = encoding.states_of(self.tag())?;
        let hidden = self.layers.second.forward(&self.layers.first.forward(goals)?)?;
        Ok(log_softmax(&self.layers.last.forward(&hidden)?.squeeze(1)?)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        Ok(encoding.features().goals.clone())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let [goals] = encoding.states_of(self.tag())?;
        let features = encoding.features();
        let ends: Vec<[f32; 2]> = modes.iter().map(|&mode| features.goals[mode]).collect();
        let changes = Tensor::zeros((modes.len(), smooth_path::CHANGES), goals.dtype(), goals.device())?;
        Ok(smooth_path::paths(&changes, &ends, features.velocity[0])?)
    }
}

impl Trainable for GoalScorer {
    fn group_of(&self, name: &str) -> ParameterGroup {
        // The softmax over goals does not change if the same value is added to every goal.
        if name == "last.bias" { ParameterGroup::WithoutEffect } else { ParameterGroup::Scoring }
    }

    fn loss(&self, sample: &Sample) -> Result<Loss, Error> {
        let encoding = self.encode(sample.features.clone())?;
        let end = labels::end(&sample.future, &sample.valid);
        let weights = labels::soft(&sample.features.goals, end);
        Loss::of(vec![("goal", labels::cross_entropy(&self.log_probs(&encoding)?, &weights)?)])
    }
}

impl Entry<dyn Backbone> for GoalScorer {
    const NAME: &'static str = "goal-scorer";
    const SUMMARY: &'static str = "goals scored by their features alone";
    const SOURCE: &'static str = "this example";
    type Options = Options;

    fn build(options: Options) -> Result<Box<dyn Backbone>, String> {
        if options.hidden == 0 {
            return Err("`hidden` must be above 0".to_owned());
        }
        let build = || {
            let specs = Scope::list(|scope| Layers::new(scope, options.hidden))?;
            let parameters = Parameters::start(&specs, options.seed)?;
            Self::over(options.clone(), specs.into(), parameters)
        };
        Ok(Box::new(build().map_err(|e| e.to_string())?))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.backbones = registries.parts.backbones.with::<GoalScorer>()?;
        Ok(registries)
    })
}
