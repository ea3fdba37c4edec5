//! Generators by name, each built for one setting of the dial.

use std::sync::Arc;

use sage_backbones::Backbone;
use sage_core::{generator::Generator, registry::Registry};
use sage_merging::{Experts, Merger};

use crate::{
    Choice, Judge, Log, Rule,
    cat::CatMethod,
    most_likely::MostLikelyMethod,
    oracle::OracleMethod,
    random_goals::RandomMethod,
    steered::{PriorMethod, SageMethod},
};

/// What a generator is built for.
#[derive(Clone, Copy)]
pub struct Setting<'s> {
    /// The prior with its experts.
    pub experts: &'s Experts,
    /// What mixes them.
    pub merger: &'s dyn Merger,
    /// Where between them: 0 realistic, 1 adversarial.
    pub lambda: f64,
    /// Weight of the adversarial reward in the choice.
    pub mu: f64,
    /// How a table calls this place of the dial.
    pub label: &'s str,
    /// What the choice weighs beside.
    pub choice: Choice,
    /// Whether only the strict rule makes a candidate feasible.
    pub strict: bool,
}

impl Setting<'_> {
    /// Who chooses among candidates.
    ///
    /// *Errors*: μ out of range.
    pub fn judge(&self) -> Result<Judge, String> {
        Judge::new(self.choice, self.mu, self.strict)
    }

    /// The prior by itself.
    ///
    /// *Errors*: none that a caller can cause.
    pub fn prior(&self) -> Result<Arc<dyn Backbone>, String> {
        let prior = self.experts.prior();
        Ok(Arc::from(prior.rebuilt(prior.parameters().clone()).map_err(|e| e.to_string())?))
    }

    /// The experts mixed at λ.
    ///
    /// *Errors*: λ out of range.
    pub fn mixture(&self) -> Result<Arc<dyn Backbone>, String> {
        let mix = || self.experts.prior().rebuilt(self.merger.merge(self.experts, self.lambda)?);
        Ok(Arc::from(mix().map_err(|e| e.to_string())?))
    }
}

/// A kind of generator. One file holds its source, its struct, and the entry that names it.
pub trait Method: Send + Sync {
    /// Whether λ or μ changes what it does.
    fn is_steered(&self) -> bool;

    /// Whether one row of a table says all: what is not steered, and ceilings.
    fn stands_once(&self) -> bool {
        !self.is_steered()
    }

    /// The generator for a setting.
    ///
    /// *Errors*: a setting out of range.
    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String>;
}

/// The generators this crate ships. Add a line here to make a new one known everywhere.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two bear one name.
pub fn methods() -> Result<Registry<dyn Method>, sage_core::Error> {
    Registry::new("generator")
        .with::<SageMethod>()?
        .with::<PriorMethod>()?
        .with::<MostLikelyMethod>()?
        .with::<RandomMethod>()?
        .with::<OracleMethod>()?
        .with::<CatMethod>()?
        .with::<Rule>()?
        .with::<Log>()
}

/// Refuses a number of candidates that is no number of candidates.
pub(crate) fn check_candidates(candidates: usize) -> Result<(), String> {
    if (1..=1024).contains(&candidates) {
        Ok(())
    } else {
        Err(format!("`candidates` is {candidates}; expected 1 to 1024"))
    }
}
