//! Training labels from recorded futures: weights of goals and errors of trajectories.

use candle_core::Tensor;
use sage_core::motion::{DT, HORIZON};

use crate::{Error, backbone::Sample};

/// Standard deviation of the goal label at the target, metres.
const SPREAD: f32 = 1.2;
/// Increase of the standard deviation per metre of distance.
const SPREAD_PER_METRE: f32 = 0.02;
/// Increase of the standard deviation per second without a record at the end, m/s.
const SPREAD_PER_SECOND: f32 = 2.5;

/// Position of a target after 8 s, with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    /// Metres, target frame.
    pub position: [f32; 2],
    /// Standard deviation of the position, metres.
    pub spread: f32,
}

/// The last recorded position, extrapolated at its velocity if the record ends early.
pub fn end(future: &[[f32; 2]], valid: &[bool]) -> End {
    let Some(last) = valid.iter().rposition(|v| *v) else {
        return End { position: [0.0, 0.0], spread: 100.0 };
    };
    let missing = (HORIZON - 1 - last) as f32 * DT as f32;
    let position = if missing > 0.0 { extrapolated(future, valid, last, missing) } else { future[last] };
    let spread = SPREAD + SPREAD_PER_METRE * position[0].hypot(position[1]) + SPREAD_PER_SECOND * missing;
    End { position, spread }
}

/// Position some seconds after a step, at the mean velocity of the second before it.
fn extrapolated(future: &[[f32; 2]], valid: &[bool], last: usize, seconds: f32) -> [f32; 2] {
    let earlier = (last.saturating_sub(10)..last).find(|step| valid[*step]);
    let Some(earlier) = earlier else { return future[last] };
    let span = (last - earlier) as f32 * DT as f32;
    let [a, b] = [future[earlier], future[last]];
    [0, 1].map(|k| b[k] + seconds * (b[k] - a[k]) / span)
}

/// Weights of goals by their distance from the end; they sum to 1.
pub fn soft(goals: &[[f32; 2]], end: End) -> Vec<f32> {
    let squared = |g: &[f32; 2]| {
        let [x, y] = [g[0] - end.position[0], g[1] - end.position[1]];
        (x * x + y * y) / (2.0 * end.spread * end.spread)
    };
    let least = goals.iter().map(squared).fold(f32::INFINITY, f32::min);
    let mut weights: Vec<f32> = goals.iter().map(|g| (least - squared(g)).exp()).collect();
    let total: f64 = weights.iter().map(|w| f64::from(*w)).sum();
    weights.iter_mut().for_each(|w| *w = (f64::from(*w) / total) as f32);
    weights
}

/// Index of the goal nearest to a position, the first of equals.
pub fn nearest(goals: &[[f32; 2]], position: [f32; 2]) -> usize {
    let squared = |g: &[f32; 2]| {
        let [x, y] = [f64::from(g[0]) - f64::from(position[0]), f64::from(g[1]) - f64::from(position[1])];
        x * x + y * y
    };
    (0..goals.len()).min_by(|a, b| squared(&goals[*a]).total_cmp(&squared(&goals[*b]))).unwrap_or(0)
}

/// `−Σ w log p`.
///
/// *Shapes*: `log_probs` and `weights` (modes); result a scalar.
/// *Errors*: [`Error::Tensor`] for other shapes.
pub fn cross_entropy(log_probs: &Tensor, weights: &[f32]) -> Result<Tensor, Error> {
    let weights =
        Tensor::from_slice(weights, weights.len(), log_probs.device())?.to_dtype(log_probs.dtype())?;
    Ok((log_probs * weights)?.sum_all()?.neg()?)
}

/// Mean of the smooth absolute error (0.5 e² below 1, |e| − 0.5 above) over the coordinates of the
/// recorded steps.
///
/// *Shapes*: `trajectory` (1, 80, 2); result a scalar.
/// *Errors*: [`Error::Tensor`] for other shapes.
pub fn smooth_l1(trajectory: &Tensor, sample: &Sample) -> Result<Tensor, Error> {
    let dtype = trajectory.dtype();
    let steps = sample.valid.iter().filter(|v| **v).count().max(1);
    let share = 1.0 / (2 * steps) as f64;
    let weights: Vec<f64> =
        sample.valid.iter().flat_map(|v| if *v { [share; 2] } else { [0.0; 2] }).collect();
    let mut future: Vec<f64> = sample.future.iter().flatten().map(|x| f64::from(*x)).collect();
    for (x, weight) in future.iter_mut().zip(&weights) {
        if *weight == 0.0 {
            *x = 0.0;
        }
    }
    let constant =
        |values: Vec<f64>| Tensor::from_vec(values, (1, HORIZON, 2), trajectory.device())?.to_dtype(dtype);
    let error = (trajectory - constant(future)?)?.abs()?;
    let clipped = error.clamp(0.0, 1.0)?;
    // 0.5 n² + (e − n) with n = min(e, 1).
    let smooth = ((clipped.sqr()? * 0.5)? + (error - clipped)?)?;
    Ok((smooth * constant(weights)?)?.sum_all()?)
}
