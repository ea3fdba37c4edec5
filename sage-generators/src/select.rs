//! Who chooses among proposals, and by what.

mod best;
mod cat;
mod first;

use sage_core::{
    Error,
    generator::{Knowledge, Note, Proposal},
    objective::Context,
};

use crate::GeneratorInputs;

pub use best::{Best, best_of};
pub use cat::{CatChoice, CatSelector, cat_plan, cat_select};
pub use first::First;

/// A proposal that was selected.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// Its number among the proposals.
    pub chosen: usize,
    /// Why it is not what it should be, if so.
    pub note: Option<Note>,
}

/// Chooses among the proposals for one scene.
pub trait Selector: Send + Sync {
    /// The choice among at least one proposal, at a weight μ where it depends on one.
    ///
    /// *Errors*: [`Error::Scene`] for proposals that it cannot compare.
    fn select(&self, proposals: &[Proposal], ctx: &Context, mu: f64) -> Result<Selection, Error>;
}

/// A kind of selector, for [`crate::Pair`].
pub trait SelectorKind: 'static {
    /// What it knows beyond what can be seen *now*.
    const KNOWS: Knowledge;
    /// Whether μ changes what it chooses.
    const DEPENDS_ON_MU: bool;

    /// The selector.
    fn build(inputs: &GeneratorInputs) -> Box<dyn Selector>;
}
