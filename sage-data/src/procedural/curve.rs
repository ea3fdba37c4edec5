//! Planar curves as dense polylines.

use sage_core::{
    geometry::{Point, distance},
    motion::Pose,
};

/// Distance between neighbouring points, metres, as in recorded maps.
pub(super) const STEP: f64 = 0.5;

/// A densely sampled arc of constant curvature (1/m, left positive); straight for 0. Returns its points and
/// its end pose.
pub(super) fn arc(start: &Pose, length: f64, curvature: f64) -> (Vec<Point>, Pose) {
    let n = (length / STEP).ceil().max(1.0) as usize;
    let pose = |k: usize| {
        let s = length * k as f64 / n as f64;
        let turn = curvature * s;
        let half = 0.5 * turn;
        let chord = if half.abs() < 1e-9 { s } else { s * half.sin() / half };
        let along = start.heading + half;
        let position = [start.position[0] + chord * along.cos(), start.position[1] + chord * along.sin()];
        Pose { position, heading: start.heading + turn }
    };
    ((0..=n).map(|k| pose(k).position).collect(), pose(n))
}

/// A densely sampled cubic from one pose to another.
pub(super) fn bezier(from: &Pose, to: &Pose) -> Vec<Point> {
    // With control points at this distance, a right angle becomes a quarter circle.
    let reach = 0.39 * distance(from.position, to.position);
    let (a, d) = (from.position, to.position);
    let (b, c) = (from.shifted(reach, 0.0).position, to.shifted(-reach, 0.0).position);
    let at = |t: f64| {
        let u = 1.0 - t;
        let w = [u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t];
        [0, 1].map(|k| w[0] * a[k] + w[1] * b[k] + w[2] * c[k] + w[3] * d[k])
    };
    let fine: Vec<Point> = (0..=64).map(|k| at(f64::from(k) / 64.0)).collect();
    resampled(&fine)
}

/// The same line with points [`STEP`] apart; its end points are preserved.
pub(super) fn resampled(points: &[Point]) -> Vec<Point> {
    let length: f64 = points.windows(2).map(|p| distance(p[0], p[1])).sum();
    let n = (length / STEP).round().max(1.0) as usize;
    let mut out = Vec::with_capacity(n + 1);
    let (mut k, mut before) = (0, 0.0);
    for j in 0..n {
        let target = length * j as f64 / n as f64;
        while k + 2 < points.len() && before + distance(points[k], points[k + 1]) < target {
            before += distance(points[k], points[k + 1]);
            k += 1;
        }
        let segment = distance(points[k], points[k + 1]);
        let share = if segment > 0.0 { (target - before) / segment } else { 0.0 };
        out.push([0, 1].map(|c| points[k][c] + share * (points[k + 1][c] - points[k][c])));
    }
    out.extend(points.last());
    out
}

/// A parallel line, `left` metres to the left.
pub(super) fn beside(points: &[Point], left: f64) -> Vec<Point> {
    (0..points.len())
        .map(|k| {
            let (a, b) = (points[k.saturating_sub(1)], points[(k + 1).min(points.len() - 1)]);
            let d = [b[0] - a[0], b[1] - a[1]];
            let length = d[0].hypot(d[1]).max(1e-9);
            [points[k][0] - left * d[1] / length, points[k][1] + left * d[0] / length]
        })
        .collect()
}

/// Pose of a line at its end.
pub(super) fn end_pose(points: &[Point]) -> Pose {
    let [.., a, b] = points else { return Pose::new(0.0, 0.0, 0.0) };
    Pose { position: *b, heading: (b[1] - a[1]).atan2(b[0] - a[0]) }
}

/// Pose of a line at its start.
pub(super) fn start_pose(points: &[Point]) -> Pose {
    let [a, b, ..] = points else { return Pose::new(0.0, 0.0, 0.0) };
    Pose { position: *a, heading: (b[1] - a[1]).atan2(b[0] - a[0]) }
}
