//! What recorded futures teach: which goals were right, and which way led there.

use candle_core::{Device, Tensor};
use sage_core::motion::{DT, HORIZON};

use crate::{Error, backbone::Sample};

/// Spread of a goal's label at the target, metres.
const SPREAD: f32 = 1.2;
/// What each metre of distance adds to it.
const SPREAD_PER_METRE: f32 = 0.02;
/// What each second of an unrecorded end adds to it, m/s.
const SPREAD_PER_SECOND: f32 = 2.5;

/// Where a target is after eight seconds, as far as that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    /// Metres, target frame.
    pub position: [f32; 2],
    /// How far off it may be, metres.
    pub spread: f32,
}

/// The last recorded position, carried on at its velocity where the record ends early.
pub fn end(future: &[[f32; 2]], valid: &[bool]) -> End {
    let Some(last) = valid.iter().rposition(|v| *v) else {
        return End { position: [0.0, 0.0], spread: 100.0 };
    };
    let missing = (HORIZON - 1 - last) as f32 * DT as f32;
    let position = if missing > 0.0 { carried_on(future, valid, last, missing) } else { future[last] };
    let spread = SPREAD + SPREAD_PER_METRE * position[0].hypot(position[1]) + SPREAD_PER_SECOND * missing;
    End { position, spread }
}

/// Position some seconds after a step, at the mean velocity of the second before it.
fn carried_on(future: &[[f32; 2]], valid: &[bool], last: usize, seconds: f32) -> [f32; 2] {
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

/// The goal nearest to a place, the first of equals.
pub fn nearest(goals: &[[f32; 2]], place: [f32; 2]) -> usize {
    let squared = |g: &[f32; 2]| {
        let [x, y] = [f64::from(g[0]) - f64::from(place[0]), f64::from(g[1]) - f64::from(place[1])];
        x * x + y * y
    };
    (0..goals.len()).min_by(|a, b| squared(&goals[*a]).total_cmp(&squared(&goals[*b]))).unwrap_or(0)
}

/// `−Σ w log p`.
pub fn cross_entropy(log_probs: &Tensor, weights: &[f32]) -> Result<Tensor, Error> {
    let weights = Tensor::from_slice(weights, weights.len(), &Device::Cpu)?.to_dtype(log_probs.dtype())?;
    Ok((log_probs * weights)?.sum_all()?.neg()?)
}

/// Mean of the smooth absolute error (0.5 e² below 1, |e| − 0.5 above) over the coordinates of
/// recorded steps of one path (1, 80, 2).
pub fn smooth_l1(path: &Tensor, sample: &Sample) -> Result<Tensor, Error> {
    let dtype = path.dtype();
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
        |values: Vec<f64>| Tensor::from_vec(values, (1, HORIZON, 2), &Device::Cpu)?.to_dtype(dtype);
    let error = (path - constant(future)?)?.abs()?;
    let near = error.clamp(0.0, 1.0)?;
    // 0.5 n² + (e − n) with n = min(e, 1).
    let smooth = ((near.sqr()? * 0.5)? + (error - near)?)?;
    Ok((smooth * constant(weights)?)?.sum_all()?)
}
