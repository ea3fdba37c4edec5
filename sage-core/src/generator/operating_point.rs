//! Operating points: the mixture of experts and the weight μ of the selection.

use serde::{Deserialize, Serialize};

/// A mixture of experts: one weight per expert, in the order of the expert set. Experts beyond the given weights
/// have weight 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mixture(Vec<f64>);

/// Tolerance of the weights' sum around 1.
const ROUNDING: f64 = 1e-9;

impl Mixture {
    /// A mixture of any weights; each merger checks its own range.
    pub fn new(weights: Vec<f64>) -> Self {
        Self(weights)
    }

    /// A mixture of two experts: the first at λ = 0, the second at λ = 1.
    pub fn between(lambda: f64) -> Self {
        Self(vec![1.0 - lambda, lambda])
    }

    /// The weights.
    pub fn weights(&self) -> &[f64] {
        &self.0
    }

    /// The mixture of a number of experts, at least as many as it has weights for: the others get weight 0.
    pub fn among(&self, experts: usize) -> Self {
        let rest = experts.saturating_sub(self.0.len());
        Self(self.0.iter().copied().chain(std::iter::repeat_n(0.0, rest)).collect())
    }

    /// λ, the weight of the second expert, if there are exactly two.
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

    /// Index of the expert with weight 1, if all others have weight 0.
    pub fn corner(&self) -> Option<usize> {
        corner(&self.0)
    }
}

/// Index of the weight that is 1, if all others are 0.
pub fn corner(weights: &[f64]) -> Option<usize> {
    let corner = weights.iter().position(|weight| *weight == 1.0)?;
    weights.iter().enumerate().all(|(k, weight)| k == corner || *weight == 0.0).then_some(corner)
}

/// Input of a generator: the mixture of experts and the weight μ of the selection.
///
/// ```
/// use sage_core::generator::{Mixture, OperatingPoint};
///
/// // A quarter of the way from the realistic to the adversarial expert; the selection weighs contact fully.
/// let point = OperatingPoint::at(0.25, 1.0);
/// assert_eq!(point.mixture.weights(), [0.75, 0.25]);
/// assert_eq!(point.mixture.lambda(), Some(0.25));
/// // Extrapolation leaves the simplex, and more than two experts have no λ.
/// assert!(!Mixture::between(1.5).is_on_simplex());
/// assert_eq!(Mixture::new(vec![0.5, 0.3, 0.2]).lambda(), None);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OperatingPoint {
    /// The mixture of experts.
    pub mixture: Mixture,
    /// μ of the selection's objective, 0 to 1.
    pub mu: f64,
}

impl OperatingPoint {
    /// A point between two experts, at λ, with weight μ.
    pub fn at(lambda: f64, mu: f64) -> Self {
        Self { mixture: Mixture::between(lambda), mu }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_and_the_simplex_are_recognised() {
        assert_eq!(Mixture::between(1.0).corner(), Some(1));
        assert_eq!(Mixture::between(0.5).corner(), None);
        assert_eq!(Mixture::new(vec![0.0, 0.0, 1.0]).corner(), Some(2));
        assert_eq!(Mixture::new(vec![1.0, 1.0]).corner(), None);
        assert!(Mixture::new(vec![0.5, 0.3, 0.2]).is_on_simplex());
        assert!(!Mixture::between(1.5).is_on_simplex() && !Mixture::new(vec![0.5, 0.4]).is_on_simplex());
        assert!(!Mixture::between(f64::NAN).is_on_simplex());
        assert_eq!(Mixture::between(0.25).among(3).weights(), [0.75, 0.25, 0.0]);
        assert_eq!(Mixture::between(0.25).among(2), Mixture::between(0.25));
        assert_eq!(Mixture::between(0.25).lambda(), Some(0.25));
        assert_eq!(Mixture::new(vec![0.5, 0.3, 0.2]).lambda(), None);
    }
}
