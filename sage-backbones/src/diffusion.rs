//! Diffusion: futures drawn by removing noise, each with a path and a timing of its own.
//!
//! A future is eight coefficients. They are mixed with noise along a straight line, `x_t = (1 − t) x_0 + t ε`,
//! and the network predicts `x_0` from `x_t`, the scene and the lanes about the end of `x_t`. A mode is the future that a fixed noise
//! leads to in a few steps, `x_s = x̂_0 + (s / t) (x_t − x̂_0)` (DDIM, Song et al. 2021; on this line it is the rule of Euler for
//! flow matching, Lipman et al. 2023). All modes are equally likely.
//!
//! Fine-tuning changes what the noise leads to (Diffusion-DPO, Wallace et al. 2024): experts share encodings and no trajectories.

mod coefficients;

use std::sync::Arc;

use candle_core::{DType, Module, Tensor};
use sage_core::{generator::Observation, registry::Entry, seed::Rng};
use serde::{Deserialize, Serialize};

use crate::{
    Error, Parameters,
    backbone::{
        Backbone, Definition, Loss, MotionModel, ParameterGroup, Sample, Shared, Trainable,
        TrajectoryLikelihood, of_modes,
    },
    encoder::{Encoder, check_size},
    encoding::{Encoding, ModelId},
    features::{EdgeKinds, EgoForecast, Features, GOAL_COLUMNS, VECTOR_COLUMNS},
    labels,
    nn::{Attention, Linear, Mlp},
    parameters::Scope,
};
use coefficients::COEFFICIENTS;

/// Numbers that tell the network how much noise there is.
const TIMES: usize = 5;
/// Numbers that tell it where the end lies beside the nearest goal.
const OFFSETS: usize = 2;
/// Metres of such an offset that are 1.
const UNIT: f32 = 5.0;
/// Noises of one sample of pretraining.
const DRAWS: usize = 16;
/// Least share of noise in training; what is below is no task.
const LEAST_NOISE: f64 = 0.02;
/// Margin of a pair for a difference of 1 in the squared errors of its coefficients.
const PER_ERROR: f64 = 100.0;

/// Options of [`Diffusion`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiffusionOptions {
    /// Width of the states, even.
    pub hidden: usize,
    /// Rounds of attention among agents and map.
    pub rounds: usize,
    /// Attention layers of the denoiser.
    pub layers: usize,
    /// Number of modes.
    pub samples: usize,
    /// Steps from noise to a future.
    pub steps: usize,
    /// Edges in the features.
    pub edges: EdgeKinds,
    /// Seed of the initial weights and of the noise of the modes.
    pub seed: u64,
}

impl Default for DiffusionOptions {
    fn default() -> Self {
        Self {
            hidden: 64,
            rounds: 2,
            layers: 2,
            samples: 128,
            steps: 8,
            edges: EdgeKinds::default(),
            seed: 0,
        }
    }
}

/// The diffusion network.
pub struct Diffusion {
    id: ModelId,
    definition: Definition,
    shape: DiffusionOptions,
    parts: Parts,
}

struct Parts {
    encoder: Encoder,
    input: Mlp,
    layers: Vec<Layer>,
    output: Linear,
}

/// `x + mlp([target ; x ; attention to the scene])`.
struct Layer {
    scene: Attention,
    mlp: Mlp,
}

impl Parts {
    fn new(scope: &Scope, shape: &DiffusionOptions) -> candle_core::Result<Self> {
        let width = shape.hidden;
        let denoiser = scope.at("denoiser");
        let layer = |k: usize| {
            let scope = denoiser.at("layers").at(k);
            Ok(Layer {
                scene: Attention::across(&scope.at("scene"), width, width)?,
                mlp: Mlp::new(&scope.at("mlp"), 3 * width, width)?,
            })
        };
        let inputs = width + COEFFICIENTS + TIMES + OFFSETS + GOAL_COLUMNS;
        Ok(Self {
            encoder: Encoder::new(scope, VECTOR_COLUMNS, width, Some(shape.rounds))?,
            input: Mlp::new(&denoiser.at("input"), inputs, width)?,
            layers: (0..shape.layers).map(layer).collect::<candle_core::Result<_>>()?,
            output: Linear::new(&denoiser.at("output"), width, COEFFICIENTS)?,
        })
    }
}

