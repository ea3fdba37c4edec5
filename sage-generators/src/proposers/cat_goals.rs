//! CAT's candidates: the prior's likeliest modes with a minimum spacing.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    candidates::Sampling,
    encoding::Encoding,
    features::cat::suppression_radius,
    prediction::{Predicted, propose},
};
use sage_core::{
    Error,
    generator::{Generator, Mixture, Observation, PreparedProposer, Proposal, Proposer},
    registry::Entry,
    scene::Scene,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use super::{check_candidates, encoded, in_scene};
use crate::{Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect, selector::CatSelector};

/// Options of CAT's proposer.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CatGoals {
    /// Number of candidates.
    pub candidates: usize,
}

impl Default for CatGoals {
    fn default() -> Self {
        Self { candidates: 32 }
    }
}

impl Entry<dyn GeneratorKind> for CatGoals {
    const NAME: &'static str = "cat";
    const SUMMARY: &'static str = "the prior's candidate that most probably collides";
    const SOURCE: &'static str = "Zhang et al. 2023 (CAT)";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        options.check()?;
        Ok(Box::new(options))
    }
}

impl CatGoals {
    /// Whether the options are possible.
    ///
    /// *Errors*: a message for the user.
    pub fn check(&self) -> Result<(), String> {
        check_candidates(Some(self.candidates))
    }

    /// The proposer of a prior.
    pub fn proposer(&self, prior: Arc<dyn Backbone>) -> Box<dyn Proposer> {
        Box::new(OfPrior { prior, candidates: self.candidates })
    }
}

impl GeneratorKind for CatGoals {
    fn facts(&self) -> Facts {
        CatSelector::FACTS
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        let proposer = self.proposer(inputs.prior(Self::NAME)?);
        Ok(Box::new(ProposeAndSelect {
            proposer,
            selector: Box::new(CatSelector),
            refinement: None,
            facts: self.facts(),
        }))
    }
}

struct OfPrior {
    prior: Arc<dyn Backbone>,
    candidates: usize,
}

impl Proposer for OfPrior {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error> {
        let encoding = encoded(&*self.prior, now).map_err(|error| in_scene(now.scene(), error))?;
        let (prior, candidates) = (self.prior.clone(), self.candidates);
        Ok(Box::new(Encoded { prior, candidates, encoding, scene: now.scene().clone() }))
    }
}

struct Encoded {
    prior: Arc<dyn Backbone>,
    candidates: usize,
    encoding: Encoding,
    scene: Arc<Scene>,
}

impl PreparedProposer for Encoded {
    fn propose(&self, _: &Mixture, seed: u64) -> Result<Vec<Proposal>, Error> {
        let nms = Sampling::Nms { radius: suppression_radius(self.encoding.features().speed()) };
        let mut rng = Rng::new(seed, &self.scene.id, "candidates");
        let found = propose(&*self.prior, &self.encoding, self.candidates, nms, &mut rng);
        let proposal = |p: Predicted| Proposal {
            trajectory: p.trajectory,
            log_prob: Some(f64::from(p.log_prob)),
            goal: Some(p.goal),
            nll: None,
        };
        let found = found.map_err(|error| in_scene(&self.scene, error))?;
        Ok(found.into_iter().map(proposal).collect())
    }
}
