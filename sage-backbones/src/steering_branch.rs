//! What a goal's trajectory means for the ego and for everybody else: the part of the score that
//! fine-tuning steers by.
//!
//! It gives zero until it is fine-tuned, so that the base model knows nothing of it. What it sees is
//! what the target could know *now*: the map, everybody's position and velocity driven on straight, the
//! shape of the path itself; never the logged future.

use candle_core::{DType, Device, Result, Tensor};

use crate::{
    features::{EgoState, Features},
    nn::{Linear, Mlp},
    parameters::Scope,
};

/// Steps of a path.
const STEPS: usize = 80;
/// Steps from one comparison with the ego to the next, and number of these.
const EVERY: usize = 8;
const TIMES: usize = STEPS / EVERY;
/// Steps from one look at speed, heading, edges and agents to the next.
const STRIDE: usize = 4;
/// Places along a car's middle line that are asked for an edge, metres from its centre; what a car is
/// wide is left to the cells.
const ALONG: [f32; 3] = [-1.8, 0.0, 2.2];
/// Half a car's width, metres.
const HALF_WIDTH: f32 = 0.9;
/// Inputs of the branch.
const COLUMNS: usize = 2 * TIMES + 17;
/// Width of its layers.
const WIDTH: usize = 64;

pub(crate) struct SteeringBranch {
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl SteeringBranch {
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

    /// What to add to the scores of described paths.
    ///
    /// *Shapes*: `rows` (n, columns) of [`describe`]; result (n).
    pub(crate) fn forward(&self, rows: &Tensor) -> Result<Tensor> {
        let x = self.second.forward(&self.first.forward(rows)?)?;
        self.last.forward(&x)?.squeeze(1)
    }
}

/// Rows of what the branch sees of paths (n, 80, 2), target frame. Without an ego to look at, as when
/// it is the target itself, there are none.
pub(crate) fn describe(paths: &Tensor, features: &Features) -> Result<Option<Tensor>> {
    let Some(ego) = &features.ego else { return Ok(None) };
    let n = paths.dim(0)?;
    let numbers = paths.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
    let mut rows = Vec::with_capacity(n * COLUMNS);
    for path in numbers.as_chunks::<2>().0.chunks_exact(STEPS) {
        let first = rows.len();
        towards_ego(path, ego, features.speed(), &mut rows);
        of_itself(path, features, &mut rows);
        debug_assert_eq!(rows.len() - first, COLUMNS);
    }
    Ok(Some(Tensor::from_vec(rows, (n, COLUMNS), &Device::Cpu)?.to_dtype(paths.dtype())?))
}

/// Where the path is relative to the ego driven on straight, how near they come, when, and how.
fn towards_ego(path: &[[f32; 2]], ego: &EgoState, speed: f32, out: &mut Vec<f32>) {
    let [ex, ey] = ego.velocity;
    let apart = |step: usize| {
        let t = step as f32 * 0.1;
        [path[step - 1][0] - ego.position[0] - t * ex, path[step - 1][1] - ego.position[1] - t * ey]
    };
    for k in 1..=TIMES {
        out.extend(apart(k * EVERY).map(signed_log));
    }
    let squared = |[x, y]: [f32; 2]| x * x + y * y;
    let mut nearest = (f32::INFINITY, 1);
    for step in 1..=STEPS {
        let gap = squared(apart(step));
        if gap < nearest.0 {
            nearest = (gap, step);
        }
    }
    let (gap, step) = nearest;
    let before = if step == 1 { [0.0, 0.0] } else { path[step - 2] };
    let own = [0, 1].map(|k| (path[step - 1][k] - before[k]) * 10.0);
    let length = path[STEPS - 1][0].hypot(path[STEPS - 1][1]);
    let distance = gap.sqrt();
    out.extend([
        signed_log(distance),
        (-distance / 2.0).exp(),
        step as f32 / STEPS as f32,
        (own[0] - ex) / 10.0,
        (own[1] - ey) / 10.0,
        ex.hypot(ey) / 10.0,
        (length / 8.0 - speed) / 10.0,
    ]);
}

/// Whether the path touches an edge, how near it comes to others driven on straight, how it is driven.
fn of_itself(path: &[[f32; 2]], features: &Features, out: &mut Vec<f32>) {
    let mut before = [0.0, 0.0];
    let mut heading: Option<[f32; 2]> = None;
    let mut speed = features.speed();
    let (mut edge, mut crowd) = (None, (f32::INFINITY, 0));
    let (mut brake, mut gain, mut across, mut turned, mut restless) =
        (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
    let span = STRIDE as f32 * 0.1;
    for step in (STRIDE..=STEPS).step_by(STRIDE) {
        let at = path[step - 1];
        let [dx, dy] = [at[0] - before[0], at[1] - before[1]];
        let way = dx.hypot(dy);
        let now = way / span;
        let acceleration = (now - speed) / span;
        brake = brake.max(-acceleration);
        gain = gain.max(acceleration);
        if way > 0.05 {
            let axis = [dx / way, dy / way];
            let last = heading.unwrap_or([1.0, 0.0]);
            let sin = last[0] * axis[1] - last[1] * axis[0];
            let cos = last[0] * axis[0] + last[1] * axis[1];
            let rate = sin.atan2(cos) / span;
            across = across.max((rate * now).abs());
            turned += rate.abs() * span;
            restless += rate.abs() / (now + 0.5);
            heading = Some(axis);
        }
        let [c, s] = heading.unwrap_or([1.0, 0.0]);
        if edge.is_none() && touches_edge(features, at, [c, s]) {
            edge = Some(step);
        }
        let t = step as f32 * 0.1;
        for (place, velocity) in &features.others {
            let x = at[0] - place[0] - t * velocity[0];
            let y = at[1] - place[1] - t * velocity[1];
            let gap = x * x + y * y;
            if gap < crowd.0 {
                crowd = (gap, step);
            }
        }
        (before, speed) = (at, now);
    }
    let gap = crowd.0.sqrt().min(1e4);
    out.extend([
        f32::from(edge.is_some()),
        edge.map_or(1.0, |step| step as f32 / STEPS as f32),
        signed_log(gap),
        (-gap / 2.0).exp(),
        crowd.1 as f32 / STEPS as f32,
        (brake / 4.0).min(4.0),
        (gain / 4.0).min(4.0),
        (across / 4.0).min(4.0),
        (turned / 2.0).min(4.0),
        (restless / 4.0).min(4.0),
    ]);
}

fn touches_edge(features: &Features, [x, y]: [f32; 2], [c, s]: [f32; 2]) -> bool {
    ALONG.iter().any(|along| {
        [-HALF_WIDTH, 0.0, HALF_WIDTH]
            .iter()
            .any(|across| features.edges.holds(x + along * c - across * s, y + along * s + across * c))
    })
}

/// Keeps what is near apart and what is far together.
fn signed_log(x: f32) -> f32 {
    x.signum() * (1.0 + x.abs() / 2.0).ln()
}
