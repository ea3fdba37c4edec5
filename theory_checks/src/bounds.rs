//! Bounds of the gap from the constants of both rewards.

use crate::{Preference, reward::Curvature};

/// What the bounds of the gap depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// c_1 and c_2.
    pub coefficients: [f64; 2],
    /// Constants of the experts' rewards R_1 and R_2.
    pub experts: [Curvature; 2],
    /// Strong concavity m_μ of R_μ.
    pub m: f64,
    /// Distance D between the experts.
    pub distance: f64,
}

impl Bounds {
    /// Bounds for R_adv and R_real with these constants, and experts at a distance.
    pub fn of(at: Preference, rewards: [Curvature; 2], distance: f64) -> Self {
        let mixed = |weight: f64| Curvature::mixed(&[weight, 1.0 - weight], &rewards);
        Self {
            coefficients: at.coefficients(),
            experts: [mixed(at.beta), mixed(1.0 - at.beta)],
            m: mixed(at.mu).m,
            distance,
        }
    }

    /// `|c_1| L_1` and `|c_2| L_2`.
    fn pulls(&self) -> [f64; 2] {
        [0, 1].map(|k| self.coefficients[k].abs() * self.experts[k].l)
    }

    /// `f² D²/(2 m_μ)`.
    pub(crate) fn of_slope(&self, f: f64) -> f64 {
        (f * self.distance).powi(2) / (2.0 * self.m)
    }

    /// Bound of `R_μ(θ̂_μ) − R_μ(θ(λ))`: `f(λ) = |c_1| L_1 (1 − λ) + |c_2| L_2 λ` bounds the gradient over D.
    pub fn at_lambda(&self, lambda: f64) -> f64 {
        let [first, second] = self.pulls();
        self.of_slope(first * (1.0 - lambda) + second * lambda)
    }

    /// The paper's bound, the largest of all λ.
    pub fn max(&self) -> f64 {
        let [first, second] = self.pulls();
        self.of_slope(first.max(second))
    }

    /// The smallest of all λ, which is at an end.
    pub fn min(&self) -> f64 {
        let [first, second] = self.pulls();
        self.of_slope(first.min(second))
    }

    /// The bound where the gradients of both experts cancel; `None` outside [1 − β, β].
    pub fn centre(&self) -> Option<f64> {
        let ([c1, c2], [first, second]) = (self.coefficients, self.experts);
        let f = c1 * c2 * (first.l * second.l - first.m * second.m)
            / (c1 * (first.l + first.m) + c2 * (second.l + second.m));
        (c1 >= 0.0 && c2 >= 0.0).then(|| self.of_slope(f))
    }

    /// The smaller of the min-bound and the centre-bound.
    pub fn best(&self) -> f64 {
        self.centre().map_or(self.min(), |centre| centre.min(self.min()))
    }
}
