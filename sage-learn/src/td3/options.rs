//! Options of TD3.

use sage_sim::Error;
use serde::{Deserialize, Serialize};

use super::super::adam::Adam;

/// Options of TD3; the defaults are those of the paper and of the published implementation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Td3Options {
    /// Units of the two hidden layers of actor and critics.
    pub hidden: [usize; 2],
    /// Transitions of a batch.
    pub batch: usize,
    /// Discount of a step, 0 to 1.
    pub gamma: f64,
    /// Share of the online weights that the targets take over, 0 to 1.
    pub tau: f64,
    /// Learning rate of the actor.
    pub actor_rate: f64,
    /// Learning rate of the critics.
    pub critic_rate: f64,
    /// Adam's decay of the first and second moments.
    pub betas: [f64; 2],
    /// Adam's term against division by zero.
    pub epsilon: f64,
    /// Largest absolute value of an action.
    pub max_action: f64,
    /// Standard deviation of the exploration noise, in units of `max_action`.
    pub exploration_noise: f64,
    /// Standard deviation of the noise of target actions, in units of `max_action`.
    pub target_noise: f64,
    /// Bound of the noise of target actions, in units of `max_action`.
    pub noise_clip: f64,
    /// Updates of the critics for each one of the actor and of the targets.
    pub policy_delay: u64,
    /// Steps with uniformly random actions, before the first update.
    pub random_steps: u64,
    /// Transitions that the replay buffer holds.
    pub buffer: usize,
}

impl Default for Td3Options {
    fn default() -> Self {
        Self {
            hidden: [256, 256],
            batch: 256,
            gamma: 0.99,
            tau: 0.005,
            actor_rate: 3e-4,
            critic_rate: 3e-4,
            betas: [0.9, 0.999],
            epsilon: 1e-8,
            max_action: 1.0,
            exploration_noise: 0.1,
            target_noise: 0.2,
            noise_clip: 0.5,
            policy_delay: 2,
            random_steps: 10_000,
            buffer: 1_000_000,
        }
    }
}

impl Td3Options {
    pub(crate) fn adam(&self) -> Adam {
        Adam { betas: self.betas, epsilon: self.epsilon }
    }

    /// Checks all numbers.
    ///
    /// *Errors*: the name and value of an option that is out of range, and what is expected.
    pub fn check(&self) -> Result<(), Error> {
        let counts = [
            ("hidden", self.hidden[0].min(self.hidden[1]), self.hidden[0].max(self.hidden[1]), 4096),
            ("batch", self.batch, self.batch, 65_536),
            ("buffer", self.buffer, self.buffer, 100_000_000),
            ("policy_delay", self.policy_delay as usize, self.policy_delay as usize, 1000),
        ];
        if let Some((name, least, most, limit)) =
            counts.into_iter().find(|(_, least, most, limit)| *least == 0 || most > limit)
        {
            let value = if least == 0 { least } else { most };
            return Err(Error::Value(format!("`{name}` is {value}; expected a number from 1 to {limit}")));
        }
        let shares = [("gamma", self.gamma), ("tau", self.tau)];
        if let Some((name, value)) = shares.into_iter().find(|(_, x)| !(0.0..=1.0).contains(x)) {
            return Err(Error::Value(format!("`{name}` is {value}; expected a number from 0 to 1")));
        }
        if let Some(value) = self.betas.into_iter().find(|x| !(0.0..1.0).contains(x)) {
            return Err(Error::Value(format!("`betas` holds {value}; expected numbers from 0 to below 1")));
        }
        let positive = [
            ("actor_rate", self.actor_rate),
            ("critic_rate", self.critic_rate),
            ("epsilon", self.epsilon),
            ("max_action", self.max_action),
        ];
        if let Some((name, value)) = positive.into_iter().find(|(_, x)| !(*x > 0.0 && x.is_finite())) {
            return Err(Error::Value(format!("`{name}` is {value}; expected a number above 0")));
        }
        let noises = [
            ("exploration_noise", self.exploration_noise),
            ("target_noise", self.target_noise),
            ("noise_clip", self.noise_clip),
        ];
        if let Some((name, value)) = noises.into_iter().find(|(_, x)| !(*x >= 0.0 && x.is_finite())) {
            return Err(Error::Value(format!("`{name}` is {value}; expected a number, at least 0")));
        }
        Ok(())
    }
}
