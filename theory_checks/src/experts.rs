//! Two experts of two concave rewards, and the segment between them.

use nalgebra::{DMatrix, DVector};

use crate::{
    Bounds, Preference,
    reward::{Concave, Curvature},
};

/// Gradient norm at which an optimum is found, and the largest that rounding may leave.
const FOUND: f64 = 1e-11;
const ROUNDING: f64 = 1e-8;
/// Most steps of Newton's method, and halvings of a step.
const STEPS: usize = 1000;
const HALVINGS: i32 = 50;
/// Share of a step by which it must shrink the gradient.
const SHRINKS: f64 = 0.25;
/// Halvings of the interval of the best λ.
const BISECTIONS: usize = 52;

/// A weighted sum of rewards.
pub struct Mixed<'r> {
    /// The rewards, at least one.
    pub of: Vec<&'r dyn Concave>,
    /// Their weights.
    pub weights: Vec<f64>,
}

impl Mixed<'_> {
    fn sum<T: std::iter::Sum>(&self, term: impl Fn(f64, &dyn Concave) -> T) -> T {
        self.weights.iter().zip(&self.of).map(|(weight, reward)| term(*weight, *reward)).sum()
    }
}

impl Concave for Mixed<'_> {
    fn dimension(&self) -> usize {
        self.of.first().map_or(0, |reward| reward.dimension())
    }

    fn curvature(&self) -> Curvature {
        let curvatures: Vec<Curvature> = self.of.iter().map(|reward| reward.curvature()).collect();
        Curvature::mixed(&self.weights, &curvatures)
    }

    fn value(&self, theta: &DVector<f64>) -> f64 {
        self.sum(|weight, reward| weight * reward.value(theta))
    }

    fn gradient(&self, theta: &DVector<f64>) -> DVector<f64> {
        self.sum(|weight, reward| weight * reward.gradient(theta))
    }

    fn hessian(&self, theta: &DVector<f64>) -> DMatrix<f64> {
        let zero = DMatrix::zeros(theta.len(), theta.len());
        let terms = self.weights.iter().zip(&self.of);
        terms.fold(zero, |sum, (weight, reward)| sum + *weight * reward.hessian(theta))
    }
}

/// The optimum of a concave reward by Newton's method, whose steps are halved until the gradient shrinks; `None` if
/// it is not found.
pub fn optimum(reward: &dyn Concave, start: DVector<f64>) -> Option<DVector<f64>> {
    let mut theta = start;
    let mut gradient = reward.gradient(&theta);
    for _ in 0..STEPS {
        if gradient.norm() <= FOUND {
            return Some(theta);
        }
        let step = reward.hessian(&theta).cholesky()?.solve(&gradient);
        let halved = (0..HALVINGS).find_map(|halvings| {
            let share = 0.5f64.powi(halvings);
            let next = &theta + share * &step;
            let slope = reward.gradient(&next);
            // Less would let steps jump to and fro over the optimum of a nearly flat reward.
            (slope.norm() <= (1.0 - SHRINKS * share) * gradient.norm()).then_some((next, slope))
        });
        // Where no step shrinks the gradient, rounding is all that is left of it.
        let Some((next, slope)) = halved else { break };
        (theta, gradient) = (next, slope);
    }
    (gradient.norm() <= ROUNDING * (1.0 + reward.curvature().l * theta.norm())).then_some(theta)
}

/// Where a decreasing function on [0, 1] is 0; an end where it has one sign.
pub fn root(f: impl Fn(f64) -> f64) -> f64 {
    if f(0.0) <= 0.0 {
        return 0.0;
    }
    if f(1.0) >= 0.0 {
        return 1.0;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if f(middle) > 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// What a point misses of the optimum of R_μ.
#[derive(Clone, Debug)]
pub struct Loss {
    /// `R_μ(θ̂_μ) − R_μ(θ)`.
    pub value: f64,
    /// Rounding of this difference of two values.
    pub rounding: f64,
    /// θ̂_μ.
    pub hat: DVector<f64>,
}

impl Loss {
    /// Ratio of a bound to the loss; `None` if rounding decides it.
    pub fn ratio(&self, bound: f64) -> Option<f64> {
        (self.value > 1e3 * self.rounding).then(|| bound / self.value)
    }
}

/// Two experts: θ_1 maximises `β R_adv + (1 − β) R_real`, θ_2 the reverse.
pub struct Experts<'r> {
    /// R_adv and R_real.
    pub rewards: [&'r dyn Concave; 2],
    /// Weight of each expert's own reward.
    pub beta: f64,
    /// θ_1 and θ_2.
    pub thetas: [DVector<f64>; 2],
    /// `θ_1 − θ_2`.
    pub way: DVector<f64>,
}

impl<'r> Experts<'r> {
    /// The experts of two rewards, searched from a point; `None` if an optimum is not found.
    pub fn of(rewards: [&'r dyn Concave; 2], beta: f64, start: &DVector<f64>) -> Option<Self> {
        let first = optimum(&mixed(rewards, beta), start.clone())?;
        let second = optimum(&mixed(rewards, 1.0 - beta), first.clone())?;
        Some(Self { rewards, beta, way: &first - &second, thetas: [first, second] })
    }

    /// R_μ.
    pub fn preferred(&self, mu: f64) -> Mixed<'r> {
        mixed(self.rewards, mu)
    }

    /// θ(λ).
    pub fn at(&self, lambda: f64) -> DVector<f64> {
        &self.thetas[1] + lambda * &self.way
    }

    /// D, the distance between the experts.
    pub fn distance(&self) -> f64 {
        self.way.norm()
    }

    /// Slope of R_μ along the segment.
    pub fn slope(&self, mu: f64, lambda: f64) -> f64 {
        self.preferred(mu).gradient(&self.at(lambda)).dot(&self.way)
    }

    /// The best λ in [0, 1] by bisection of the slope.
    pub fn best(&self, mu: f64) -> f64 {
        root(|lambda| self.slope(mu, lambda))
    }

    /// Bounds of the gap.
    pub fn bounds(&self, mu: f64) -> Bounds {
        let at = Preference { mu, beta: self.beta };
        Bounds::of(at, self.rewards.map(Concave::curvature), self.distance())
    }

    /// `R_μ(θ̂_μ) − R_μ(θ)`, the optimum searched from θ; `None` if it is not found.
    pub fn loss(&self, mu: f64, theta: &DVector<f64>) -> Option<Loss> {
        let reward = self.preferred(mu);
        let hat = optimum(&reward, theta.clone())?;
        let best = reward.value(&hat);
        Some(Loss { value: best - reward.value(theta), rounding: 1e-11 * (1.0 + best.abs()), hat })
    }

    /// The loss at the best λ, and that λ.
    pub fn gap(&self, mu: f64) -> Option<(f64, Loss)> {
        let lambda = self.best(mu);
        Some((lambda, self.loss(mu, &self.at(lambda))?))
    }
}

fn mixed(rewards: [&dyn Concave; 2], weight: f64) -> Mixed<'_> {
    Mixed { of: rewards.to_vec(), weights: vec![weight, 1.0 - weight] }
}
