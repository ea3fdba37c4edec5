//! What an experiment found, and the verdict on its claim.

use serde::Serialize;

use crate::{Check, Figure, Table};

/// A bound is attained if it exceeds what it bounds by no more than this share.
const ATTAINED: f64 = 1e-6;

/// What an experiment found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Instances, random and stored grids.
    pub instances: usize,
    /// Comparisons of the formula with the direct computation.
    pub comparisons: usize,
    /// Comparisons that miss their tolerance.
    pub violations: usize,
    /// Smallest share of the tolerance that is left; negative where one is missed.
    pub worst_margin: f64,
    /// Smallest ratio of a bound to what it bounds; `None` if the claim is no bound.
    pub tightness: Option<f64>,
    /// Largest error of the stored cases, as a share of their tolerance; `None` without stored cases.
    pub fixture_error: Option<f64>,
    /// Instances that refute the claim as printed; `None` if it is not printed otherwise.
    pub counterexamples: Option<usize>,
    /// Instances outside the claim's condition on which it fails; `None` if it has no condition.
    pub exceptions: Option<usize>,
    /// Measured numbers, beside those of an independent implementation.
    pub tables: Vec<Table>,
    /// Figures for the page.
    #[serde(skip)]
    pub figures: Vec<Figure>,
}

/// Verdict on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// No violation; a bound is attained.
    Holds,
    /// No violation, but no instance attains the bound.
    HoldsWithSlack,
    /// No violation where the stated condition holds, and failures where it does not.
    HoldsIf,
    /// The claim as printed is refuted by an instance; the corrected one has no violation.
    FailsAsPrinted,
    /// A comparison or a stored case misses its tolerance.
    Violated,
}

impl Verdict {
    /// The verdict that a report supports.
    pub fn of(report: &Report) -> Self {
        let misses_a_stored_case = report.fixture_error.is_some_and(|error| error > 1.0);
        if report.violations > 0 || report.comparisons == 0 || misses_a_stored_case {
            Self::Violated
        } else if report.counterexamples.is_some_and(|count| count > 0) {
            Self::FailsAsPrinted
        } else if report.exceptions.is_some_and(|count| count > 0) {
            Self::HoldsIf
        } else if report.tightness.is_some_and(|ratio| ratio > 1.0 + ATTAINED) {
            Self::HoldsWithSlack
        } else {
            Self::Holds
        }
    }

    /// The verdict in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::HoldsWithSlack => "holds with slack",
            Self::HoldsIf => "holds if",
            Self::FailsAsPrinted => "fails as printed",
            Self::Violated => "VIOLATED",
        }
    }
}

/// Whether a check notices one of its planted errors: it then comes to another verdict.
pub fn notices(check: &dyn Check, planted: usize, setup: &crate::Setup) -> bool {
    Verdict::of(&check.run(setup, Some(planted))) != check.expected()
}
