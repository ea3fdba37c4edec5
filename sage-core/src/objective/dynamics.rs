//! How hard a plan accelerates and brakes, and how far it exceeds speed limits.
//!
//! Speeds are distances over half a second, from half a second before *now* on, and an acceleration is the difference of two
//! that follow each other. It counts if it lasts: the least of five in a row, half a second. Recorded positions are too noisy
//! for less. Of 888 recorded vehicles 1.7 % break one of the limits, or that of the lateral acceleration
//! (`cargo run --release -p sage-data --example recorded_limits`).

use super::{Candidate, Context, naturalness::lane_limit_at, turning::Excess};
use crate::{
    geometry::{Point, distance},
    motion::{DT, NOW},
};

/// Largest acceleration that lasts half a second, m/s².
pub const ACCELERATION: f64 = 5.5;
/// Largest deceleration that lasts half a second, m/s².
pub const BRAKING: f64 = 7.0;
/// Largest speed relative to the limit of the lane.
pub const SPEEDING: f64 = 1.75;
/// Steps of half a second.
const HALF: usize = 5;

/// Whether a plan accelerates by more than a limit, m/s².
pub fn hard_acceleration(candidate: &Candidate, ctx: &Context, limit: f64) -> Option<Excess> {
    lasting(&accelerations(candidate, ctx), limit)
}

/// Whether a plan brakes by more than a limit, m/s².
pub fn hard_braking(candidate: &Candidate, ctx: &Context, limit: f64) -> Option<Excess> {
    let braking: Vec<_> = accelerations(candidate, ctx).iter().map(|(step, a)| (*step, -a)).collect();
    lasting(&braking, limit)
}

/// Whether a plan is faster than so many times the limit of the lane that it is on. The value is that ratio.
pub fn speeding(candidate: &Candidate, ctx: &Context, limit: f64) -> Option<Excess> {
    let points = candidate.points();
    let ratios = (HALF..points.len()).filter_map(|k| {
        let speed = distance(points[k], points[k - HALF]) / (HALF as f64 * DT);
        let allowed = lane_limit_at(ctx, points[k], candidate.profile().axis[k])?;
        Some((k + 1, speed / allowed))
    });
    Excess::of(ratios, limit)
}

/// Accelerations with the steps at which they are known, m/s².
fn accelerations(candidate: &Candidate, ctx: &Context) -> Vec<(usize, f64)> {
    let track = ctx.adversary();
    let first = (NOW - HALF..NOW).rev().take_while(|frame| track.is_valid(*frame)).last().unwrap_or(NOW);
    let before = (first..NOW).map(|frame| track.point(frame));
    let now = candidate.start().position;
    let points: Vec<Point> = before.chain([now]).chain(candidate.points().iter().copied()).collect();
    let seconds = HALF as f64 * DT;
    let speed = |k: usize| distance(points[k + HALF], points[k]) / seconds;
    let last = points.len().saturating_sub(2 * HALF);
    // A point `k` is that of frame `first + k`.
    (0..last).map(|k| (first + k + 2 * HALF - NOW, (speed(k + HALF) - speed(k)) / seconds)).collect()
}

/// A value that is exceeded by five in a row.
fn lasting(values: &[(usize, f64)], limit: f64) -> Option<Excess> {
    let least = |row: &[(usize, f64)]| {
        let least = row.iter().map(|(_, value)| *value).fold(f64::INFINITY, f64::min);
        (row[HALF - 1].0, least)
    };
    Excess::of(values.windows(HALF).map(least), limit)
}
