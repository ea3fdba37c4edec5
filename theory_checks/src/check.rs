//! A claim as an experiment.
//!
//! Every check must be able to fail. Injected faults are wrong formulas behind a switch. Inequalities have instances that
//! attain the bound, because a bound that is too large violates nothing.

use rayon::prelude::*;

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

    /// The verdict that this project stands for. It only says which one is an error to miss.
    fn expected(&self) -> Verdict {
        Verdict::Holds
    }

    /// Runs the experiment, with one of the injected faults in place of the formula if given.
    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report;
}

/// Which of its injected faults a check notices: those with which it comes to another verdict. None if it does not come
/// to the expected verdict without them.
pub fn caught(check: &dyn Check, setup: &Setup) -> Vec<bool> {
    let injected: Vec<Option<usize>> =
        std::iter::once(None).chain((0..check.injected().len()).map(Some)).collect();
    let run = |injected: &Option<usize>| Verdict::of(&check.run(setup, *injected)) == check.expected();
    let as_expected: Vec<bool> = injected.par_iter().map(run).collect();
    as_expected[1..].iter().map(|with_error| as_expected[0] && !with_error).collect()
}
