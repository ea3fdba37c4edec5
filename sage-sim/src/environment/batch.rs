//! Many environments at once, over flat columns.

use std::sync::Arc;

use rayon::prelude::*;
use sage_core::{Error as CoreError, seed::Rng};

use super::{Environment, EnvironmentOptions, Outcome};
use crate::{Error, observation::LENGTH, scene::SimScene, traffic::Plan, vehicle::Action};

/// What happens after the last step of an episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum AutoReset {
    /// Nothing: a step of an episode that is over is an error; [`Batch::reset_one`] starts another.
    #[default]
    Off,
    /// The same step starts the next episode. Its first observation is returned; the last one of the
    /// finished episode is in [`BatchOutput::final_observations`].
    SameStep,
}

/// Environments that step together. Results do not depend on the number of threads.
pub struct Batch {
    shared: Shared,
    slots: Vec<Slot>,
}

struct Slot {
    environment: Environment,
    /// Number of the episode, and of its scene.
    episode: u64,
    scene: usize,
    episode_return: f64,
}

/// Columns of a step: one row for each environment. Reuse it, so that its memory is allocated once.
#[derive(Clone, Debug, Default)]
pub struct BatchOutput {
    /// Observations, n × 101.
    pub observations: Vec<f32>,
    /// Rewards.
    pub rewards: Vec<f64>,
    /// Terminations.
    pub terminated: Vec<bool>,
    /// Truncations.
    pub truncated: Vec<bool>,
    /// Everything else that is known about the step.
    pub info: BatchInfo,
    /// Last observations of the episodes that ended in this step, n × 101; other rows keep old values.
    pub final_observations: Vec<f32>,
}

/// Columns of information; units as in [`Outcome`].
#[derive(Clone, Debug, Default)]
pub struct BatchInfo {
    /// Number of the scene of each episode, before any automatic reset.
    pub scenes: Vec<usize>,
    /// Sum of the rewards of the episode so far.
    pub episode_returns: Vec<f64>,
    /// Length of the episode so far.
    pub episode_steps: Vec<usize>,
    /// Costs.
    pub costs: Vec<f64>,
    /// Whether the car arrived.
    pub arrived: Vec<bool>,
    /// Whether it is off the road.
    pub out_of_road: Vec<bool>,
    /// Whether it touched a vehicle.
    pub vehicle_contact: Vec<bool>,
    /// Whether it touched a pedestrian or cyclist.
    pub human_contact: Vec<bool>,
    /// Whether it touched an object.
    pub object_contact: Vec<bool>,
    /// Share of the route behind the car.
    pub completion: Vec<f64>,
    /// Progress along the route in the step, metres.
    pub progress: Vec<f64>,
    /// Distance to the logged position at the same frame, metres.
    pub distance_to_log: Vec<f64>,
}

impl BatchOutput {
    fn resize(&mut self, n: usize) {
        self.observations.resize(n * LENGTH, 0.0);
        self.final_observations.resize(n * LENGTH, 0.0);
        let info = &mut self.info;
        for numbers in [
            &mut self.rewards,
            &mut info.episode_returns,
            &mut info.costs,
            &mut info.completion,
            &mut info.progress,
            &mut info.distance_to_log,
        ] {
            numbers.resize(n, 0.0);
        }
        for flags in [
            &mut self.terminated,
            &mut self.truncated,
            &mut info.arrived,
            &mut info.out_of_road,
            &mut info.vehicle_contact,
            &mut info.human_contact,
            &mut info.object_contact,
        ] {
            flags.resize(n, false);
        }
        info.scenes.resize(n, 0);
        info.episode_steps.resize(n, 0);
    }

    fn write(&mut self, k: usize, row: &StepRow) {
        let (outcome, info) = (&row.outcome, &mut self.info);
        self.rewards[k] = outcome.reward;
        self.terminated[k] = outcome.terminated;
        self.truncated[k] = outcome.truncated;
        info.scenes[k] = row.scene;
        info.episode_returns[k] = row.episode_return;
        info.episode_steps[k] = row.steps;
        info.costs[k] = outcome.cost;
        info.arrived[k] = outcome.arrived;
        info.out_of_road[k] = outcome.out_of_road;
        info.vehicle_contact[k] = outcome.vehicle_contact;
        info.human_contact[k] = outcome.human_contact;
        info.object_contact[k] = outcome.object_contact;
        info.completion[k] = outcome.completion;
        info.progress[k] = outcome.progress;
        info.distance_to_log[k] = outcome.distance_to_log;
    }
}

