//! Candidates of a target, and their distances from its recorded future.

use std::sync::Arc;

use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
    seed::Rng,
};

use crate::{
    Error,
    backbone::{Backbone, MotionModel, finite, trajectories_in_world},
    candidates::{Sampling, select},
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
    /// End point of the mode, metres, world frame.
    pub goal: Point,
    /// Trajectory of the mode, world frame.
    pub trajectory: Trajectory,
}

/// Selects `k` modes of a target and decodes them, the likeliest first.
///
/// *Errors*: those of the network; [`Error::NotFinite`] if its probabilities are not finite.
pub fn predict(
    network: &dyn Backbone,
    features: Arc<Features>,
    k: usize,
    selection: Sampling,
    rng: &mut Rng,
) -> Result<Vec<Predicted>, Error> {
    let encoding = network.encode(features)?;
    propose(network, &encoding, k, selection, rng)
}

/// As [`predict`], from an encoding.
///
/// *Errors*: as [`predict`].
pub fn propose(
    network: &dyn MotionModel,
    encoding: &Encoding,
    k: usize,
    selection: Sampling,
    rng: &mut Rng,
) -> Result<Vec<Predicted>, Error> {
    let log_probs: Vec<f32> = finite(&network.log_probs(encoding)?)?;
    let ends = network.mode_ends(encoding)?;
    let modes = select(&log_probs, &ends, k, selection, rng);
    let features = encoding.features();
    let trajectories = trajectories_in_world(&network.trajectories(encoding, &modes)?, features)?;
    let predicted = |(mode, trajectory): (usize, Trajectory)| Predicted {
        mode,
        log_prob: log_probs[mode],
        goal: features.frame.world_from_frame(ends[mode].map(f64::from)),
        trajectory,
    };
    Ok(modes.into_iter().zip(trajectories).map(predicted).collect())
}

/// Distances of predicted trajectories from the recorded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distances {
    /// Least mean distance over the recorded steps, metres.
    pub min_ade: f64,
    /// Least distance at the last step, metres.
    pub min_fde: f64,
    /// Whether every trajectory ends more than 2 m away.
    pub misses: bool,
    /// Whether every trajectory is a miss by WOMD's rule ([`womd_hit`]).
    pub misses_womd: bool,
}

/// Recorded future of a target.
///
/// How good predictions are, by the best of them:
///
/// ```
/// use sage_backbones::prediction::Recorded;
///
/// let drive = |speed: f64| -> Vec<[f64; 2]> { (1..=80).map(|t| [0.1 * speed * f64::from(t), 0.0]).collect() };
/// let recorded = Recorded { positions: drive(10.0), valid: vec![true; 80], heading: 0.0, speed: 10.0 };
/// let (near, far) = (drive(10.1), drive(5.0));
/// let distances = recorded.distances([&near[..], &far[..]]);
/// // 0.1 m/s too fast for 8 s; more than 2 m at the end would be a miss.
/// assert!((distances.min_fde - 0.8).abs() < 1e-9 && !distances.misses);
/// assert!(recorded.distances([&far[..]]).misses);
/// ```
#[derive(Clone, Debug)]
pub struct Recorded {
    /// Positions at the 80 steps, world frame; arbitrary where not valid.
    pub positions: Vec<Point>,
    /// Whether each step was recorded. The last must be.
    pub valid: Vec<bool>,
    /// Heading at the last step, radians.
    pub heading: f64,
    /// Speed *now*, m/s.
    pub speed: f64,
}

impl Recorded {
    /// Least distances over some trajectories. Each measure takes its own minimum.
    pub fn distances<'p>(&self, trajectories: impl IntoIterator<Item = &'p [Point]>) -> Distances {
        let mut best =
            Distances { min_ade: f64::INFINITY, min_fde: f64::INFINITY, misses: true, misses_womd: true };
        let steps = self.valid.iter().filter(|v| **v).count().max(1) as f64;
        for trajectory in trajectories {
            let gap = |step: usize| sage_core::geometry::distance(trajectory[step], self.positions[step]);
            let sum: f64 = (0..HORIZON).filter(|step| self.valid[*step]).map(gap).sum();
            let last = gap(HORIZON - 1);
            best.min_ade = best.min_ade.min(sum / steps);
            best.min_fde = best.min_fde.min(last);
            best.misses &= last > 2.0;
            let end = self.positions[HORIZON - 1];
            let offset = [trajectory[HORIZON - 1][0] - end[0], trajectory[HORIZON - 1][1] - end[1]];
            best.misses_womd &= !womd_hit(offset, self.heading, self.speed);
        }
        best
    }
}

/// WOMD's hit at 8 s: at most 6 m along and 3 m across the true heading, scaled by the speed *now*:
/// × 0.5 below 1.4 m/s, × 1 above 11 m/s, linear between.
pub fn womd_hit(offset: Point, heading: f64, speed: f64) -> bool {
    let scale = (0.5 + 0.5 * (speed - 1.4) / (11.0 - 1.4)).clamp(0.5, 1.0);
    let (sin, cos) = heading.sin_cos();
    let along = cos * offset[0] + sin * offset[1];
    let across = cos * offset[1] - sin * offset[0];
    along.abs() <= 6.0 * scale && across.abs() <= 3.0 * scale
}
