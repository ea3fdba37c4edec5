//! Kinds of generators by name: what they are built from, and what they say of themselves.

use std::sync::Arc;

use sage_backbones::{Backbone, MotionModel};
use sage_core::{
    generator::{Generator, Knowledge},
    objective::Objective,
};
use sage_merging::{ExpertSet, Merger};

use crate::{Error, mixtures::Mixtures};

/// What generators are built from. Cloning shares it.
#[derive(Clone)]
pub struct GeneratorInputs {
    /// The prior with its experts; `None` for generators that need none.
    pub experts: Option<ExpertSet>,
    /// What mixes the experts.
    pub merger: Arc<dyn Merger>,
    /// Seed of mergers that draw.
    pub seed: u64,
    /// What the choice among candidates makes large.
    pub selection: Arc<Objective>,
}

impl GeneratorInputs {
    /// The experts.
    ///
    /// *Errors*: [`Error::Inputs`] if there are none.
    pub fn experts(&self, generator: &'static str) -> Result<&ExpertSet, Error> {
        let needs = "a prior with experts; name their folder with --weights";
        self.experts.as_ref().ok_or(Error::Inputs { generator, needs })
    }

    /// The prior by itself.
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

    /// The prior as a model that every mixture gives.
    ///
    /// *Errors*: [`Error::Inputs`] if there is none.
    pub fn prior_at_any_mixture(&self, generator: &'static str) -> Result<Mixtures, Error> {
        let prior: Arc<dyn MotionModel> = self.prior(generator)?;
        Ok(Mixtures::always(prior))
    }
}

/// What a generator says of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facts {
    /// What it knows beyond what can be seen *now*.
    pub knows: Knowledge,
    /// Whether the mixture of experts changes what it does.
    pub depends_on_lambda: bool,
    /// Whether μ does.
    pub depends_on_mu: bool,
    /// Whether it needs a prior and experts.
    pub needs_experts: bool,
    /// Whether it is a ceiling, of which a table needs one row.
    pub is_ceiling: bool,
}

impl Facts {
    /// Of a generator that needs no experts and has no dial.
    pub const fn without_dial(knows: Knowledge) -> Self {
        Self {
            knows,
            depends_on_lambda: false,
            depends_on_mu: false,
            needs_experts: false,
            is_ceiling: false,
        }
    }

    /// Whether λ or μ changes what it does.
    pub fn uses_operating_point(&self) -> bool {
        self.depends_on_lambda || self.depends_on_mu
    }
}

/// A kind of generator, with its options.
pub trait GeneratorKind: Send + Sync {
    /// What it says of itself.
    fn facts(&self) -> Facts;

    /// The generator.
    ///
    /// *Errors*: inputs that it needs and was not given.
    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, Error>;
}
