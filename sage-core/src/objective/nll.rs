//! Negative log-likelihood of a trajectory's goal under the prior, in nats.
//!
//! It is for comparing candidates of one scene, so it is known only up to a constant that they share. A
//! trajectory without a proposer, from a file for instance, has none.

use super::{Reward, Situation};
use crate::registry::{Entry, NoOptions};

/// Negative log-likelihood under the prior, as a reward.
pub struct NegativeLogLikelihood;

impl Entry<dyn Reward> for NegativeLogLikelihood {
    const NAME: &'static str = "nll";
    const SUMMARY: &'static str = "negative log-likelihood of a proposal under the prior, nats";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for NegativeLogLikelihood {
    fn score(&self, situation: &Situation) -> Option<f64> {
        situation.candidate.nll()
    }

    fn depends_on_ego(&self) -> bool {
        false
    }

    fn needs_prior(&self) -> bool {
        true
    }
}
