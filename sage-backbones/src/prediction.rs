//! Candidates of a target, and how far they are from what it did.

use std::sync::Arc;

use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
    seed::Rng,
};

use crate::{
    Error,
    backbone::{MotionModel, finite, to_world},
    candidates::{Selection, choose},
    encoding::Encoding,
    features::Features,
};

/// One predicted future.
#[derive(Clone, Debug)]
pub struct Predicted {
    /// Its mode.
    pub mode: usize,
    /// Log-probability of the mode among all modes.
    pub log_prob: f32,
    /// Where the mode ends, metres, world frame.
    pub goal: Point,
    /// The way there, world frame.
    pub trajectory: Trajectory,
}

/// Chooses `k` modes of a target and decodes them, the likeliest first.
///
/// *Errors*: those of the network; [`Error::Training`] if its probabilities are not finite.
pub fn predict(
    network: &dyn MotionModel,
    features: Arc<Features>,
    k: usize,
    selection: Selection,
    rng: &mut Rng,
) -> Result<Vec<Predicted>, Error> {
    let encoding = network.encode(features)?;
    propose(network, &encoding, k, selection, rng)
}

/// As [`predict`], from surroundings that were read before.
///
/// *Errors*: as [`predict`].
pub fn propose(
    network: &dyn MotionModel,
    encoding: &Encoding,
    k: usize,
    selection: Selection,
    rng: &mut Rng,
) -> Result<Vec<Predicted>, Error> {
    let log_probs: Vec<f32> = finite(&network.log_probs(encoding)?)?;
    let ends = network.mode_ends(encoding)?;
    let modes = choose(&log_probs, &ends, k, selection, rng);
    let features = encoding.features();
    let paths = to_world(&network.trajectories(encoding, &modes)?, features)?;
    let predicted = |(mode, trajectory): (usize, Trajectory)| Predicted {
        mode,
        log_prob: log_probs[mode],
        goal: features.frame.to_world(ends[mode].map(f64::from)),
        trajectory,
    };
    Ok(modes.into_iter().zip(paths).map(predicted).collect())
}

/// Distances of predicted paths from a recorded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distances {
    /// Least mean distance over the recorded steps, metres.
    pub min_ade: f64,
    /// Least distance at the last step, metres.
    pub min_fde: f64,
    /// Whether every path ends more than 2 m away.
    pub misses: bool,
    /// Whether every path misses by WOMD's measure ([`womd_hit`]).
    pub misses_womd: bool,
}

/// What was recorded of a target's future.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// Positions at the 80 steps, world frame; anything where not valid.
    pub positions: Vec<Point>,
    /// Which were recorded; the last must be.
    pub valid: Vec<bool>,
    /// Heading at the last step, radians.
    pub heading: f64,
    /// Speed *now*, m/s.
    pub speed: f64,
}

impl Recorded {
    /// Distances of the best of some paths, each measure by its own best.
    pub fn distances<'p>(&self, paths: impl IntoIterator<Item = &'p [Point]>) -> Distances {
        let mut best =
            Distances { min_ade: f64::INFINITY, min_fde: f64::INFINITY, misses: true, misses_womd: true };
        let steps = self.valid.iter().filter(|v| **v).count().max(1) as f64;
        for path in paths {
            let gap = |step: usize| sage_core::geometry::distance(path[step], self.positions[step]);
            let sum: f64 = (0..HORIZON).filter(|step| self.valid[*step]).map(gap).sum();
            let last = gap(HORIZON - 1);
            best.min_ade = best.min_ade.min(sum / steps);
            best.min_fde = best.min_fde.min(last);
            best.misses &= last > 2.0;
            let end = self.positions[HORIZON - 1];
            let away = [path[HORIZON - 1][0] - end[0], path[HORIZON - 1][1] - end[1]];
            best.misses_womd &= !womd_hit(away, self.heading, self.speed);
        }
        best
    }
}

/// WOMD's hit at 8 s: at most 6 m along and 3 m across the true heading, scaled by the speed *now*:
/// × 0.5 below 1.4 m/s, × 1 above 11 m/s, linear between.
pub fn womd_hit(away: Point, heading: f64, speed: f64) -> bool {
    let scale = (0.5 + 0.5 * (speed - 1.4) / (11.0 - 1.4)).clamp(0.5, 1.0);
    let (sin, cos) = heading.sin_cos();
    let along = cos * away[0] + sin * away[1];
    let across = cos * away[1] - sin * away[0];
    along.abs() <= 6.0 * scale && across.abs() <= 3.0 * scale
}