impl Diffusion {
    fn over(definition: Definition, shape: DiffusionOptions) -> Result<Self, Error> {
        let parts = Parts::new(&definition.scope(), &shape)?;
        Ok(Self { id: ModelId::unique(), definition, shape, parts })
    }

    fn constant(&self, values: Vec<f32>, columns: usize) -> candle_core::Result<Tensor> {
        self.definition.constant(&values, (values.len() / columns, columns))
    }

    /// The futures that the network believes in, from noisy ones and their shares of noise.
    ///
    /// *Shapes*: `noisy` (n, 8), `times` n; result (n, 8).
    fn denoised(&self, encoding: &Encoding, noisy: &Tensor, times: &[f64]) -> Result<Tensor, Error> {
        let [elements, target] = encoding.states_of(self.tag())?;
        let known =
            self.constant(inputs(encoding.features(), noisy, times)?, TIMES + OFFSETS + GOAL_COLUMNS)?;
        let mut x = self.parts.input.forward_parts(&[target], &[noisy, &known])?;
        for layer in &self.parts.layers {
            let scene = layer.scene.forward(&x, elements)?;
            let change = layer.mlp.forward_parts(&[target], &[&x, &scene])?;
            x = (x + change)?;
        }
        Ok(self.parts.output.forward(&x)?)
    }

    /// The coefficients of all modes, computed once an encoding.
    ///
    /// *Shapes*: (samples, 8).
    fn futures(&self, encoding: &Encoding) -> Result<Arc<Tensor>, Error> {
        encoding.keep(self.id, || self.drawn(encoding))
    }

    fn drawn(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let DiffusionOptions { samples, steps, seed, .. } = self.shape;
        let noise = (0..samples).flat_map(|mode| {
            let mut rng = Rng::new(seed, &mode.to_string(), "noise of a mode");
            std::array::from_fn::<f32, COEFFICIENTS, _>(|_| rng.normal() as f32)
        });
        let mut x = self.constant(noise.collect(), COEFFICIENTS)?;
        for step in (1..=steps).rev() {
            let [time, next] = [step, step - 1].map(|step| step as f64 / steps as f64);
            let clean = self.denoised(encoding, &x, &vec![time; samples])?;
            x = (&clean + ((x - &clean)? * (next / time))?)?;
        }
        Ok(x)
    }

    /// Squared errors of what is denoised from futures that get noise, summed over the coefficients.
    ///
    /// *Shapes*: `clean` and `noise` (n, 8), `times` n; result (n).
    fn errors(
        &self,
        encoding: &Encoding,
        clean: &Tensor,
        noise: &Tensor,
        times: &[f64],
    ) -> Result<Tensor, Error> {
        let shares: Vec<f32> = times.iter().map(|time| *time as f32).collect();
        let shares = self.constant(shares, 1)?;
        let noisy = (clean + (noise - clean)?.broadcast_mul(&shares)?)?;
        Ok((self.denoised(encoding, &noisy, times)? - clean)?.sqr()?.sum(1)?)
    }

    /// Noise for some futures, and its shares, spread evenly.
    fn noise(&self, count: usize, rng: &mut Rng) -> candle_core::Result<(Tensor, Vec<f64>)> {
        let times = (0..count).map(|k| {
            let share = (k as f64 + rng.unit()) / count as f64;
            LEAST_NOISE + (1.0 - LEAST_NOISE) * share
        });
        let times = times.collect();
        let noise = (0..count * COEFFICIENTS).map(|_| rng.normal() as f32).collect();
        Ok((self.constant(noise, COEFFICIENTS)?, times))
    }
}

/// What the network is told of noisy futures: their share of noise, and the goal nearest to their end.
fn inputs(features: &Features, noisy: &Tensor, times: &[f64]) -> Result<Vec<f32>, Error> {
    let noisy = noisy.detach().to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    let ends = coefficients::ends(&noisy, features.velocity);
    let mut out = Vec::with_capacity(ends.len() * (TIMES + OFFSETS + GOAL_COLUMNS));
    for (end, time) in ends.iter().zip(times) {
        let angle = std::f64::consts::FRAC_PI_2 * time;
        out.extend(
            [*time, angle.sin(), angle.cos(), (4.0 * angle).sin(), (4.0 * angle).cos()].map(|x| x as f32),
        );
        if features.goals.is_empty() {
            out.extend([0.0; OFFSETS + GOAL_COLUMNS]);
            continue;
        }
        let goal = labels::nearest(&features.goals, *end);
        // Far from all goals the distance says nothing more.
        out.extend([0, 1].map(|k| ((end[k] - features.goals[goal][k]) / UNIT).clamp(-4.0, 4.0)));
        out.extend(features.goal_features.row(goal));
    }
    Ok(out)
}

