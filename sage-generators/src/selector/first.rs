//! No selection: the first proposal, which is the likeliest if proposals have probabilities.

use sage_core::{
    Error,
    generator::{Knowledge, Proposal},
    objective::Context,
};

use super::{Selection, Selector, SelectorKind};
use crate::GeneratorInputs;

/// Selects the first proposal.
pub struct First;

impl SelectorKind for First {
    const KNOWS: Knowledge = Knowledge::NOW;
    const DEPENDS_ON_MU: bool = false;

    fn build(_: &GeneratorInputs) -> Box<dyn Selector> {
        Box::new(Self)
    }
}

impl Selector for First {
    fn select(&self, _: &[Proposal], _: &Context, _: f64) -> Result<Selection, Error> {
        Ok(Selection { chosen: 0, note: None })
    }
}
