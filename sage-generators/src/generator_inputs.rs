//! What generators are built from: experts, a merger and the objective of the selection.

use std::sync::Arc;

use sage_backbones::{Backbone, MotionModel};
use sage_core::objective::Objective;
use sage_merging::{ExpertSet, Merger};

use crate::{Error, mixtures::Mixtures};

/// Inputs of generators. Clones share the data.
#[derive(Clone)]
pub struct GeneratorInputs {
    /// The prior with its experts; `None` for generators that need none.
    pub experts: Option<ExpertSet>,
    /// The merger of the experts.
    pub merger: Arc<dyn Merger>,
    /// Seed of mergers that use random numbers.
    pub seed: u64,
    /// The objective of the selection among candidates.
    pub selection: Arc<Objective>,
}

impl GeneratorInputs {
    /// The prior and its experts.
    ///
    /// *Errors*: [`Error::Inputs`] if there are none.
    pub fn experts(&self, generator: &'static str) -> Result<&ExpertSet, Error> {
        let needs = "a prior with experts; name their folder with --weights";
        self.experts.as_ref().ok_or(Error::Inputs { generator, needs })
    }

    /// The prior alone.
    ///
    /// *Errors*: [`Error::Inputs`] if there is none.
    pub fn prior(&self, generator: &'static str) -> Result<Arc<dyn Backbone>, Error> {
        Ok(self.experts(generator)?.prior().clone())
    }

    /// Models of the experts at any mixture.
    ///
    /// *Errors*: [`Error::Inputs`] if there are no experts.
    pub fn mixtures(&self, generator: &'static str) -> Result<Mixtures, Error> {
        Ok(Mixtures::new(self.experts(generator)?.clone(), self.merger.clone(), self.seed))
    }

    /// The prior as the model at every mixture.
    ///
    /// *Errors*: [`Error::Inputs`] if there is none.
    pub fn prior_at_any_mixture(&self, generator: &'static str) -> Result<Mixtures, Error> {
        let prior: Arc<dyn MotionModel> = self.prior(generator)?;
        Ok(Mixtures::always(prior))
    }
}
