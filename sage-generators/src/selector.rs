//! Selectors among proposals.

mod best;
mod cat;
mod first;

use sage_core::{
    Error,
    generator::{Note, Proposal},
    objective::Context,
};

pub use best::{Best, best_of};
pub use cat::{CatSelection, CatSelector, STRIDE, boxes, cat_plan, cat_select, edges_cross};
pub use first::First;

/// The selected proposal.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// Its index among the proposals.
    pub chosen: usize,
    /// Warning about the selection, if any.
    pub note: Option<Note>,
}

/// Selects among the proposals for one scene.
pub trait Selector: Send + Sync {
    /// Selects one of at least one proposal, at a weight μ if it depends on one.
    ///
    /// *Errors*: [`Error::Scene`] for proposals that it cannot compare.
    fn select(&self, proposals: &[Proposal], ctx: &Context, mu: f64) -> Result<Choice, Error>;

    /// The same at several μ. A selector overrides it to share work among them.
    ///
    /// *Errors*: as [`Selector::select`].
    fn select_each(&self, proposals: &[Proposal], ctx: &Context, mus: &[f64]) -> Result<Vec<Choice>, Error> {
        mus.iter().map(|mu| self.select(proposals, ctx, *mu)).collect()
    }
}
