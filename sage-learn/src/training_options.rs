//! Options of a training run.

use sage_sim::{
    Error,
    actor::{ActorPolicy, Network},
    environment::{EnvironmentOptions, RewardSum},
    observation::ObservationKind,
};
use serde::{Deserialize, Serialize};

use super::{PpoOptions, Td3Options};

/// Most steps of a training by PPO.
const MOST_STEPS: u64 = 1 << 40;

/// Algorithm of a training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Algorithm {
    /// TD3 (Fujimoto et al. 2018).
    #[default]
    Td3,
    /// PPO (Schulman et al. 2017).
    Ppo,
}

/// Options of a training run.
///
/// ```
/// use sage_learn::{Algorithm, TrainingOptions};
///
/// let algorithm = Algorithm::Ppo;
/// let options = TrainingOptions { algorithm, ppo_steps: 1, evaluations: 1, ..TrainingOptions::default() };
/// // The last batch of PPO is a whole one.
/// assert!(options.check().is_ok() && options.steps() > 1);
/// let error = TrainingOptions { mirrored: 1.5, ..options }.check().err().map(|error| error.to_string());
/// assert!(error.is_some_and(|error| error.contains("mirrored")));
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainingOptions {
    /// The algorithm.
    pub algorithm: Algorithm,
    /// Options of TD3.
    pub td3: Td3Options,
    /// Options of PPO.
    pub ppo: PpoOptions,
    /// TD3: updates in all.
    pub updates: u64,
    /// TD3: updates per step of the environment.
    pub ratio: f64,
    /// TD3: episodes that take turns.
    pub environments: usize,
    /// PPO: steps in all; the last batch is a whole one.
    pub ppo_steps: u64,
    /// Whether arrival and leaving the road do not end an episode, and the observed route goes on beyond the recording's.
    pub goes_on: bool,
    /// Terms of the reward; the published one if there are none.
    #[serde(skip)]
    pub reward: RewardSum,
    /// Share of episodes in which the car drives the mirror image of the scene, 0 to 1.
    pub mirrored: f64,
    /// Largest number of steps of an episode; above 91 it goes on after the end of the recording, without traffic.
    pub max_steps: usize,
    /// Whether the limit of steps is stored as a terminal step, as published.
    pub limit_is_terminal: bool,
    /// Newest drives of a scene that may be attacked; one of them is drawn.
    pub drives: usize,
    /// Age of a scene's newest drive, in steps, above which the present policy first drives the unchanged scene, so that the
    /// attack meets what it does now; `None` for never, as published.
    pub refresh_after: Option<u64>,
    /// Attacked episodes of a scene that meet the same attack, with its intensity, before a new one is planned; 1 plans each
    /// anew, as published.
    pub renew_attack_after: u64,
    /// Evaluations during training, evenly spaced; the last one is at the end.
    pub evaluations: u64,
    /// Seed of initial weights, scenes, noise and batches.
    pub seed: u64,
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            algorithm: Algorithm::default(),
            td3: Td3Options::default(),
            ppo: PpoOptions::default(),
            updates: 100_000,
            ratio: 1.0,
            environments: 1,
            ppo_steps: 1_000_000,
            goes_on: false,
            reward: RewardSum::default(),
            mirrored: 0.0,
            max_steps: 91,
            limit_is_terminal: false,
            drives: 1,
            refresh_after: None,
            renew_attack_after: 1,
            evaluations: 20,
            seed: 0,
        }
    }
}

impl TrainingOptions {
    /// Steps of the environments in all: for TD3 the random ones, and those with updates; for PPO whole batches.
    pub fn steps(&self) -> u64 {
        match self.algorithm {
            Algorithm::Td3 => self.td3.random_steps + (self.updates as f64 / self.ratio).ceil() as u64,
            Algorithm::Ppo => {
                let batch = self.ppo.batch().max(1) as u64;
                self.ppo_steps.div_ceil(batch).saturating_mul(batch)
            }
        }
    }

    /// Episodes that take turns.
    pub fn slots(&self) -> usize {
        match self.algorithm {
            Algorithm::Td3 => self.environments,
            Algorithm::Ppo => self.ppo.environments,
        }
    }

    /// Checks all numbers.
    ///
    /// *Errors*: the name and value of an option that is out of range, and what is expected.
    pub fn check(&self) -> Result<(), Error> {
        self.td3.check()?;
        self.ppo.check().map_err(|error| Error::Value(format!("`ppo`: {error}")))?;
        if !(0.0..=1.0).contains(&self.mirrored) {
            return Err(Error::Value(format!(
                "`mirrored` is {}; expected a number from 0 to 1",
                self.mirrored
            )));
        }
        if !(1..=MOST_STEPS).contains(&self.ppo_steps) {
            return Err(Error::Value(format!(
                "`ppo_steps` is {}; expected a number from 1 to {MOST_STEPS}",
                self.ppo_steps
            )));
        }
        if !(self.ratio >= 1.0 / 64.0 && self.ratio <= 64.0) {
            return Err(Error::Value(format!(
                "`ratio` is {}; expected a number from 1/64 to 64",
                self.ratio
            )));
        }
        let counts = [
            ("environments", self.environments, 1, 1024),
            ("max_steps", self.max_steps, 2, 10_000),
            ("drives", self.drives, 1, 100),
            ("renew_attack_after", self.renew_attack_after as usize, 1, 1_000_000),
            ("evaluations", self.evaluations as usize, 1, 1000),
        ];
        if let Some((name, value, least, most)) =
            counts.into_iter().find(|(_, value, least, most)| !(least..=most).contains(&value))
        {
            return Err(Error::Value(format!(
                "`{name}` is {value}; expected a number from {least} to {most}"
            )));
        }
        let batches = self.steps() / self.ppo.batch() as u64;
        if self.algorithm == Algorithm::Ppo && self.evaluations > batches {
            return Err(Error::Value(format!(
                "`evaluations` is {}; expected at most {batches}, the batches of {} steps",
                self.evaluations,
                self.ppo.batch()
            )));
        }
        let steps = self.steps().saturating_sub(self.td3.random_steps);
        if self.algorithm == Algorithm::Td3 && steps < self.td3.random_steps {
            return Err(Error::Value(format!(
                "{} updates at a ratio of {} are {steps} steps, fewer than the {} random steps at the start; give more updates or fewer random steps",
                self.updates, self.ratio, self.td3.random_steps
            )));
        }
        Ok(())
    }

    /// The observation of the policy.
    pub fn observation(&self) -> ObservationKind {
        if self.goes_on { ObservationKind::Continued } else { ObservationKind::Corrected }
    }

    /// Share of the last action that an action of the policy keeps.
    pub fn kept_share(&self) -> f64 {
        if self.algorithm == Algorithm::Ppo { self.ppo.kept } else { 0.0 }
    }

    /// The policy of an actor.
    pub fn policy(&self, actor: Network<f32>) -> ActorPolicy {
        ActorPolicy::new(actor).observing(self.observation()).keeping(self.kept_share())
    }

    /// Rules of the training episodes.
    pub fn rules(&self) -> EnvironmentOptions {
        EnvironmentOptions {
            max_steps: self.max_steps,
            outlast_log: self.max_steps > 91,
            limit_terminates: self.limit_is_terminal,
            any_contact_ends: self.reward.contact_ends(),
            reward: self.reward.clone(),
            goes_on: self.goes_on,
            observation: self.observation(),
            ..EnvironmentOptions::training()
        }
    }
}
