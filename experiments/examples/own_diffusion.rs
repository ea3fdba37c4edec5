//! `sage` with a diffusion network of your own, of which each expert encodes and draws for itself.
//!
//! ```sh
//! cargo run --release -p experiments --example own_diffusion -- pretrain --backbone waypoint-diffusion --out own-prior
//! cargo run --release -p experiments --example own_diffusion -- finetune --prior own-prior --out own-experts
//! ```

use std::{process::ExitCode, sync::Arc};

use sage_backbones::{
    Backbone, Error, MotionModel, Parameters, Trainable,
    backbone::{Definition, Loss, ParameterGroup, Sample, Shared, TrajectoryLikelihood, of_modes},
    candle::{D, Device, Module as _, Result as CandleResult, Tensor},
    encoding::{Encoding, ModelId},
    features::{Features, VECTOR_COLUMNS},
    nn::{Linear, Mlp},
    parameters::Scope,
};
use sage_core::{
    motion::{DT, HORIZON},
    registry::{Entry, NoOptions},
    seed::Rng,
};

/// Numbers of a future: where it is after 4 and 8 s, beside the motion at constant velocity.
const NUMBERS: usize = 4;
/// Metres that are 1.
const UNIT: f32 = 10.0;
/// Steps of the two waypoints, counted from 0.
const WAYPOINTS: [usize; 2] = [HORIZON / 2 - 1, HORIZON - 1];
/// Noises of one training sample.
const DRAWS: usize = 16;
/// Width of the layers, number of modes, and of steps from noise to a future.
const HIDDEN: usize = 64;
const SAMPLES: usize = 64;
const STEPS: usize = 6;

struct Layers {
    rows: Mlp,
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl Layers {
    fn new(scope: &Scope) -> CandleResult<Self> {
        Ok(Self {
            rows: Mlp::new(&scope.at("rows"), VECTOR_COLUMNS, HIDDEN)?,
            // The scene, the noisy future, and how much noise there is.
            first: Mlp::new(&scope.at("first"), HIDDEN + NUMBERS + 1, HIDDEN)?,
            second: Mlp::new(&scope.at("second"), HIDDEN, HIDDEN)?,
            last: Linear::new(&scope.at("last"), HIDDEN, NUMBERS)?,
        })
    }
}

struct WaypointDiffusion {
    id: ModelId,
    definition: Definition,
    layers: Layers,
}

impl WaypointDiffusion {
    fn over(definition: Definition) -> Result<Self, Error> {
        let layers = Layers::new(&definition.scope())?;
        Ok(Self { id: ModelId::unique(), definition, layers })
    }

    /// Futures without their noise (n, 4), of which the shares `times` (n, 1) are noise.
    fn denoised(&self, encoding: &Encoding, noisy: &Tensor, times: &Tensor) -> Result<Tensor, Error> {
        let [scene] = encoding.states_of(self.tag())?;
        let hidden = self.layers.first.forward_parts(&[scene], &[noisy, times])?;
        Ok(self.layers.last.forward(&self.layers.second.forward(&hidden)?)?)
    }

    /// Squared errors of what is denoised (n) from futures (n, 4) that get noise.
    fn errors(&self, encoding: &Encoding, clean: &Tensor, rng: &mut Rng) -> Result<Tensor, Error> {
        let count = clean.dim(0)?;
        let times: Vec<f32> = (0..count).map(|_| rng.uniform(0.02, 1.0) as f32).collect();
        let times = Tensor::from_vec(times, (count, 1), &Device::Cpu)?;
        let noisy = (clean + (noise(count, rng)? - clean)?.broadcast_mul(&times)?)?;
        Ok((self.denoised(encoding, &noisy, &times)? - clean)?.sqr()?.sum(D::Minus1)?)
    }

