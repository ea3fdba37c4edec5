//! Smooth surrogate of the realism penalty, from positions alone.
//!
//! Velocity and acceleration are second-order differences of the positions. Speed, turning rate and absolute values are
//! rounded off near 0, so that the penalty has a gradient everywhere.

use super::{Context, DifferentiableReward, PoseGradient};
use crate::{
    geometry::{Point, cross, dot},
    motion::{DT, Pose},
};

/// Weights and thresholds of the penalty: acceleration, lateral acceleration, yaw rate.
const WEIGHT: f64 = 5.0;
const THRESHOLDS: [f64; 3] = [7.0, 6.0, 0.8];
/// Weight of turning on the spot, and what is added to its speed, m/s.
const SPIN_WEIGHT: f64 = 3.0;
const SPIN_SPEED: f64 = 0.5;
/// Squares that are added before roots and divisions: of the speed, of its square in the yaw rate, of absolute values.
const SPEED_FLOOR: f64 = 1e-4;
const YAW_FLOOR: f64 = 0.25;
const ABSOLUTE_FLOOR: f64 = 1e-6;

/// Smooth P_real.
#[derive(Clone, Copy, Debug, Default)]
pub struct SmoothRealism;

impl DifferentiableReward for SmoothRealism {
    fn name(&self) -> &str {
        "realism"
    }

    fn value(&self, poses: &[Pose], _: &Context, gradient: &mut PoseGradient) -> f64 {
        let count = poses.len();
        if count < 3 {
            return 0.0;
        }
        let positions: Vec<Point> = poses.iter().map(|pose| pose.position).collect();
        let velocity = differences(&positions);
        let acceleration = differences(&velocity);
        let mean = 1.0 / count as f64;
        let (mut by_velocity, mut by_acceleration) = (vec![[0.0; 2]; count], vec![[0.0; 2]; count]);
        let yaw_rates: Vec<f64> = (0..count).map(|k| yaw_rate(velocity[k], acceleration[k])).collect();
        let turned = DT * yaw_rates.iter().sum::<f64>();
        let [size, sign] = absolute(turned);
        let [excess, slope] = softplus(size - std::f64::consts::PI);
        let mut value = WEIGHT * excess;
        let by_turn = WEIGHT * slope * sign * DT;
        for k in 0..count {
            let (v, a, w) = (velocity[k], acceleration[k], yaw_rates[k]);
            let square = dot(v, v);
            let speed = (square + SPEED_FLOOR).sqrt();
            let along = dot(v, a) / speed;
            let [size, sign] = absolute(w);
            // Derivatives by acceleration along the path, by yaw rate, by speed.
            let (mut by_along, mut by_yaw, mut by_speed) = (0.0, by_turn, 0.0);
            let [along_size, along_sign] = absolute(along);
            let [excess, slope] = softplus(along_size - THRESHOLDS[0]);
            value += mean * WEIGHT * excess;
            by_along += mean * WEIGHT * slope * along_sign;
            let [across_size, across_sign] = absolute(speed * w);
            let [excess, slope] = softplus(across_size - THRESHOLDS[1]);
            value += mean * WEIGHT * excess;
            by_yaw += mean * WEIGHT * slope * across_sign * speed;
            by_speed += mean * WEIGHT * slope * across_sign * w;
            let [excess, slope] = softplus(size - THRESHOLDS[2]);
            value += mean * WEIGHT * excess;
            by_yaw += mean * WEIGHT * slope * sign;
            let slow = 1.0 / (speed + SPIN_SPEED);
            value += mean * SPIN_WEIGHT * size * slow;
            by_yaw += mean * SPIN_WEIGHT * sign * slow;
            by_speed -= mean * SPIN_WEIGHT * size * slow * slow;
            // From these to velocity and acceleration.
            let below = square + YAW_FLOOR;
            let speed_part = by_speed / speed - by_along * along / (speed * speed);
            for i in 0..2 {
                // v × a by v is (a_y, −a_x), by a is (−v_y, v_x).
                let (crossed_by_v, crossed_by_a) = ([a[1], -a[0]][i], [-v[1], v[0]][i]);
                by_velocity[k][i] += speed_part * v[i]
                    + by_along * a[i] / speed
                    + by_yaw * (crossed_by_v - 2.0 * w * v[i]) / below;
                by_acceleration[k][i] += by_along * v[i] / speed + by_yaw * crossed_by_a / below;
            }
        }
        let through_acceleration = transposed(&by_acceleration);
        for (sum, more) in by_velocity.iter_mut().zip(through_acceleration) {
            (0..2).for_each(|i| sum[i] += more[i]);
        }
        for (sum, more) in gradient.position.iter_mut().zip(transposed(&by_velocity)) {
            (0..2).for_each(|i| sum[i] += more[i]);
        }
        value
    }
}

fn yaw_rate(v: Point, a: Point) -> f64 {
    cross(v, a) / (dot(v, v) + YAW_FLOOR)
}

/// A rounded absolute value and its derivative.
fn absolute(x: f64) -> [f64; 2] {
    let size = (x * x + ABSOLUTE_FLOOR).sqrt();
    [size, x / size]
}

/// `ln(1 + e^x)` and its derivative.
fn softplus(x: f64) -> [f64; 2] {
    [x.max(0.0) + (-x.abs()).exp().ln_1p(), 1.0 / (1.0 + (-x).exp())]
}

/// Second-order differences, one-sided at the ends.
fn differences(f: &[Point]) -> Vec<Point> {
    let last = f.len() - 1;
    let at = |k: usize, i: usize| match k {
        0 => -1.5 * f[0][i] + 2.0 * f[1][i] - 0.5 * f[2][i],
        k if k == last => 0.5 * f[last - 2][i] - 2.0 * f[last - 1][i] + 1.5 * f[last][i],
        k => 0.5 * (f[k + 1][i] - f[k - 1][i]),
    };
    (0..=last).map(|k| [at(k, 0) / DT, at(k, 1) / DT]).collect()
}

/// The transpose of [`differences`].
fn transposed(g: &[Point]) -> Vec<Point> {
    let last = g.len() - 1;
    let mut out = vec![[0.0; 2]; g.len()];
    let mut add = |k: usize, weight: f64, from: Point| {
        (0..2).for_each(|i| out[k][i] += weight * from[i] / DT);
    };
    for (k, from) in g.iter().enumerate() {
        match k {
            0 => [(0, -1.5), (1, 2.0), (2, -0.5)].iter().for_each(|(n, w)| add(*n, *w, *from)),
            k if k == last => {
                [(last - 2, 0.5), (last - 1, -2.0), (last, 1.5)].iter().for_each(|(n, w)| add(*n, *w, *from));
            }
            k => {
                add(k + 1, 0.5, *from);
                add(k - 1, -0.5, *from);
            }
        }
    }
    out
}
