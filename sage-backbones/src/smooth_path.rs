//! Paths that cannot jitter: ten Bernstein coefficients of the velocity along each axis.
//!
//! The first coefficient is the present velocity, and their mean is the way to the end over the
//! time, so that every path starts as the car drives, ends where it should and is smooth between. A
//! network moves what is left over from a plain ramp.

use std::sync::LazyLock;

use candle_core::{Device, Result, Tensor};
use sage_core::motion::{DT, HORIZON};

/// Coefficients of the velocity along one axis.
const COEFFICIENTS: usize = 10;
/// What a network moves of them: all but the first.
const FREE: usize = COEFFICIENTS - 1;
/// What a network gives for one path.
pub const CHANGES: usize = 2 * FREE;
/// Size of a change that a network asks for with 1, m/s.
const UNIT: f64 = 4.0;
/// Seconds to the end.
const T: f64 = HORIZON as f64 * DT;

/// Paths to given ends from a speed along x *now*, moved by what a network asks for.
///
/// *Shapes*: `changes` (n, 18): nine along x, then nine along y; result (n, 80, 2), target frame.
pub fn paths(changes: &Tensor, ends: &[[f32; 2]], speed: f32) -> Result<Tensor> {
    places(changes, ends, speed, 1)
}

/// The same at every so many steps alone.
///
/// *Shapes*: as [`paths`], but for (n, 80 / `stride`, 2).
pub fn places(changes: &Tensor, ends: &[[f32; 2]], speed: f32, stride: usize) -> Result<Tensor> {
    let (n, dtype, steps) = (ends.len(), changes.dtype(), HORIZON / stride);
    let constant = |values: Vec<f64>, shape: (usize, usize)| {
        Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(dtype)
    };
    let mut base = Vec::with_capacity(n * 2 * COEFFICIENTS);
    // Goals on a lattice come line by line: those of a line have one ramp along x.
    let mut along: Option<(f32, [f64; COEFFICIENTS])> = None;
    for end in ends {
        let known = along.filter(|(x, _)| x.to_bits() == end[0].to_bits());
        let (_, ramp_x) = *along.insert(known.unwrap_or_else(|| (end[0], ramp(end[0], f64::from(speed)))));
        base.extend(ramp_x);
        base.extend(ramp(end[1], 0.0));
    }
    let moved = changes.matmul(&constant(centring(), (CHANGES, 2 * COEFFICIENTS))?)?;
    let coefficients = (constant(base, (n, 2 * COEFFICIENTS))? + moved)?;
    let paths = coefficients.matmul(&constant(basis(stride), (2 * COEFFICIENTS, 2 * steps))?)?;
    paths.reshape((n, steps, 2))
}

/// Every so many steps of paths (n, 80, 2), the last among them.
pub fn every(paths: &Tensor, stride: usize) -> Result<Tensor> {
    let steps: Vec<u32> = (0..HORIZON as u32).skip(stride - 1).step_by(stride).collect();
    let count = steps.len();
    paths.index_select(&Tensor::from_vec(steps, count, &Device::Cpu)?, 1)
}

/// Velocity coefficients along one axis that lead straight from a speed to an end. The velocity changes
/// evenly, or falls faster at first where an even change would go into reverse.
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

/// The power p for which the mean of `(1 − k/9)^p` over k = 0…9 is `mean`, by the sum formula of Euler
/// and Maclaurin, `0.9 / (p + 1) + 0.05 + p / 1080`, solved by iteration; at most 20.
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

/// (20, 2 · steps): from the coefficients along x, then along y, to places x, y at every so many steps.
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

/// (18, 20): along each axis from nine changes to ten coefficients, the first untouched, the rest without
/// their mean, so that no change moves the end.
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

/// What moving the end by one metre along an axis adds to the position at the 80 steps: the velocity
/// changes evenly.
pub fn end_shift() -> Vec<f64> {
    let share = |k: usize| k as f64 / FREE as f64;
    let total: f64 = (0..COEFFICIENTS).map(share).sum();
    let unit = COEFFICIENTS as f64 / T / total;
    let at = |step: usize| (0..COEFFICIENTS).map(|k| unit * share(k) * BASIS[k * HORIZON + step]).sum();
    (0..HORIZON).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::DType;

    fn made(changes: &[f64], ends: &[[f32; 2]], speed: f32) -> Vec<[f64; 2]> {
        let changes = Tensor::from_slice(changes, (ends.len(), CHANGES), &Device::Cpu).unwrap();
        let paths = paths(&changes, ends, speed).unwrap();
        assert_eq!((paths.dtype(), paths.dims()), (DType::F64, &[ends.len(), HORIZON, 2][..]));
        let numbers: Vec<f64> = paths.flatten_all().unwrap().to_vec1().unwrap();
        numbers.as_chunks::<2>().0.to_vec()
    }

    #[test]
    fn whatever_a_network_asks_for_a_path_starts_as_the_car_drives_and_ends_on_its_goal() {
        let mut rng = sage_core::seed::Rng::new(1, "paths", "test");
        for _ in 0..100 {
            let changes: Vec<f64> = (0..CHANGES).map(|_| rng.normal()).collect();
            let end = [rng.uniform(-20.0, 200.0) as f32, rng.uniform(-80.0, 80.0) as f32];
            let speed = rng.uniform(0.0, 25.0) as f32;
            let path = made(&changes, &[end], speed);
            let last = path[HORIZON - 1];
            assert!((last[0] - f64::from(end[0])).abs() < 1e-6 && (last[1] - f64::from(end[1])).abs() < 1e-6);
            // Twice the first step less half the way of the first two extrapolates the start speed.
            let v = (4.0 * path[0][0] - path[1][0]) / (2.0 * DT);
            assert!((v - f64::from(speed)).abs() < 0.2, "{v} against {speed}");
        }
    }

    #[test]
    fn even_speed_and_even_braking_are_plain_ramps() {
        let cruise = made(&[0.0; CHANGES], &[[80.0, 0.0]], 10.0);
        let brake = made(&[0.0; CHANGES], &[[60.0, 0.0]], 10.0);
        for step in 1..=HORIZON {
            let t = step as f64 * DT;
            assert!((cruise[step - 1][0] - 10.0 * t).abs() < 1e-9);
            assert!((brake[step - 1][0] - (10.0 * t - 0.3125 * t * t)).abs() < 1e-6, "{:?}", brake[step - 1]);
        }
    }

    #[test]
    fn a_short_way_is_braked_for_without_going_into_reverse() {
        // The first coefficient alone goes 8 m; 12 m take 4 m/s².
        for end in [12.0, 16.0, 30.0] {
            let path = made(&[0.0; CHANGES], &[[end, 0.0]], 10.0);
            let back = path.windows(2).map(|w| w[0][0] - w[1][0]).fold(0.0, f64::max);
            assert!(back < 0.03, "to {end} m: {back} m back in a step");
        }
    }

    #[test]
    fn a_shift_of_the_end_is_what_another_end_gives_where_speed_changes_evenly() {
        let [a, b] = [60.0, 70.0].map(|x| made(&[0.0; CHANGES], &[[x, 0.0]], 10.0));
        for (step, shift) in end_shift().into_iter().enumerate() {
            assert!((b[step][0] - a[step][0] - 10.0 * shift).abs() < 1e-9);
        }
    }
}
