//! What a goal's trajectory means for the ego: the part of the score that fine-tuning steers by.
//!
//! It gives zero until it is fine-tuned, so that the base model knows nothing of it. What it sees is
//! what the target could know *now*: the ego's position and velocity, never its logged future.

use candle_core::{DType, Device, Result, Tensor};

use crate::{
    features::EgoState,
    nn::{Linear, Mlp},
    parameters::Scope,
};

/// Steps at which trajectory and extrapolated ego are compared.
const EVERY: usize = 8;
/// Number of these.
const TIMES: usize = 10;
/// Inputs of the branch.
const COLUMNS: usize = 2 * TIMES + 6;
/// Width of its layers.
const WIDTH: usize = 32;

pub(crate) struct EgoBranch {
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl EgoBranch {
    pub(crate) fn new(scope: &Scope) -> Result<Self> {
        Ok(Self {
            first: Mlp::new(&scope.at("first"), COLUMNS, WIDTH)?,
            second: Mlp::new(&scope.at("second"), WIDTH, WIDTH)?,
            last: Linear::zero(&scope.at("last"), WIDTH, 1)?,
        })
    }

    /// Whether it gives zero whatever it sees: nothing to compute then, unless it is in training.
    pub(crate) fn is_silent(&self) -> Result<bool> {
        let zero = |tensor: &Tensor| -> Result<bool> {
            let numbers = tensor.flatten_all()?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
            Ok(!tensor.is_variable() && numbers.iter().all(|x| *x == 0.0))
        };
        Ok(zero(&self.last.weight)? && zero(&self.last.bias)?)
    }

    /// What to add to the scores.
    ///
    /// *Shapes*: `paths` (n, 80, 2), target frame; result (n).
    pub(crate) fn forward(&self, paths: &Tensor, ego: &EgoState, speed: f32) -> Result<Tensor> {
        let dtype = paths.dtype();
        let n = paths.dim(0)?;
        let rows = describe(&paths.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?, ego, speed);
        let rows = Tensor::from_vec(rows, (n, COLUMNS), &Device::Cpu)?.to_dtype(dtype)?;
        let x = self.second.forward(&self.first.forward(&rows)?)?;
        self.last.forward(&x)?.squeeze(1)
    }
}

/// A row a path: positions relative to the extrapolated ego at ten times, the nearest of them, and
/// how fast the two are then.
fn describe(paths: &[f32], ego: &EgoState, speed: f32) -> Vec<f32> {
    let mut out = Vec::with_capacity(paths.len() / 160 * COLUMNS);
    let [ex, ey] = ego.velocity;
    let ego_speed = ex.hypot(ey);
    for path in paths.chunks_exact(160) {
        let mut nearest = (f32::INFINITY, 0, [0.0; 2]);
        for k in 1..=TIMES {
            let step = k * EVERY;
            let t = step as f32 * 0.1;
            let dx = path[2 * step - 2] - ego.position[0] - t * ex;
            let dy = path[2 * step - 1] - ego.position[1] - t * ey;
            out.extend([signed_log(dx), signed_log(dy)]);
            let distance = dx.hypot(dy);
            if distance < nearest.0 {
                let before =
                    if step == EVERY { [0.0, 0.0] } else { [path[2 * step - 18], path[2 * step - 17]] };
                let v = [path[2 * step - 2] - before[0], path[2 * step - 1] - before[1]].map(|x| x / 0.8);
                nearest = (distance, k, [v[0] - ex, v[1] - ey]);
            }
        }
        let (distance, time, relative) = nearest;
        let length = path[158].hypot(path[159]);
        out.extend([
            signed_log(distance),
            time as f32 / TIMES as f32,
            relative[0] / 10.0,
            relative[1] / 10.0,
            ego_speed / 10.0,
            (length / 8.0 - speed) / 10.0,
        ]);
    }
    out
}

/// Keeps what is near apart and what is far together.
fn signed_log(x: f32) -> f32 {
    x.signum() * (1.0 + x.abs() / 2.0).ln()
}
