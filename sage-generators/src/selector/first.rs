//! No selection: the first proposal, which is the likeliest if proposals have probabilities.

use sage_core::{
    Error,
    generator::{Knowledge, Proposal},
    objective::Context,
};

use super::{Choice, Selector};
use crate::Facts;

/// Selects the first proposal.
pub struct First;

impl First {
    /// Properties of a generator that selects so among the prior's proposals.
    pub const FACTS: Facts = Facts::of_selection(Knowledge::NOW, false);
}

impl Selector for First {
    fn select(&self, _: &[Proposal], _: &Context, _: f64) -> Result<Choice, Error> {
        Ok(Choice { chosen: 0, note: None })
    }
}