    /// The futures of all modes (samples, 4): where fixed noises lead. They are kept with the encoding.
    fn futures(&self, encoding: &Encoding) -> Result<Arc<Tensor>, Error> {
        encoding.keep(self.id, || {
            let mut x = noise(SAMPLES, &mut Rng::new(0, "modes", "noise"))?;
            for step in (1..=STEPS).rev() {
                let [time, next] = [step, step - 1].map(|step| step as f32 / STEPS as f32);
                let times = Tensor::full(time, (SAMPLES, 1), &Device::Cpu)?;
                let clean = self.denoised(encoding, &x, &times)?;
                x = (&clean + ((x - &clean)? * f64::from(next / time))?)?;
            }
            Ok(x)
        })
    }
}

fn noise(rows: usize, rng: &mut Rng) -> CandleResult<Tensor> {
    let numbers: Vec<f32> = (0..rows * NUMBERS).map(|_| rng.normal() as f32).collect();
    Tensor::from_vec(numbers, (rows, NUMBERS), &Device::Cpu)
}

/// Displacement at a step by the constant velocity.
fn drift(features: &Features, step: usize) -> [f32; 2] {
    features.velocity.map(|v| v * (step + 1) as f32 * DT as f32)
}

/// Futures (n, 4) of trajectories, each 80 positions x, y one after the other.
fn futures_of(trajectories: &[f32], features: &Features) -> CandleResult<Tensor> {
    let one = |trajectory: &[f32]| {
        WAYPOINTS.map(|step| {
            let drift = drift(features, step);
            [0, 1].map(|axis| (trajectory[2 * step + axis] - drift[axis]) / UNIT)
        })
    };
    let all: Vec<f32> = trajectories.chunks_exact(2 * HORIZON).flat_map(one).flatten().collect();
    let count = all.len() / NUMBERS;
    Tensor::from_vec(all, (count, NUMBERS), &Device::Cpu)
}

/// From futures to displacements at all steps (4, 160): `a t² + b t³` through both waypoints, with t = 1 after 8 s.
fn matrix() -> Vec<f32> {
    let mut matrix = vec![0.0; NUMBERS * 2 * HORIZON];
    for step in 0..HORIZON {
        let t = (step + 1) as f32 / HORIZON as f32;
        let [middle, end] = [8.0 * t * t * (1.0 - t), t * t * (2.0 * t - 1.0)];
        for (row, value) in [(0, middle), (1, middle), (2, end), (3, end)] {
            matrix[row * 2 * HORIZON + 2 * step + row % 2] = UNIT * value;
        }
    }
    matrix
}

impl Backbone for WaypointDiffusion {
    fn definition(&self) -> &Definition {
        &self.definition
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self::over(self.definition.with(parameters))?))
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        let rows = self.definition.tensor(&features.vectors)?;
        let scene = self.layers.rows.forward(&rows)?.max_keepdim(0)?;
        Ok(Encoding::new(self.tag(), features, vec![scene]))
    }

    fn shared(&self) -> Shared {
        Shared::Nothing
    }

    fn trainable(&self) -> Option<&dyn Trainable> {
        Some(self)
    }
}

impl Trainable for WaypointDiffusion {
    fn group_of(&self, _: &str) -> ParameterGroup {
        ParameterGroup::Scoring
    }

    fn loss(&self, sample: &Sample, rng: &mut Rng) -> Result<Loss, Error> {
        let encoding = self.encode(sample.features.clone())?;
        if !WAYPOINTS.into_iter().all(|step| sample.valid[step]) {
            // Nothing to learn from, and no gradient.
            return Loss::of(vec![("trajectory", (encoding.states()[0].sum_all()? * 0.0)?)]);
        }
        let clean = futures_of(&sample.future.as_flattened().repeat(DRAWS), &sample.features)?;
        Loss::of(vec![("trajectory", self.errors(&encoding, &clean, rng)?.mean_all()?)])
    }

    fn trajectory_likelihood(&self) -> Option<&dyn TrajectoryLikelihood> {
        Some(self)
    }
}

impl TrajectoryLikelihood for WaypointDiffusion {
    fn log_likelihoods(
        &self,
        encoding: &Encoding,
        trajectories: &Tensor,
        rng: &mut Rng,
    ) -> Result<Tensor, Error> {
        let numbers = trajectories.flatten_all()?.to_vec1::<f32>()?;
        let clean = futures_of(&numbers, encoding.features())?;
        Ok((self.errors(encoding, &clean, rng)? * -100.0)?)
    }
}

impl MotionModel for WaypointDiffusion {
    fn log_probs(&self, _: &Encoding) -> Result<Tensor, Error> {
        Ok(Tensor::full(-(SAMPLES as f32).ln(), SAMPLES, &Device::Cpu)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        let all: Vec<usize> = (0..SAMPLES).collect();
        let ends = self.trajectories(encoding, &all)?.narrow(1, HORIZON - 1, 1)?.flatten_all()?;
        Ok(ends.to_vec1::<f32>()?.as_chunks::<2>().0.to_vec())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let futures = of_modes(&*self.futures(encoding)?, modes)?;
        let drift: Vec<f32> = (0..HORIZON).flat_map(|step| drift(encoding.features(), step)).collect();
        let constant = |values, rows| Tensor::from_vec(values, (rows, 2 * HORIZON), &Device::Cpu);
        let moved = futures.matmul(&constant(matrix(), NUMBERS)?)?;
        Ok(moved.broadcast_add(&constant(drift, 1)?)?.reshape((modes.len(), HORIZON, 2))?)
    }
}

impl Entry<dyn Backbone> for WaypointDiffusion {
    const NAME: &'static str = "waypoint-diffusion";
    const SUMMARY: &'static str = "two waypoints drawn by removing noise";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(options: NoOptions) -> Result<Box<dyn Backbone>, String> {
        Ok(Box::new(Self::over(Definition::of::<Self, _>(&options, 0, Layers::new)?)?))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.backbones = registries.parts.backbones.with::<WaypointDiffusion>()?;
        Ok(registries)
    })
}