impl Batch {
    /// `count` environments. The scene of each episode is drawn from the seed, the environment's number and
    /// the episode's number.
    ///
    /// *Errors*: [`CoreError::Options`] without scenes; a scene that cannot start, as
    /// [`Environment::reset`]. Every scene is tried.
    pub fn new(
        scenes: Vec<Arc<SimScene>>,
        options: Arc<EnvironmentOptions>,
        auto_reset: AutoReset,
        count: usize,
        seed: u64,
    ) -> Result<Self, Error> {
        if scenes.is_empty() {
            let problem = "there are no scenes; give at least one".to_owned();
            return Err(CoreError::Options { kind: "simulation", name: "batch", problem }.into());
        }
        let shared = Shared { scenes, options, auto_reset, seed };
        for scene in 0..shared.scenes.len() {
            shared.started(0, 0, Some(scene), None)?;
        }
        let slots =
            (0..count).map(|number| shared.started(number, 0, None, None)).collect::<Result<_, _>>()?;
        Ok(Self { shared, slots })
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Whether there is no environment.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// An environment; `None` for a number out of range.
    pub fn environment(&self, number: usize) -> Option<&Environment> {
        self.slots.get(number).map(|slot| &slot.environment)
    }

    /// Starts another episode of one environment, in a given scene or a drawn one, and with a plan in place
    /// of a track's log.
    ///
    /// *Errors*: [`CoreError::Options`] for a number out of range; as [`Environment::reset`].
    pub fn reset_one(
        &mut self,
        number: usize,
        scene: Option<usize>,
        plan: Option<Arc<Plan>>,
    ) -> Result<(), Error> {
        let scenes = self.shared.scenes.len();
        let count = self.slots.len();
        let Some(slot) = self.slots.get_mut(number).filter(|_| scene.is_none_or(|scene| scene < scenes))
        else {
            let problem = format!(
                "environment {number}, scene {scene:?}; there are {count} environments and {scenes} scenes"
            );
            return Err(CoreError::Options { kind: "simulation", name: "batch", problem }.into());
        };
        slot.episode += 1;
        *slot = self.shared.started(number, slot.episode, scene, plan)?;
        Ok(())
    }

    /// Writes the observations of all environments.
    pub fn observe(&self, out: &mut BatchOutput) {
        out.resize(self.len());
        let rows = out.observations.as_chunks_mut::<LENGTH>().0;
        self.slots.par_iter().zip(rows).for_each(|(slot, row)| slot.environment.observe(row));
    }

    /// Steps every environment, in the caller's thread pool: one (steering, throttle) each.
    ///
    /// *Errors*: [`CoreError::Length`] for another number of actions, before any step. Otherwise the first
    /// environment that fails, as [`Environment::step`]; the rows of all others are written.
    pub fn step(&mut self, actions: &[[f32; 2]], out: &mut BatchOutput) -> Result<(), Error> {
        let (found, expected) = (actions.len(), self.len());
        if found != expected {
            return Err(CoreError::Length { what: "actions".to_owned(), found, expected }.into());
        }
        out.resize(expected);
        let shared = &self.shared;
        let rows = self
            .slots
            .par_iter_mut()
            .zip(out.observations.as_chunks_mut::<LENGTH>().0)
            .zip(out.final_observations.as_chunks_mut::<LENGTH>().0)
            .zip(actions);
        let results: Vec<Result<StepRow, Error>> = rows
            .enumerate()
            // Steps differ in cost by a factor of ten; whole halves of the batch would be uneven.
            .with_max_len(1)
            .map(|(number, (((slot, observation), last), action))| {
                shared.step(number, slot, *action, observation, last)
            })
            .collect();
        let mut failed = None;
        for (k, row) in results.into_iter().enumerate() {
            match row {
                Ok(row) => out.write(k, &row),
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        failed.map_or(Ok(()), Err)
    }
}

/// What all environments of a batch share.
struct Shared {
    scenes: Vec<Arc<SimScene>>,
    options: Arc<EnvironmentOptions>,
    auto_reset: AutoReset,
    seed: u64,
}

struct StepRow {
    outcome: Outcome,
    scene: usize,
    episode_return: f64,
    steps: usize,
}

impl Shared {
    fn started(
        &self,
        number: usize,
        episode: u64,
        scene: Option<usize>,
        plan: Option<Arc<Plan>>,
    ) -> Result<Slot, Error> {
        let mut rng = Rng::new(self.seed, &format!("{number}/{episode}"), "episodes");
        let drawn = rng.below(self.scenes.len());
        let scene = scene.unwrap_or(drawn);
        let environment =
            Environment::reset(self.scenes[scene].clone(), self.options.clone(), plan, rng.bits())?;
        Ok(Slot { environment, episode, scene, episode_return: 0.0 })
    }

    fn step(
        &self,
        number: usize,
        slot: &mut Slot,
        [steer, throttle]: [f32; 2],
        observation: &mut [f32; LENGTH],
        last: &mut [f32; LENGTH],
    ) -> Result<StepRow, Error> {
        let action = Action { steer: f64::from(steer), throttle: f64::from(throttle) };
        let outcome = slot.environment.step(action)?;
        slot.episode_return += outcome.reward;
        let steps = slot.environment.world().step_count();
        let row = StepRow { outcome, scene: slot.scene, episode_return: slot.episode_return, steps };
        if slot.environment.is_over() {
            slot.environment.observe(last);
            if self.auto_reset == AutoReset::SameStep {
                *slot = self.started(number, slot.episode + 1, None, None)?;
            }
        }
        slot.environment.observe(observation);
        Ok(row)
    }
}
