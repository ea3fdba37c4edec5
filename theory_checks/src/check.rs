//! A claim as an experiment.

use crate::{Report, Setup, Verdict};

/// A claim as an experiment.
///
/// Implementations are pure: the same setup gives the same bits on any number of threads.
pub trait Check: Send + Sync {
    /// The formula that is checked.
    fn formula(&self) -> &'static str;

    /// What is compared with what, and the distribution of the instances.
    fn experiment(&self) -> &'static str;

    /// What a reader must know beside the verdict.
    fn caveat(&self) -> &'static str;

    /// Wrong versions of the formula that the check must notice.
    fn injected(&self) -> &'static [&'static str];

    /// The verdict that this project stands for.
    fn expected(&self) -> Verdict {
        Verdict::Holds
    }

    /// Runs the experiment, with one of the injected faults in place of the formula if given.
    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report;
}
