//! Smooth trajectories: ten Bernstein coefficients of the velocity along each axis.
//!
//! The first coefficient is the present velocity. The mean of the coefficients is the displacement to the end
//! point divided by the duration. So every trajectory starts at the present velocity, reaches its end point
//! and is smooth. A network predicts changes of the coefficients relative to a plain ramp.

use std::sync::LazyLock;

use candle_core::{Result, Tensor};
use sage_core::motion::{DT, HORIZON};

/// Coefficients of the velocity along one axis.
const COEFFICIENTS: usize = 10;
/// Coefficients that a network changes: all but the first.
const FREE: usize = COEFFICIENTS - 1;
/// Network outputs for one trajectory.
pub const CHANGES: usize = 2 * FREE;
/// Change of a coefficient for a network output of 1, m/s.
const UNIT: f64 = 4.0;
/// Duration of a trajectory, seconds.
const T: f64 = HORIZON as f64 * DT;

/// Trajectories to given end points, from a speed along x *now* and the network's changes.
///
/// *Shapes*: `changes` (n, 18): nine along x, then nine along y; result (n, 80, 2), target frame.
/// *Errors*: [`candle_core::Error`] for other shapes.
pub fn paths(changes: &Tensor, ends: &[[f32; 2]], speed: f32) -> Result<Tensor> {
    places(changes, ends, speed, 1)
}

/// As [`paths`], at every `stride`-th step only.
///
/// *Shapes*: as [`paths`]; result (n, 80 / `stride`, 2).
/// *Errors*: as [`paths`].
pub fn places(changes: &Tensor, ends: &[[f32; 2]], speed: f32, stride: usize) -> Result<Tensor> {
    let (n, dtype, steps) = (ends.len(), changes.dtype(), HORIZON / stride);
    let constant = |values: Vec<f64>, shape: (usize, usize)| {
        Tensor::from_vec(values, shape, changes.device())?.to_dtype(dtype)
    };
    let mut base = Vec::with_capacity(n * 2 * COEFFICIENTS);
    // Lattice goals are sorted by x. Goals with the same x share one ramp along x.
    let mut along: Option<(f32, [f64; COEFFICIENTS])> = None;
    for end in ends {
        let known = along.filter(|(x, _)| x.to_bits() == end[0].to_bits());
        let (_, ramp_x) = *along.insert(known.unwrap_or_else(|| (end[0], ramp(end[0], f64::from(speed)))));
        base.extend(ramp_x);
        base.extend(ramp(end[1], 0.0));
    }
    let moved = changes.matmul(&constant(centring(), (CHANGES, 2 * COEFFICIENTS))?)?;
    let coefficients = (constant(base, (n, 2 * COEFFICIENTS))? + moved)?;
    let points = coefficients.matmul(&constant(basis(stride), (2 * COEFFICIENTS, 2 * steps))?)?;
    points.reshape((n, steps, 2))
}

/// Every `stride`-th step of trajectories, up to the last step.
///
/// *Shapes*: `trajectories` (n, 80, 2); result (n, 80 / `stride`, 2).
/// *Errors*: [`candle_core::Error`] for other shapes.
pub fn every(trajectories: &Tensor, stride: usize) -> Result<Tensor> {
    let steps: Vec<u32> = (0..HORIZON as u32).skip(stride - 1).step_by(stride).collect();
    let count = steps.len();
    trajectories.index_select(&Tensor::from_vec(steps, count, trajectories.device())?, 1)
}

/// Velocity coefficients of a plain ramp along one axis, from a start speed to an end position. The velocity
/// changes linearly. If a linear change would lead into reverse, the velocity falls faster at first.
fn ramp(end: f32, start: f64) -> [f64; COEFFICIENTS] {
    let mean = f64::from(end) / T;
    let share = |k: usize| k as f64 / FREE as f64;
    let ratio = if start > 0.1 { mean / start } else { 1.0 };
    let mut coefficients: [f64; COEFFICIENTS] = std::array::from_fn(|k| start * (1.0 - share(k)));
    if (0.0..0.5).contains(&ratio) {
        let power = fall(ratio);
        coefficients = std::array::from_fn(|k| start * (1.0 - share(k)).powf(power));
    }
    let missing = mean * COEFFICIENTS as f64 - coefficients.iter().sum::<f64>();
    let total: f64 = (0..COEFFICIENTS).map(share).sum();
    for (k, c) in coefficients.iter_mut().enumerate() {
        *c += missing * share(k) / total;
    }
    coefficients
}

/// The power p for which the mean of `(1 − k/9)^p` over k = 0…9 is `mean`, at most 20. The mean is
/// approximated by the Euler–Maclaurin formula, `0.9 / (p + 1) + 0.05 + p / 1080`, and solved by iteration.
fn fall(mean: f64) -> f64 {
    let next = |p: f64| (0.9 / (mean - 0.05 - p / 1080.0).max(0.02) - 1.0).min(20.0);
    (0..4).fold((1.0 / mean.max(0.05) - 1.0).min(20.0), |p, _| next(p))
}

/// Positions at the 80 steps for one unit of each velocity coefficient (10, 80): the integrals of
/// the Bernstein polynomials of degree 9 over 8 s.
static BASIS: LazyLock<Vec<f64>> = LazyLock::new(|| {
    let degree = COEFFICIENTS as i32;
    let binomial = |k: i32| (0..k).fold(1.0, |b, j| b * f64::from(degree - j) / f64::from(j + 1));
    let mut out = Vec::with_capacity(COEFFICIENTS * HORIZON);
    for k in 0..degree {
        for step in 1..=HORIZON {
            let s = step as f64 / HORIZON as f64;
            let above = |j: i32| binomial(j) * s.powi(j) * (1.0 - s).powi(degree - j);
            out.push(T / f64::from(degree) * (k + 1..=degree).map(above).sum::<f64>());
        }
    }
    out
});

