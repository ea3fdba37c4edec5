//! A claim as an experiment, and what it found.

use serde::Serialize;

/// Size of an experiment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setup {
    /// Seed of the instances.
    pub seed: u64,
    /// Number of random instances.
    pub instances: usize,
}

impl Default for Setup {
    fn default() -> Self {
        Self { seed: 0, instances: 1000 }
    }
}

/// What an experiment found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Outcome {
    /// Comparisons of the formula with the direct computation.
    pub comparisons: usize,
    /// Comparisons that miss their tolerance.
    pub violations: usize,
    /// Smallest share of the tolerance that is left; negative where one is missed.
    pub worst_margin: f64,
    /// Largest error of the stored cases, as a share of their tolerance; `None` without stored cases.
    pub fixture_error: Option<f64>,
}

/// Verdict on a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// No violation.
    Holds,
    /// The claim is false as printed: its counterexamples are where they are predicted, and there is one.
    FailsAsPrinted,
    /// At least one comparison misses its tolerance.
    Violated,
}

/// A claim as an experiment.
///
/// Implementations are pure: the same setup gives the same bits on any thread.
pub trait Check: Send + Sync {
    /// The formula that is checked.
    fn formula(&self) -> &'static str;

    /// What a reader must know beside the verdict.
    fn caveat(&self) -> &'static str;

    /// Wrong versions of the formula that the check must notice.
    fn planted(&self) -> &'static [&'static str];

    /// The verdict if every comparison comes out.
    fn confirmed(&self) -> Verdict {
        Verdict::Holds
    }

    /// Runs the experiment, with one of the planted errors in place of the formula if given.
    fn run(&self, setup: &Setup, planted: Option<usize>) -> Outcome;
}

/// The verdict of an outcome. Stored cases count as comparisons.
pub fn evaluate(check: &dyn Check, outcome: &Outcome) -> Verdict {
    let is_fixed = outcome.fixture_error.is_none_or(|error| error <= 1.0);
    if outcome.violations == 0 && outcome.comparisons > 0 && is_fixed {
        check.confirmed()
    } else {
        Verdict::Violated
    }
}

/// Counts comparisons.
#[derive(Clone, Debug)]
pub struct Tally {
    comparisons: usize,
    violations: usize,
    worst: f64,
    fixture: Option<f64>,
}

impl Default for Tally {
    fn default() -> Self {
        Self { comparisons: 0, violations: 0, worst: 1.0, fixture: None }
    }
}

impl Tally {
    /// Compares two numbers that must agree within a tolerance.
    pub fn equal(&mut self, formula: f64, direct: f64, tolerance: f64) {
        let margin = 1.0 - (formula - direct).abs() / tolerance;
        self.comparisons += 1;
        // A margin that is not a number is a violation too.
        if !(margin >= 0.0) {
            self.violations += 1;
        }
        self.worst = if margin.is_nan() { f64::NEG_INFINITY } else { self.worst.min(margin) };
    }

    /// Notes whether something holds.
    pub fn holds(&mut self, holds: bool) {
        self.equal(f64::from(u8::from(holds)), 1.0, 0.5);
    }

    /// Compares with a stored number.
    pub fn stored(&mut self, formula: f64, stored: f64, tolerance: f64) {
        let error = (formula - stored).abs() / tolerance;
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.fixture = Some(self.fixture.map_or(error, |known| known.max(error)));
    }

    /// What was found.
    pub fn outcome(self) -> Outcome {
        let Self { comparisons, violations, worst, fixture } = self;
        Outcome { comparisons, violations, worst_margin: worst, fixture_error: fixture }
    }
}
