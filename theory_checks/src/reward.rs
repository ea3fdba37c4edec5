//! Strongly concave rewards with exact constants.

mod log_sum_exp;
mod separable;

use nalgebra::{DMatrix, DVector};

pub use log_sum_exp::LogSumExp;
pub use separable::{Separable, Shape};

/// Bounds of the curvature: every eigenvalue of the Hessian of −R lies in [m, L].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Strong concavity m, above 0.
    pub m: f64,
    /// Smoothness L, at least m.
    pub l: f64,
}

impl Curvature {
    /// Bounds for a sum of rewards with these weights.
    pub fn mixed<'c>(weights: &[f64], of: impl IntoIterator<Item = &'c Self>) -> Self {
        weights.iter().zip(of).fold(Self { m: 0.0, l: 0.0 }, |sum, (weight, c)| Self {
            m: sum.m + weight * c.m,
            l: sum.l + weight * c.l,
        })
    }
}

/// A strongly concave reward of the weights, to be maximised.
pub trait Concave: Sync {
    /// Number of weights.
    fn dimension(&self) -> usize;

    /// Bounds of its curvature.
    fn curvature(&self) -> Curvature;

    /// The reward.
    fn value(&self, theta: &DVector<f64>) -> f64;

    /// Its gradient.
    fn gradient(&self, theta: &DVector<f64>) -> DVector<f64>;

    /// The Hessian of −R, positive definite.
    fn hessian(&self, theta: &DVector<f64>) -> DMatrix<f64>;
}

/// A family of rewards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// A sum of functions of rotated coordinates.
    Separable(Shape),
    /// The logarithm of a sum of exponentials with a quadratic.
    LogSumExp,
}

/// All families.
pub const FAMILIES: [Family; 5] = [
    Family::Separable(Shape::Quadratic),
    Family::Separable(Shape::LogCosh),
    Family::Separable(Shape::Softplus),
    Family::Separable(Shape::PseudoHuber),
    Family::LogSumExp,
];

impl Family {
    /// A random member with these bounds around a point, which is its optimum except for softplus and log-sum-exp.
    pub fn draw(
        self,
        rng: &mut sage_core::seed::Rng,
        curvature: Curvature,
        center: DVector<f64>,
    ) -> Box<dyn Concave> {
        match self {
            Self::Separable(shape) => Box::new(Separable::draw(shape, rng, curvature, center)),
            Self::LogSumExp => Box::new(LogSumExp::draw(rng, curvature, center)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::normals;
    use sage_core::seed::Rng;

    #[test]
    fn gradients_hessians_and_constants_agree_with_differences() {
        for (k, family) in FAMILIES.into_iter().enumerate() {
            let mut rng = Rng::new(k as u64, "families", "test");
            let curvature = Curvature { m: 0.4, l: 3.0 };
            let center = normals(&mut rng, 4);
            let reward = family.draw(&mut rng, curvature, center);
            assert_eq!(reward.curvature(), curvature);
            for _ in 0..20 {
                let (at, way) = (2.0 * normals(&mut rng, 4), normals(&mut rng, 4));
                let step = 1e-5;
                let [before, after] = [-step, step].map(|s| &at + s * &way);
                let slope = (reward.value(&after) - reward.value(&before)) / (2.0 * step);
                let gradient = reward.gradient(&at);
                assert!((slope - gradient.dot(&way)).abs() < 1e-7, "{family:?}");
                let bend = (reward.gradient(&before) - reward.gradient(&after)) / (2.0 * step);
                let hessian = reward.hessian(&at);
                assert!((bend - &hessian * way).norm() < 1e-7, "{family:?}");
                let eigenvalues = hessian.symmetric_eigenvalues();
                assert!(eigenvalues.min() > curvature.m - 1e-9 && eigenvalues.max() < curvature.l + 1e-9);
            }
        }
    }
}
