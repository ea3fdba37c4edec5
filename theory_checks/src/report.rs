//! What an experiment found, and the verdict on its claim.

use serde::Serialize;

use crate::{Figure, Table, json};

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
    /// Instances whose direct computation found no solution.
    pub unsolved: usize,
    /// Smallest share of the tolerance that is left; negative where one is missed.
    #[serde(serialize_with = "json::number")]
    pub worst_margin: f64,
    /// Smallest ratio of a bound to what it bounds; `None` if the claim is no bound.
    #[serde(serialize_with = "json::optional")]
    pub tightness: Option<f64>,
    /// Largest error of the stored cases, as a share of their tolerance; `None` without stored cases.
    #[serde(serialize_with = "json::optional")]
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

/// Verdict on a claim. It is counted, not declared: [`Verdict::of`] derives it from comparisons, counterexamples and failures
/// outside a condition.
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
    /// No violation, but nothing was compared, or a direct computation found no solution.
    Undecided,
}

impl Verdict {
    /// The verdict that a report supports.
    pub fn of(report: &Report) -> Self {
        let misses_a_stored_case = report.fixture_error.is_some_and(|error| error > 1.0);
        if report.violations > 0 || misses_a_stored_case {
            Self::Violated
        } else if report.comparisons == 0 || report.unsolved > 0 {
            Self::Undecided
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
            Self::Undecided => "UNDECIDED",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tally;

    fn verdict(count: impl Fn(&mut Tally)) -> Verdict {
        let mut tally = Tally::instance();
        tally.holds(true);
        count(&mut tally);
        Verdict::of(&tally.report(vec![], vec![]))
    }

    #[test]
    fn verdicts_follow_from_counts_and_the_worst_decides() {
        assert_eq!(verdict(|_| ()), Verdict::Holds);
        assert_eq!(verdict(|t| t.ratio(1.0)), Verdict::Holds);
        assert_eq!(verdict(|t| t.ratio(1.1)), Verdict::HoldsWithSlack);
        assert_eq!(verdict(|t| t.exception(false)), Verdict::Holds);
        assert_eq!(verdict(|t| t.exception(true)), Verdict::HoldsIf);
        let both = |t: &mut Tally| {
            t.exception(true);
            t.counterexample(true);
        };
        assert_eq!(verdict(both), Verdict::FailsAsPrinted);
        assert_eq!(verdict(|t| t.equal(1.0, 1.1, 0.01)), Verdict::Violated);
        assert_eq!(verdict(|t| t.equal(f64::NAN, 0.0, 1.0)), Verdict::Violated);
        assert_eq!(verdict(|t| t.at_most(2.0, 1.0, 0.5)), Verdict::Violated);
        assert_eq!(verdict(|t| t.at_most(f64::NAN, 1.0, 0.5)), Verdict::Violated);
        assert_eq!(verdict(|t| t.compare_stored(1.0, f64::NAN, 1.0)), Verdict::Violated);
        assert_eq!(verdict(Tally::add_unsolved), Verdict::Undecided);
        assert_eq!(Verdict::of(&Report::default()), Verdict::Undecided);
    }

    #[test]
    fn tallies_add_up() {
        let mut one = Tally::instance();
        one.equal(1.0, 1.0 + 0.25, 1.0);
        one.sample("x", 1.0);
        let mut other = Tally::instance();
        other.counterexample(true);
        other.ratio(2.0);
        other.compare_stored(1.0, 1.5, 1.0);
        other.sample("x", 2.0);
        let both = one.and(other);
        assert_eq!(both.samples("x"), [1.0, 2.0]);
        let report = both.report(vec![], vec![]);
        assert_eq!((report.instances, report.comparisons, report.counterexamples), (2, 1, Some(1)));
        assert_eq!(
            (report.worst_margin, report.tightness, report.fixture_error),
            (0.75, Some(2.0), Some(0.5))
        );
        let json = serde_json::to_value(Report { worst_margin: f64::NEG_INFINITY, ..report }).unwrap();
        assert_eq!(json["worst_margin"], "-inf");
    }
}
