//! The evaluation of a candidate by an objective.

use super::Violation;

/// Result of evaluating a candidate; it determines the value at any μ.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Value of each term, a mean over the ego's paths; `None` if it was not measured or not requested.
    pub terms: Vec<Option<f64>>,
    /// Violated rules.
    pub violations: Vec<Violation>,
    /// First step with contact with the ego on its first path, 1 to 80.
    pub contact: Option<usize>,
    /// Whether it is a believable attack on that path; asked of feasible hits, by objectives that prefer these.
    pub is_believable: bool,
    /// Adversarial reward against that path, even if it is not a term.
    pub adversarial: f64,
}

impl Evaluation {
    /// Whether no rule is violated.
    pub fn is_feasible(&self) -> bool {
        self.violations.is_empty()
    }

    /// Whether it hits the ego without a violation.
    pub fn is_attack(&self) -> bool {
        self.contact.is_some() && self.is_feasible()
    }

    /// Whether it hits the ego without a violation, and a person would not believe it.
    pub fn is_unbelievable_hit(&self) -> bool {
        self.is_attack() && !self.is_believable
    }

    /// Cost of the violations.
    pub fn cost(&self) -> f64 {
        self.violations.iter().fold(0.0, |sum, violation| sum + violation.cost)
    }
}
