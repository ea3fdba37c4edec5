//! Where a user puts the dials.

use serde::{Deserialize, Serialize};

/// A point among experts: a weight for each, in the order of their set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mixture(Vec<f64>);

/// How far the weights' sum may be from 1.
const ROUNDING: f64 = 1e-9;

impl Mixture {
    /// Weights as they are; a merger says which it takes.
    pub fn new(weights: Vec<f64>) -> Self {
        Self(weights)
    }

    /// Between two experts, the first at λ = 0 and the second at λ = 1.
    pub fn between(lambda: f64) -> Self {
        Self(vec![1.0 - lambda, lambda])
    }

    /// The weights.
    pub fn weights(&self) -> &[f64] {
        &self.0
    }

    /// λ, if there are two experts.
    pub fn lambda(&self) -> Option<f64> {
        match self.0[..] {
            [_, lambda] => Some(lambda),
            _ => None,
        }
    }

    /// Whether all weights are at least 0 and sum to 1.
    pub fn is_on_simplex(&self) -> bool {
        let sum: f64 = self.0.iter().sum();
        self.0.iter().all(|weight| *weight >= 0.0) && (sum - 1.0).abs() <= ROUNDING
    }

    /// The expert whose weight is 1 while all others are 0.
    pub fn corner(&self) -> Option<usize> {
        corner(&self.0)
    }
}

/// The one of some weights that is 1 while all others are 0.
pub fn corner(weights: &[f64]) -> Option<usize> {
    let corner = weights.iter().position(|weight| *weight == 1.0)?;
    weights.iter().enumerate().all(|(k, weight)| k == corner || *weight == 0.0).then_some(corner)
}

/// What a generator is asked for: how experts are mixed, and how a selection weighs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OperatingPoint {
    /// The mixture of experts.
    pub mixture: Mixture,
    /// μ of the selection's objective, 0 to 1.
    pub mu: f64,
}

impl OperatingPoint {
    /// Between two experts at λ.
    pub fn at(lambda: f64, mu: f64) -> Self {
        Self { mixture: Mixture::between(lambda), mu }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_and_the_simplex_are_told() {
        assert_eq!(Mixture::between(1.0).corner(), Some(1));
        assert_eq!(Mixture::between(0.5).corner(), None);
        assert_eq!(Mixture::new(vec![0.0, 0.0, 1.0]).corner(), Some(2));
        assert_eq!(Mixture::new(vec![1.0, 1.0]).corner(), None);
        assert!(Mixture::new(vec![0.5, 0.3, 0.2]).is_on_simplex());
        assert!(!Mixture::between(1.5).is_on_simplex() && !Mixture::new(vec![0.5, 0.4]).is_on_simplex());
        assert!(!Mixture::between(f64::NAN).is_on_simplex());
        assert_eq!(Mixture::between(0.25).lambda(), Some(0.25));
        assert_eq!(Mixture::new(vec![0.5, 0.3, 0.2]).lambda(), None);
    }
}
