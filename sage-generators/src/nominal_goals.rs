//! The plans of the nominal density: every goal of a motion prior with its probability and its own trajectory.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    backbone::{finite, trajectories_in_world},
    encoding::Encoding,
};
use sage_core::{
    Error,
    generator::{Observation, Proposal},
    geometry::Point,
};

/// Where a prior expects a track to be at the end of the future.
#[derive(Clone, Debug)]
pub struct GoalDensity {
    /// All goals, metres, world frame.
    pub goals: Vec<Point>,
    /// Their log-probabilities; the probabilities sum to 1.
    pub log_probs: Vec<f64>,
}

/// The density of a prior over the goals of a track.
///
/// *Errors*: [`Error::Scene`] if the track is not valid *now* or the network's output is not finite.
pub fn goal_density(prior: &dyn Backbone, now: &Observation, track: usize) -> Result<GoalDensity, Error> {
    density(prior, now, track).map(|(density, _)| density).map_err(|error| in_scene(error, now))
}

/// All goals of an untuned prior for the adversary and the trajectory of each. Nothing is left out or retimed.
///
/// *Errors*: [`Error::Scene`] for a scene without an adversary that is valid *now*, or for which the network's output is not finite.
pub fn nominal_goals(prior: &dyn Backbone, now: &Observation) -> Result<Vec<Proposal>, Error> {
    let adversary = now.scene().adversary_index()?;
    let propose = || -> Result<Vec<Proposal>, sage_backbones::Error> {
        let (GoalDensity { goals, log_probs }, encoding) = density(prior, now, adversary)?;
        let modes: Vec<usize> = (0..goals.len()).collect();
        let trajectories = prior.trajectories(&encoding, &modes)?;
        let trajectories = trajectories_in_world(&trajectories, encoding.features())?;
        let plan = |((trajectory, goal), log_prob): ((_, Point), f64)| Proposal {
            goal: Some(goal),
            log_prob: Some(log_prob),
            nll: Some(-log_prob),
            ..Proposal::of(trajectory)
        };
        Ok(trajectories.into_iter().zip(goals).zip(log_probs).map(plan).collect())
    };
    propose().map_err(|error| in_scene(error, now))
}

fn density(
    prior: &dyn Backbone,
    now: &Observation,
    track: usize,
) -> Result<(GoalDensity, Encoding), sage_backbones::Error> {
    let encoding = prior.encode(Arc::new(prior.features(now, track, None)?))?;
    let log_probs = finite(&prior.log_probs(&encoding)?)?;
    let frame = &encoding.features().frame;
    let ends = prior.mode_ends(&encoding)?;
    let goals = ends.iter().map(|end| frame.world_from_frame(end.map(f64::from))).collect();
    Ok((GoalDensity { goals, log_probs }, encoding))
}

fn in_scene(error: sage_backbones::Error, now: &Observation) -> Error {
    match error {
        sage_backbones::Error::Core(error) => error,
        other => Error::Scene { scene: now.scene().id.clone(), problem: other.to_string() },
    }
}
