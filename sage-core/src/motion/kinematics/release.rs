//! Kinematics as the published code computes them, with its irregularities.
//!
//! The heading is a forward difference, and 0 while standing, whatever it was before. It is corrected by at
//! most one turn per point and only at jumps of more than 1.5 π, then averaged over five points. Everything
//! else is a second-order difference. The trajectory is not linked to the history.

use std::f64::consts::{PI, TAU};

use super::Profile;
use crate::{
    geometry::{Point, norm, sub},
    motion::DT,
};

/// Smoothed heading of a polyline, rad; zeros below two points.
pub fn headings(points: &[Point]) -> Vec<f64> {
    let n = points.len();
    if n < 2 {
        return vec![0.0; n];
    }
    let mut raw: Vec<f64> = points
        .windows(2)
        .map(|pair| {
            let displacement = sub(pair[1], pair[0]);
            displacement[1].atan2(displacement[0])
        })
        .collect();
    raw.push(raw[n - 2]);
    for k in 0..n - 1 {
        if raw[k + 1] - raw[k] > 1.5 * PI {
            raw[k + 1] -= TAU;
        } else if raw[k] - raw[k + 1] > 1.5 * PI {
            raw[k + 1] += TAU;
        }
    }
    let padded = |k: usize| raw[k.saturating_sub(2).min(n - 1)];
    (0..n).map(|k| (k..k + 5).map(|j| 0.2 * padded(j)).sum()).collect()
}

/// Second-order differences of equally spaced values, `values.len()` ≥ 3.
fn differences(values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let f = values;
    (0..n)
        .map(|k| match k {
            0 => (-1.5 * f[0] + 2.0 * f[1] - 0.5 * f[2]) / DT,
            k if k == n - 1 => (0.5 * f[n - 3] - 2.0 * f[n - 2] + 1.5 * f[n - 1]) / DT,
            k => (f[k + 1] - f[k - 1]) / (2.0 * DT),
        })
        .collect()
}

/// The same angles without jumps of more than half a turn.
fn unwrap(angles: &[f64]) -> Vec<f64> {
    let mut correction = 0.0;
    let mut out = Vec::with_capacity(angles.len());
    for (k, &angle) in angles.iter().enumerate() {
        if k > 0 {
            let jump = angle - angles[k - 1];
            if jump.abs() >= PI {
                let mut turned = (jump + PI).rem_euclid(TAU) - PI;
                if turned == -PI && jump > 0.0 {
                    turned = PI;
                }
                correction += turned - jump;
            }
        }
        out.push(angle + correction);
    }
    out
}

/// Profile of a trajectory; empty below three points.
pub fn profile(points: &[Point]) -> Profile {
    if points.len() < 3 {
        return Profile::default();
    }
    let component = |k: usize| -> Vec<f64> { points.iter().map(|p| p[k]).collect() };
    let (vx, vy) = (differences(&component(0)), differences(&component(1)));
    let (ax, ay) = (differences(&vx), differences(&vy));
    let pairs = |x: &[f64], y: &[f64]| -> Vec<f64> { x.iter().zip(y).map(|(&x, &y)| norm([x, y])).collect() };
    let speed = pairs(&vx, &vy);
    let yaw = headings(points);
    let heading = unwrap(&yaw);
    Profile {
        axis: axes(&yaw),
        yaw_rate: differences(&heading),
        acceleration: differences(&speed),
        acceleration_norm: pairs(&ax, &ay),
        total_turn: heading[heading.len() - 1] - heading[0],
        speed,
        heading,
    }
}

/// Unit vectors of headings.
pub fn axes(headings: &[f64]) -> Vec<Point> {
    headings
        .iter()
        .map(|heading| {
            let (sin, cos) = heading.sin_cos();
            [cos, sin]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_exact_for_parabolas() {
        let f: Vec<f64> = (0..10).map(|k| (k as f64 * DT).powi(2)).collect();
        for (k, d) in differences(&f).into_iter().enumerate() {
            assert!((d - 2.0 * k as f64 * DT).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn a_jump_between_pi_and_one_and_a_half_pi_stays() {
        // 0.6 π, then −0.6 π: a jump of 1.2 π, below the threshold of 1.5 π, is not unwrapped. The last
        // heading repeats and the ends are held, so the averages are over five of [a, −a, −a] repeated.
        let a = 0.6 * PI;
        let points = [[0.0, 0.0], [a.cos(), a.sin()], [2.0 * a.cos(), 0.0]];
        let yaw = headings(&points);
        for (found, expected) in
            yaw.iter().zip([0.2 * (3.0 - 2.0) * a, 0.2 * (2.0 - 3.0) * a, 0.2 * (1.0 - 4.0) * a])
        {
            assert!((found - expected).abs() < 1e-12, "{yaw:?}");
        }
        assert_eq!(unwrap(&[0.0, PI]), [0.0, PI]);
        assert_eq!(unwrap(&[0.0, 1.2 * PI]), [0.0, 1.2 * PI - TAU]);
    }
}
