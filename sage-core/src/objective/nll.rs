//! How unusual a trajectory is: the negative log-likelihood of its goal under the prior, in nats.
//!
//! Candidates of one scene are compared, so the number is known only up to what all of them share. A
//! trajectory from elsewhere, from a file for instance, has none.

use super::{Reward, Situation};
use crate::registry::{Entry, NoOptions};

/// −log p under the prior.
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
