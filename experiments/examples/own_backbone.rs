//! `sage` with your own backbone made of ready layers of candle-nn: it scores goals by their features alone.
//!
//! ```sh
//! cargo run --release -p experiments --example own_backbone -- pretrain --backbone goal-scorer \
//!     --procedural 20 --epochs 2 --out own-prior
//! ```

use std::{process::ExitCode, sync::Arc};

use sage_backbones::{
    Backbone, Error, MotionModel, Parameters, Trainable,
    backbone::{Definition, Loss, ParameterGroup, Sample},
    candle::{Module as _, Result as CandleResult, Tensor},
    candle_nn::{LayerNorm, LayerNormConfig, Linear, layer_norm, linear, linear_no_bias},
    encoding::Encoding,
    features::{Features, GOAL_COLUMNS},
    labels,
    nn::log_softmax,
    parameters::Scope,
    smooth_path,
};
use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

const WIDTH: usize = 32;

/// Layers take their tensors from a `VarBuilder` of the scope. A layer norm without bias passes gradients; candle's with one does not.
fn layers(scope: &Scope) -> CandleResult<(Linear, LayerNorm, Linear)> {
    let vb = scope.var_builder();
    let without_bias = LayerNormConfig { affine: false, ..LayerNormConfig::default() };
    let first = linear(GOAL_COLUMNS, WIDTH, vb.pp("first"))?;
    let norm = layer_norm(WIDTH, without_bias, vb.pp("norm"))?;
    // A bias would add the same to all goals.
    Ok((first, norm, linear_no_bias(WIDTH, 1, vb.pp("last"))?))
}

struct GoalScorer(Definition);

impl Backbone for GoalScorer {
    fn definition(&self) -> &Definition {
        &self.0
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self(self.0.with(parameters))))
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        let goals = self.0.tensor(&features.goal_features)?;
        Ok(Encoding::new(self.tag(), features, vec![goals]))
    }

    fn trainable(&self) -> Option<&dyn Trainable> {
        Some(self)
    }
}

impl MotionModel for GoalScorer {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let [goals] = encoding.states_of(self.tag())?;
        let (first, norm, last) = layers(&self.0.scope())?;
        let scores = last.forward(&norm.forward(&first.forward(goals)?)?.gelu()?)?;
        Ok(log_softmax(&scores.squeeze(1)?)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        Ok(encoding.features().goals.clone())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let features = encoding.features();
        let ends: Vec<[f32; 2]> = modes.iter().map(|&mode| features.goals[mode]).collect();
        let size = ends.len() * smooth_path::CHANGES;
        let straight = self.0.constant(&vec![0.0; size], (ends.len(), smooth_path::CHANGES))?;
        Ok(smooth_path::paths(&straight, &ends, features.velocity[0])?)
    }
}

impl Trainable for GoalScorer {
    fn group_of(&self, _: &str) -> ParameterGroup {
        ParameterGroup::Scoring
    }

    fn loss(&self, sample: &Sample, _: &mut Rng) -> Result<Loss, Error> {
        let log_probs = self.log_probs(&self.encode(sample.features.clone())?)?;
        let weights = labels::soft(&sample.features.goals, labels::end(&sample.future, &sample.valid));
        Loss::of(vec![("goal", labels::cross_entropy(&log_probs, &weights)?)])
    }
}

impl Entry<dyn Backbone> for GoalScorer {
    const NAME: &'static str = "goal-scorer";
    const SUMMARY: &'static str = "goals scored by their features alone";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(options: NoOptions) -> Result<Box<dyn Backbone>, String> {
        Ok(Box::new(Self(Definition::of::<Self, _>(&options, 0, layers)?)))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.backbones = registries.parts.backbones.with::<GoalScorer>()?;
        Ok(registries)
    })
}
