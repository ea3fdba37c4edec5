//! Options of a training run.

use serde::{Deserialize, Serialize};

use super::Td3Options;
use crate::environment::EnvironmentOptions;

/// Options of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingOptions {
    /// The algorithm.
    pub td3: Td3Options,
    /// Updates in all.
    pub updates: u64,
    /// Updates per step of the environment.
    pub ratio: f64,
    /// Environments that take turns.
    pub environments: usize,
    /// Largest number of steps of an episode; above 91 it goes on after the end of the recording, without traffic.
    pub max_steps: usize,
    /// Whether the limit of steps is stored as a terminal step, as published.
    pub limit_is_terminal: bool,
    /// Newest drives of a scene that may be attacked; one of them is drawn.
    #[serde(alias = "paths")]
    pub drives: usize,
    /// Age of a scene's newest drive, in steps, above which the present policy first drives the unchanged scene, so that the
    /// attack meets what it does now; `None` for never, as published.
    pub refresh_after: Option<u64>,
    /// Evaluations during training, evenly spaced; the last one is at the end.
    pub evaluations: u64,
    /// Seed of initial weights, scenes, noise and batches.
    pub seed: u64,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            td3: Td3Options::default(),
            updates: 100_000,
            ratio: 1.0,
            environments: 1,
            max_steps: 91,
            limit_is_terminal: false,
            drives: 1,
            refresh_after: None,
            evaluations: 20,
            seed: 0,
        }
    }
}

impl TrainingOptions {
    /// Steps of the environments in all: the random ones, and those with updates.
    pub fn steps(&self) -> u64 {
        self.td3.random_steps + (self.updates as f64 / self.ratio).ceil() as u64
    }

    /// Checks all numbers.
    ///
    /// *Errors*: the name and value of an option that is out of range, and what is expected.
    pub fn check(&self) -> Result<(), String> {
        self.td3.check()?;
        if !(self.ratio >= 1.0 / 64.0 && self.ratio <= 64.0) {
            return Err(format!("`ratio` is {}; expected a number from 1/64 to 64", self.ratio));
        }
        let counts = [
            ("environments", self.environments, 1, 1024),
            ("max_steps", self.max_steps, 2, 10_000),
            ("drives", self.drives, 1, 100),
            ("evaluations", self.evaluations as usize, 1, 1000),
        ];
        if let Some((name, value, least, most)) =
            counts.into_iter().find(|(_, value, least, most)| !(least..=most).contains(&value))
        {
            return Err(format!("`{name}` is {value}; expected a number from {least} to {most}"));
        }
        let steps = self.steps() - self.td3.random_steps;
        if steps < self.td3.random_steps {
            return Err(format!(
                "{} updates at a ratio of {} are {steps} steps, fewer than the {} random steps at the start; give more updates or fewer random steps",
                self.updates, self.ratio, self.td3.random_steps
            ));
        }
        Ok(())
    }

    /// Rules of the training episodes.
    pub fn rules(&self) -> EnvironmentOptions {
        EnvironmentOptions {
            max_steps: self.max_steps,
            outlast_log: self.max_steps > 91,
            limit_terminates: self.limit_is_terminal,
            ..EnvironmentOptions::training()
        }
    }
}
