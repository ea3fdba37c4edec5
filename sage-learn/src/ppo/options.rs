//! Options of PPO.

use sage_sim::{Error, actor::is_zero};
use serde::{Deserialize, Serialize};

/// Options of PPO; the defaults were chosen on this simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PpoOptions {
    /// Units of the two hidden layers of actor and critic.
    pub hidden: [usize; 2],
    /// Episodes that take turns.
    pub environments: usize,
    /// Steps that each of them drives for one batch.
    pub horizon: usize,
    /// Steps of a minibatch; it divides the batch.
    pub minibatch: usize,
    /// Passes over each batch.
    pub epochs: usize,
    /// Learning rate at the start; it falls linearly to 0.
    pub rate: f64,
    /// Adam's decay of the first and second moments.
    pub betas: [f64; 2],
    /// Adam's term against division by zero.
    pub epsilon: f64,
    /// Discount of a step, 0 to 1.
    pub gamma: f64,
    /// Decay λ of the generalised advantage estimation, 0 to 1.
    pub gae_lambda: f64,
    /// Bound of the change of a probability ratio from 1.
    pub clip: f64,
    /// Largest norm of a gradient, of actor and critic each.
    pub gradient_norm: f64,
    /// Weight of the entropy.
    pub entropy: f64,
    /// Standard deviation of the actions before the hyperbolic tangent, at the start.
    pub deviation: f64,
    /// Share of the last action that an action keeps, 0 to below 1: more is smoother, and explores along the same line
    /// for longer.
    #[serde(skip_serializing_if = "is_zero")]
    pub kept: f64,
    /// Share of the training in which a teacher's actions are imitated, if there is a teacher: the weight of the imitation
    /// falls from 1 to 0 over it, and that of the policy's own experience rises.
    #[serde(skip_serializing_if = "is_one")]
    pub taught: f64,
}

fn is_one(x: &f64) -> bool {
    *x == 1.0
}

impl Default for PpoOptions {
    fn default() -> Self {
        Self {
            hidden: [128, 128],
            environments: 128,
            horizon: 32,
            minibatch: 1024,
            epochs: 4,
            rate: 1e-3,
            betas: [0.9, 0.999],
            epsilon: 1e-5,
            gamma: 0.97,
            gae_lambda: 0.95,
            clip: 0.2,
            gradient_norm: 0.5,
            entropy: 0.0,
            deviation: 0.5,
            kept: 0.0,
            taught: 1.0,
        }
    }
}

impl PpoOptions {
    /// Steps of a batch.
    pub fn batch(&self) -> usize {
        self.environments * self.horizon
    }

    /// Checks all numbers.
    ///
    /// *Errors*: the name and value of an option that is out of range, and what is expected.
    pub fn check(&self) -> Result<(), Error> {
        let counts = [
            ("hidden", self.hidden[0], 4096),
            ("hidden", self.hidden[1], 4096),
            ("environments", self.environments, 4096),
            ("horizon", self.horizon, 4096),
            ("minibatch", self.minibatch, 1 << 20),
            ("epochs", self.epochs, 100),
        ];
        if let Some((name, value, limit)) =
            counts.into_iter().find(|(_, value, limit)| *value == 0 || value > limit)
        {
            return Err(Error::Value(format!("`{name}` is {value}; expected a number from 1 to {limit}")));
        }
        let batch = self.batch();
        if batch > 1 << 20 || !batch.is_multiple_of(self.minibatch) {
            return Err(Error::Value(format!(
                "`environments` times `horizon` is {batch}; expected at most {} and a multiple of `minibatch`, {}",
                1 << 20,
                self.minibatch
            )));
        }
        if self.minibatch == 1 {
            return Err(Error::Value(
                "`minibatch` is 1; expected at least 2, since advantages are compared within it".to_owned(),
            ));
        }
        let shares = [("gamma", self.gamma), ("gae_lambda", self.gae_lambda), ("taught", self.taught)];
        if let Some((name, value)) = shares.into_iter().find(|(_, x)| !(0.0..=1.0).contains(x)) {
            return Err(Error::Value(format!("`{name}` is {value}; expected a number from 0 to 1")));
        }
        if let Some(value) = self.betas.into_iter().find(|x| !(0.0..1.0).contains(x)) {
            return Err(Error::Value(format!("`betas` holds {value}; expected numbers from 0 to below 1")));
        }
        let positive = [
            ("rate", self.rate),
            ("epsilon", self.epsilon),
            ("clip", self.clip),
            ("gradient_norm", self.gradient_norm),
            ("deviation", self.deviation),
        ];
        if let Some((name, value)) = positive.into_iter().find(|(_, x)| !(*x > 0.0 && x.is_finite())) {
            return Err(Error::Value(format!("`{name}` is {value}; expected a number above 0")));
        }
        if !(0.0..1.0).contains(&self.kept) {
            return Err(Error::Value(format!(
                "`kept` is {}; expected a number from 0 to below 1",
                self.kept
            )));
        }
        if !(self.entropy >= 0.0 && self.entropy.is_finite()) {
            return Err(Error::Value(format!(
                "`entropy` is {}; expected a number, at least 0",
                self.entropy
            )));
        }
        Ok(())
    }
}