impl Backbone for Diffusion {
    fn definition(&self) -> &Definition {
        &self.definition
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self::over(self.definition.with(parameters), self.shape.clone())?))
    }

    fn features(
        &self,
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
    ) -> Result<Features, Error> {
        Features::of(now, target, ego, self.shape.edges)
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        let vectors = self.definition.tensor(&features.vectors)?;
        let encoded = self.parts.encoder.forward(&vectors, &features.groups, features.agents, 0)?;
        Ok(Encoding::new(self.tag(), features, vec![encoded.elements, encoded.target]))
    }

    fn shared(&self) -> Shared {
        Shared::Encodings
    }

    fn trainable(&self) -> Option<&dyn Trainable> {
        Some(self)
    }
}

impl Trainable for Diffusion {
    fn group_of(&self, name: &str) -> ParameterGroup {
        match name {
            _ if name.starts_with("rounds.") && name.ends_with("key.bias") => ParameterGroup::Unused,
            _ if name.ends_with("key.bias") => ParameterGroup::WithoutEffect,
            _ if name.starts_with("denoiser.") => ParameterGroup::Scoring,
            _ => ParameterGroup::Prior,
        }
    }

    fn mirrored(&self, features: &Features) -> Option<Features> {
        Some(features.mirrored())
    }

    fn loss(&self, sample: &Sample, rng: &mut Rng) -> Result<Loss, Error> {
        let encoding = self.encode(sample.features.clone())?;
        let clean = coefficients::of_future(&sample.future, &sample.valid, sample.features.velocity);
        let clean = self.constant(clean.repeat(DRAWS), COEFFICIENTS)?;
        let (noise, times) = self.noise(DRAWS, rng)?;
        let errors = self.errors(&encoding, &clean, &noise, &times)?;
        Loss::of(vec![("trajectory", (errors.mean_all()? / COEFFICIENTS as f64)?)])
    }

    fn trajectory_likelihood(&self) -> Option<&dyn TrajectoryLikelihood> {
        Some(self)
    }
}

impl TrajectoryLikelihood for Diffusion {
    fn log_likelihoods(
        &self,
        encoding: &Encoding,
        trajectories: &Tensor,
        rng: &mut Rng,
    ) -> Result<Tensor, Error> {
        let clean = coefficients::of_trajectories(trajectories, encoding.features().velocity)?;
        let (noise, times) = self.noise(clean.dim(0)?, rng)?;
        Ok((self.errors(encoding, &clean, &noise, &times)? * -PER_ERROR)?)
    }
}

impl MotionModel for Diffusion {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        encoding.states_of::<2>(self.tag())?;
        let each = -(self.shape.samples as f64).ln();
        Ok(self.definition.constant(&vec![each; self.shape.samples], self.shape.samples)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        let futures =
            self.futures(encoding)?.detach().to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
        Ok(coefficients::ends(&futures, encoding.features().velocity))
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let futures = of_modes(&*self.futures(encoding)?, modes)?;
        Ok(coefficients::trajectories(&futures, encoding.features().velocity)?)
    }
}

impl Entry<dyn Backbone> for Diffusion {
    const NAME: &'static str = "diffusion";
    const SUMMARY: &'static str =
        "futures drawn by removing noise, each with its own timing; experts have their own";
    const SOURCE: &'static str =
        "after Jiang et al. 2023 (MotionDiffuser), Wallace et al. 2024 (Diffusion-DPO)";
    type Options = DiffusionOptions;

    fn build(options: DiffusionOptions) -> Result<Box<dyn Backbone>, String> {
        let DiffusionOptions { hidden, rounds, layers, samples, steps, seed, .. } = options;
        check_size(hidden, rounds)?;
        for (name, value, most) in
            [("layers", layers, 16), ("samples", samples, 4096), ("steps", steps, 1000)]
        {
            if !(1..=most).contains(&value) {
                return Err(format!("`{name}` is {value}; expected 1 to {most}"));
            }
        }
        let definition = Definition::of::<Self, _>(&options, seed, |scope| Parts::new(scope, &options))?;
        Ok(Box::new(Self::over(definition, options)?))
    }
}
