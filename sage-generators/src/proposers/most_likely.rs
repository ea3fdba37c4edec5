//! The most likely mode of the mixed experts: the policy without a selection.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    backbone::{finite, trajectories_in_world},
    candidates::ranked,
    encoding::Encoding,
    forecast::features_with_forecast,
    subsampling::Subsampling,
};
use sage_core::{
    Error,
    generator::{Generator, Mixture, Observation, PreparedProposer, Proposal, Proposer},
    registry::Entry,
    scene::Scene,
};
use serde::{Deserialize, Serialize};

use super::{goal, in_scene};
use crate::{Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect, mixtures::Mixtures, selector::First};

/// Options; there are none.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MostLikely {}

impl Entry<dyn GeneratorKind> for MostLikely {
    const NAME: &'static str = "most-likely";
    const SUMMARY: &'static str = "the mixed experts' most likely goal, without selection";
    const SOURCE: &'static str = "this project: the effect of the policy alone";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(options))
    }
}

impl GeneratorKind for MostLikely {
    fn facts(&self) -> Facts {
        Facts { depends_on_lambda: true, ..First::FACTS }
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        let (prior, models) = (inputs.prior(Self::NAME)?, inputs.mixtures(Self::NAME)?);
        let proposer = Box::new(OfPolicy { prior, models });
        Ok(Box::new(ProposeAndSelect {
            proposer,
            selector: Box::new(First),
            refinement: None,
            facts: self.facts(),
        }))
    }
}

struct OfPolicy {
    prior: Arc<dyn Backbone>,
    models: Mixtures,
}

impl Proposer for OfPolicy {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error> {
        let encode = || {
            let adversary = now.scene().adversary_index()?;
            let features = features_with_forecast(&*self.prior, now, adversary, Subsampling::NONE)?;
            self.prior.encode(Arc::new(features))
        };
        let encoding = encode().map_err(|error| in_scene(now.scene(), error))?;
        let (prior, models) = (self.prior.clone(), self.models.clone());
        Ok(Box::new(Encoded { prior, models, encoding, scene: now.scene().clone() }))
    }
}

struct Encoded {
    prior: Arc<dyn Backbone>,
    models: Mixtures,
    encoding: Encoding,
    scene: Arc<Scene>,
}

impl PreparedProposer for Encoded {
    fn propose(&self, at: &Mixture, _: u64) -> Result<Vec<Proposal>, Error> {
        let propose = || -> Result<Proposal, crate::Error> {
            let (encoding, model) = (&self.encoding, self.models.at(at)?);
            let log_probs: Vec<f32> = finite(&model.log_probs(encoding)?)?;
            let best = ranked(&log_probs)[0];
            let end = self.prior.mode_ends(encoding)?[best];
            let mut trajectories =
                trajectories_in_world(&model.trajectories(encoding, &[best])?, encoding.features())?;
            Ok(Proposal {
                trajectory: trajectories.swap_remove(0),
                log_prob: Some(f64::from(log_probs[best])),
                goal: Some(goal(encoding, end)),
                nll: None,
            })
        };
        Ok(vec![propose().map_err(|error| in_scene(&self.scene, error))?])
    }
}