/// Matrix (20, 2 · steps) from the coefficients along x, then along y, to positions x, y at every
/// `stride`-th step.
fn basis(stride: usize) -> Vec<f64> {
    let steps = HORIZON / stride;
    let mut out = vec![0.0; 2 * COEFFICIENTS * 2 * steps];
    for axis in 0..2 {
        for k in 0..COEFFICIENTS {
            for step in 0..steps {
                let row = axis * COEFFICIENTS + k;
                out[row * 2 * steps + 2 * step + axis] = BASIS[k * HORIZON + (step + 1) * stride - 1];
            }
        }
    }
    out
}

/// Matrix (18, 20) from nine changes to ten coefficients along each axis. The first coefficient does not
/// change. The mean of the changes is subtracted, so that no change moves the end point.
fn centring() -> Vec<f64> {
    let mut out = vec![0.0; CHANGES * 2 * COEFFICIENTS];
    for axis in 0..2 {
        for row in 0..FREE {
            for column in 0..FREE {
                let own = if row == column { 1.0 } else { 0.0 };
                let [row, column] = [axis * FREE + row, axis * COEFFICIENTS + column + 1];
                out[row * 2 * COEFFICIENTS + column] = UNIT * (own - 1.0 / FREE as f64);
            }
        }
    }
    out
}

/// Shift of the positions at the 80 steps along one axis if the end point moves by one metre. The velocity
/// changes linearly.
pub fn end_shift() -> Vec<f64> {
    let share = |k: usize| k as f64 / FREE as f64;
    let total: f64 = (0..COEFFICIENTS).map(share).sum();
    let unit = COEFFICIENTS as f64 / T / total;
    let at = |step: usize| (0..COEFFICIENTS).map(|k| unit * share(k) * BASIS[k * HORIZON + step]).sum();
    (0..HORIZON).map(at).collect()
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;
    use candle_core::DType;

    fn decoded(changes: &[f64], ends: &[[f32; 2]], speed: f32) -> Vec<[f64; 2]> {
        let changes = Tensor::from_slice(changes, (ends.len(), CHANGES), &Device::Cpu).unwrap();
        let decoded = paths(&changes, ends, speed).unwrap();
        assert_eq!((decoded.dtype(), decoded.dims()), (DType::F64, &[ends.len(), HORIZON, 2][..]));
        let numbers: Vec<f64> = decoded.flatten_all().unwrap().to_vec1().unwrap();
        numbers.as_chunks::<2>().0.to_vec()
    }

    #[test]
    fn every_trajectory_starts_at_the_present_speed_and_ends_on_its_goal() {
        let mut rng = sage_core::seed::Rng::new(1, "paths", "test");
        for _ in 0..100 {
            let changes: Vec<f64> = (0..CHANGES).map(|_| rng.normal()).collect();
            let end = [rng.uniform(-20.0, 200.0) as f32, rng.uniform(-80.0, 80.0) as f32];
            let speed = rng.uniform(0.0, 25.0) as f32;
            let trajectory = decoded(&changes, &[end], speed);
            let last = trajectory[HORIZON - 1];
            assert!((last[0] - f64::from(end[0])).abs() < 1e-6 && (last[1] - f64::from(end[1])).abs() < 1e-6);
            // Start speed, extrapolated from the first two positions.
            let v = (4.0 * trajectory[0][0] - trajectory[1][0]) / (2.0 * DT);
            assert!((v - f64::from(speed)).abs() < 0.2, "{v} against {speed}");
        }
    }

    #[test]
    fn constant_speed_and_constant_braking_are_plain_ramps() {
        let cruise = decoded(&[0.0; CHANGES], &[[80.0, 0.0]], 10.0);
        let brake = decoded(&[0.0; CHANGES], &[[60.0, 0.0]], 10.0);
        for step in 1..=HORIZON {
            let t = step as f64 * DT;
            assert!((cruise[step - 1][0] - 10.0 * t).abs() < 1e-9);
            assert!((brake[step - 1][0] - (10.0 * t - 0.3125 * t * t)).abs() < 1e-6, "{:?}", brake[step - 1]);
        }
    }

    #[test]
    fn braking_for_a_near_goal_does_not_lead_into_reverse() {
        // The first coefficient alone gives 8 m; 12 m need 4 m/s².
        for end in [12.0, 16.0, 30.0] {
            let trajectory = decoded(&[0.0; CHANGES], &[[end, 0.0]], 10.0);
            let back = trajectory.windows(2).map(|w| w[0][0] - w[1][0]).fold(0.0, f64::max);
            assert!(back < 0.03, "to {end} m: {back} m back in a step");
        }
    }

    #[test]
    fn a_shift_of_the_end_is_the_difference_of_two_linear_ramps() {
        let [a, b] = [60.0, 70.0].map(|x| decoded(&[0.0; CHANGES], &[[x, 0.0]], 10.0));
        for (step, shift) in end_shift().into_iter().enumerate() {
            assert!((b[step][0] - a[step][0] - 10.0 * shift).abs() < 1e-9);
        }
    }
}
