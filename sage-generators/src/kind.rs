//! Kinds of generators by name: their inputs and their properties.

use std::sync::Arc;

use sage_backbones::{Backbone, MotionModel};
use sage_core::{
    generator::{Generator, Knowledge},
    objective::Objective,
};
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

/// Properties of a generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facts {
    /// Information that it uses beyond the observation up to *now*.
    pub knows: Knowledge,
    /// Whether its attacks depend on the mixture of experts.
    pub depends_on_lambda: bool,
    /// Whether its attacks depend on μ.
    pub depends_on_mu: bool,
    /// Whether it needs a prior and experts.
    pub needs_experts: bool,
    /// Whether it is an upper bound, for which a table needs one row.
    pub is_upper_bound: bool,
}

impl Facts {
    /// Properties of a generator that needs no experts and does not depend on λ or μ.
    pub const fn without_dial(knows: Knowledge) -> Self {
        Self {
            knows,
            depends_on_lambda: false,
            depends_on_mu: false,
            needs_experts: false,
            is_upper_bound: false,
        }
    }

    /// Whether its attacks depend on λ or μ.
    pub fn uses_operating_point(&self) -> bool {
        self.depends_on_lambda || self.depends_on_mu
    }
}

/// A kind of generator, with its options.
pub trait GeneratorKind: Send + Sync {
    /// Properties of the generator.
    fn facts(&self) -> Facts;

    /// Builds the generator.
    ///
    /// *Errors*: a missing input.
    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, Error>;
}
