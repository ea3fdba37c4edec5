//! Many environments at once, over flat slices.

use std::sync::Arc;

use rayon::prelude::*;
use sage_core::{Error, seed::Rng};

use super::{Environment, EnvironmentOptions, Outcome};
use crate::{observation::LENGTH, scene::SimScene, vehicle::Action};

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
    scenes: Vec<Arc<SimScene>>,
    options: Arc<EnvironmentOptions>,
    auto_reset: AutoReset,
    seed: u64,
    slots: Vec<Slot>,
}

struct Slot {
    environment: Environment,
    /// Number of the episode, and of its scene.
    episode: u64,
    scene: usize,
    episode_return: f64,
}

/// Columns of a step: one row an environment.
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
    /// All that is known about the step.
    pub outcomes: Vec<Outcome>,
    /// Number of the scene of each environment's episode, before any automatic reset.
    pub scenes: Vec<usize>,
    /// Sum of the rewards of the episode so far.
    pub episode_returns: Vec<f64>,
    /// Length of the episode so far.
    pub episode_steps: Vec<usize>,
    /// Last observations of the episodes that ended in this step, n × 101; other rows keep old values.
    pub final_observations: Vec<f32>,
}

impl BatchOutput {
    fn resize(&mut self, n: usize) {
        self.observations.resize(n * LENGTH, 0.0);
        self.final_observations.resize(n * LENGTH, 0.0);
        self.rewards.resize(n, 0.0);
        self.terminated.resize(n, false);
        self.truncated.resize(n, false);
        self.outcomes.resize(n, Outcome::default());
        self.scenes.resize(n, 0);
        self.episode_returns.resize(n, 0.0);
        self.episode_steps.resize(n, 0);
    }
}

impl Batch {
    /// `count` environments. The scene of each episode is drawn from the seed, the environment's number and
    /// the episode's number.
    ///
    /// *Errors*: [`Error::Options`] without scenes; a scene that cannot start, as
    /// [`Environment::reset`].
    pub fn new(
        scenes: Vec<Arc<SimScene>>,
        options: Arc<EnvironmentOptions>,
        auto_reset: AutoReset,
        count: usize,
        seed: u64,
    ) -> Result<Self, Error> {
        if scenes.is_empty() {
            let problem = "there are no scenes; give at least one".to_owned();
            return Err(Error::Options { kind: "simulation", name: "batch", problem });
        }
        let mut batch = Self { scenes, options, auto_reset, seed, slots: Vec::new() };
        for number in 0..count {
            let slot = batch.started(number, 0, None)?;
            batch.slots.push(slot);
        }
        Ok(batch)
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Whether there is no environment.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// An environment.
    pub fn environment(&self, number: usize) -> &Environment {
        &self.slots[number].environment
    }

    /// Starts another episode of one environment, in a given scene or a drawn one.
    ///
    /// *Errors*: [`Error::Options`] for a number out of range; as [`Environment::reset`].
    pub fn reset_one(&mut self, number: usize, scene: Option<usize>) -> Result<(), Error> {
        if number >= self.slots.len() || scene.is_some_and(|scene| scene >= self.scenes.len()) {
            let problem = format!(
                "environment {number}, scene {scene:?}; there are {} environments and {} scenes",
                self.slots.len(),
                self.scenes.len()
            );
            return Err(Error::Options { kind: "simulation", name: "batch", problem });
        }
        let episode = self.slots[number].episode + 1;
        self.slots[number] = self.started(number, episode, scene)?;
        Ok(())
    }

    /// Writes the observations of all environments.
    pub fn observe(&self, out: &mut BatchOutput) {
        out.resize(self.len());
        for (slot, row) in self.slots.iter().zip(out.observations.chunks_exact_mut(LENGTH)) {
            slot.environment.observe(row);
        }
    }

    /// Steps every environment, in the caller's thread pool: one (steering, throttle) each.
    ///
    /// *Errors*: [`Error::Length`] for another number of actions; the first environment that fails, as
    /// [`Environment::step`]. The others have stepped.
    pub fn step(&mut self, actions: &[[f32; 2]], out: &mut BatchOutput) -> Result<(), Error> {
        let (found, expected) = (actions.len(), self.len());
        if found != expected {
            return Err(Error::Length { what: "actions".to_owned(), found, expected });
        }
        out.resize(expected);
        let shared = Shared {
            scenes: &self.scenes,
            options: &self.options,
            auto_reset: self.auto_reset,
            seed: self.seed,
        };
        let rows = self
            .slots
            .par_iter_mut()
            .zip(out.observations.par_chunks_exact_mut(LENGTH))
            .zip(out.final_observations.par_chunks_exact_mut(LENGTH))
            .zip(actions);
        let results: Vec<Result<Row, Error>> = rows
            .enumerate()
            // Steps differ in cost by a factor of ten; whole halves of the batch would be uneven.
            .with_max_len(1)
            .map(|(number, (((slot, observation), last), action))| {
                shared.step(number, slot, *action, observation, last)
            })
            .collect();
        for (k, row) in results.into_iter().enumerate() {
            let row = row?;
            out.rewards[k] = row.outcome.reward;
            out.terminated[k] = row.outcome.terminated;
            out.truncated[k] = row.outcome.truncated;
            out.outcomes[k] = row.outcome;
            out.scenes[k] = row.scene;
            out.episode_returns[k] = row.episode_return;
            out.episode_steps[k] = row.steps;
        }
        Ok(())
    }

    fn started(&self, number: usize, episode: u64, scene: Option<usize>) -> Result<Slot, Error> {
        let shared = Shared {
            scenes: &self.scenes,
            options: &self.options,
            auto_reset: self.auto_reset,
            seed: self.seed,
        };
        shared.started(number, episode, scene)
    }
}

/// What all environments of a batch share.
struct Shared<'a> {
    scenes: &'a [Arc<SimScene>],
    options: &'a Arc<EnvironmentOptions>,
    auto_reset: AutoReset,
    seed: u64,
}

struct Row {
    outcome: Outcome,
    scene: usize,
    episode_return: f64,
    steps: usize,
}

impl Shared<'_> {
    fn started(&self, number: usize, episode: u64, scene: Option<usize>) -> Result<Slot, Error> {
        let mut rng = Rng::new(self.seed, &format!("{number}/{episode}"), "episodes");
        let drawn = rng.below(self.scenes.len());
        let scene = scene.unwrap_or(drawn);
        let environment =
            Environment::reset(self.scenes[scene].clone(), self.options.clone(), None, rng.bits())?;
        Ok(Slot { environment, episode, scene, episode_return: 0.0 })
    }

    fn step(
        &self,
        number: usize,
        slot: &mut Slot,
        [steer, throttle]: [f32; 2],
        observation: &mut [f32],
        last: &mut [f32],
    ) -> Result<Row, Error> {
        let action = Action { steer: f64::from(steer), throttle: f64::from(throttle) };
        let outcome = slot.environment.step(action)?;
        slot.episode_return += outcome.reward;
        let steps = slot.environment.world().step_count();
        let row = Row { outcome, scene: slot.scene, episode_return: slot.episode_return, steps };
        if slot.environment.is_over() {
            slot.environment.observe(last);
            if self.auto_reset == AutoReset::SameStep {
                *slot = self.started(number, slot.episode + 1, None)?;
            }
        }
        slot.environment.observe(observation);
        Ok(row)
    }
}
