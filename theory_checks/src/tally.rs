//! Counts the comparisons of an experiment.

use std::collections::BTreeMap;

use crate::{Figure, Report, Table};

/// Counts comparisons, and keeps the values of which medians are reported.
#[derive(Clone, Debug)]
pub struct Tally {
    instances: usize,
    comparisons: usize,
    violations: usize,
    unsolved: usize,
    worst: f64,
    tightness: Option<f64>,
    fixture: Option<f64>,
    counterexamples: Option<usize>,
    exceptions: Option<usize>,
    samples: BTreeMap<String, Vec<f64>>,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            instances: 0,
            comparisons: 0,
            violations: 0,
            unsolved: 0,
            worst: 1.0,
            tightness: None,
            fixture: None,
            counterexamples: None,
            exceptions: None,
            samples: BTreeMap::new(),
        }
    }
}

impl Tally {
    /// A tally of one instance.
    pub fn instance() -> Self {
        Self { instances: 1, ..Self::default() }
    }

    /// Compares two numbers that must agree within a tolerance.
    pub fn equal(&mut self, formula: f64, direct: f64, tolerance: f64) {
        self.compare(1.0 - (formula - direct).abs() / tolerance);
    }

    /// Compares a number with a bound from above, which it may exceed by a tolerance for rounding.
    pub fn at_most(&mut self, value: f64, bound: f64, tolerance: f64) {
        self.compare(1.0 + (bound - value) / tolerance);
    }

    /// Notes whether something holds.
    pub fn holds(&mut self, holds: bool) {
        self.compare(if holds { 1.0 } else { -1.0 });
    }

    /// Notes that the direct computation found no solution, so that nothing could be compared.
    pub fn add_unsolved(&mut self) {
        self.unsolved += 1;
    }

    /// Counts a comparison with the share of its tolerance that is left.
    fn compare(&mut self, margin: f64) {
        self.comparisons += 1;
        // A margin that is not a number is a violation too.
        if !(margin >= 0.0) {
            self.violations += 1;
        }
        self.worst = if margin.is_nan() { f64::NEG_INFINITY } else { self.worst.min(margin) };
    }

    /// Notes the ratio of a bound to what it bounds; the smallest is the tightness of the claim.
    pub fn ratio(&mut self, ratio: f64) {
        self.tightness = Some(self.tightness.map_or(ratio, |known| known.min(ratio)));
    }

    /// Compares with a stored number.
    pub fn compare_stored(&mut self, formula: f64, stored: f64, tolerance: f64) {
        let error = (formula - stored).abs() / tolerance;
        let error = if error.is_nan() { f64::INFINITY } else { error };
        self.fixture = Some(self.fixture.map_or(error, |known| known.max(error)));
    }

    /// Notes whether an instance refutes the claim as printed.
    pub fn counterexample(&mut self, refutes: bool) {
        *self.counterexamples.get_or_insert(0) += usize::from(refutes);
    }

    /// Notes whether the claim fails on an instance that misses its condition.
    pub fn exception(&mut self, fails: bool) {
        *self.exceptions.get_or_insert(0) += usize::from(fails);
    }

    /// Keeps a value of a named quantity.
    pub fn sample(&mut self, quantity: impl Into<String>, value: f64) {
        self.samples.entry(quantity.into()).or_default().push(value);
    }

    /// The values of a quantity, in the order of the instances.
    pub fn samples(&self, quantity: &str) -> &[f64] {
        self.samples.get(quantity).map_or(&[], Vec::as_slice)
    }

    /// Both tallies together.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        let both = |a: Option<usize>, b: Option<usize>| a.or(b).map(|_| a.unwrap_or(0) + b.unwrap_or(0));
        self.instances += other.instances;
        self.comparisons += other.comparisons;
        self.violations += other.violations;
        self.unsolved += other.unsolved;
        self.worst = self.worst.min(other.worst);
        self.counterexamples = both(self.counterexamples, other.counterexamples);
        self.exceptions = both(self.exceptions, other.exceptions);
        if let Some(ratio) = other.tightness {
            self.ratio(ratio);
        }
        if let Some(error) = other.fixture {
            self.compare_stored(error, 0.0, 1.0);
        }
        for (quantity, values) in other.samples {
            self.samples.entry(quantity).or_default().extend(values);
        }
        self
    }

    /// What was found, with its tables and figures.
    pub fn report(&self, tables: Vec<Table>, figures: Vec<Figure>) -> Report {
        Report {
            instances: self.instances,
            comparisons: self.comparisons,
            violations: self.violations,
            unsolved: self.unsolved,
            worst_margin: self.worst,
            tightness: self.tightness,
            fixture_error: self.fixture,
            counterexamples: self.counterexamples,
            exceptions: self.exceptions,
            tables,
            figures,
        }
    }
}
