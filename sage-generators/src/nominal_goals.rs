//! The plans of the nominal density: every goal of a motion prior with its probability, its own trajectory, and that at other times.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    backbone::{finite, trajectories_in_world},
    encoding::Encoding,
};
use sage_core::{
    Error,
    generator::{Observation, Proposal},
    geometry::{Point, distance},
    motion::{NOW, Trajectory},
};

use crate::TimedPath;

/// Where a prior expects a track to be at the end of the future.
#[derive(Clone, Debug)]
pub struct GoalDensity {
    /// All goals, metres, world frame.
    pub goals: Vec<Point>,
    /// Their log-probabilities; the probabilities sum to 1.
    pub log_probs: Vec<f64>,
}

impl GoalDensity {
    /// The goal that is nearest to a point; `None` without goals.
    pub fn nearest(&self, point: Point) -> Option<usize> {
        let from = |goal: &usize| distance(self.goals[*goal], point);
        (0..self.goals.len()).min_by(|a, b| from(a).total_cmp(&from(b)))
    }
}

/// The density of a prior over the goals of a track.
///
/// *Errors*: [`Error::Scene`] if the track is not valid *now* or the network's output is not finite.
pub fn goal_density(prior: &dyn Backbone, now: &Observation, track: usize) -> Result<GoalDensity, Error> {
    density(prior, now, track).map(|(density, _)| density).map_err(|error| in_scene(error, now))
}

/// The trajectory of a prior for a track to the goal that is nearest to a point; `None` without goals.
///
/// *Errors*: as for [`goal_density`].
pub fn trajectory_to(
    prior: &dyn Backbone,
    now: &Observation,
    track: usize,
    end: Point,
) -> Result<Option<Trajectory>, Error> {
    let predict = || -> Result<Option<Trajectory>, sage_backbones::Error> {
        let (density, encoding) = density(prior, now, track)?;
        let Some(goal) = density.nearest(end) else { return Ok(None) };
        let trajectories = prior.trajectories(&encoding, &[goal])?;
        Ok(trajectories_in_world(&trajectories, encoding.features())?.pop())
    };
    predict().map_err(|error| in_scene(error, now))
}

/// All goals of an untuned prior for a track at a temperature (log-probabilities up to a constant) with the trajectory of each,
/// as often as there are shifts (metres, [`TimedPath::shifted`]), all equally likely; each with its shift. Shifts that give a goal the
/// same plan are one plan.
///
/// *Errors*: as for [`goal_density`].
pub fn nominal_plans(
    prior: &dyn Backbone,
    now: &Observation,
    track: usize,
    temperature: f64,
    shifts: &[f64],
) -> Result<Vec<(Proposal, f64)>, Error> {
    let start = now.scene().tracks[track].point(NOW);
    let propose = || -> Result<Vec<(Proposal, f64)>, sage_backbones::Error> {
        let (GoalDensity { goals, log_probs }, encoding) = density(prior, now, track)?;
        let modes: Vec<usize> = (0..goals.len()).collect();
        let trajectories = prior.trajectories(&encoding, &modes)?;
        let trajectories = trajectories_in_world(&trajectories, encoding.features())?;
        let mut all = Vec::with_capacity(goals.len() * shifts.len());
        for ((trajectory, goal), log_prob) in trajectories.into_iter().zip(goals).zip(log_probs) {
            for (trajectory, shift, count) in timed(start, &trajectory, shifts)? {
                let log_prob = Some(log_prob / temperature + (count as f64 / shifts.len() as f64).ln());
                let plan = Proposal { goal: Some(goal), log_prob, ..Proposal::of(trajectory) };
                all.push((plan, shift));
            }
        }
        Ok(all)
    };
    propose().map_err(|error| in_scene(error, now))
}

/// The different plans that shifts make of a trajectory, each with its first shift and how many make it.
fn timed(
    start: Point,
    trajectory: &Trajectory,
    shifts: &[f64],
) -> Result<Vec<(Trajectory, f64, usize)>, Error> {
    let path = TimedPath::new(start, trajectory);
    let mut all: Vec<(Trajectory, f64, usize)> = Vec::with_capacity(shifts.len());
    for shift in shifts {
        // The trajectory itself to the bit, not its path read at its own steps.
        let plan = if *shift == 0.0 { trajectory.clone() } else { path.shifted(*shift)? };
        match all.iter_mut().find(|(other, ..)| *other == plan) {
            Some((_, _, count)) => *count += 1,
            None => all.push((plan, *shift, 1)),
        }
    }
    Ok(all)
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
