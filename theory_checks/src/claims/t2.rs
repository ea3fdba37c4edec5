//! T2: with unequal scalar curvatures the interval is the same, and λ is not linear in μ.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::{preference, root};
use crate::{Check, Outcome, Preference, Setup, Tally};

const TOLERANCE: f64 = 1e-9;

/// The claim T2.
pub struct UnequalCurvature;

impl Entry<dyn Check> for UnequalCurvature {
    const NAME: &'static str = "T2";
    const SUMMARY: &'static str = "unequal curvatures: the same interval is exact, at another λ";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Rewards with curvatures `a` and `b` whose optima are 1 apart. Everything lies on one line, the adversarial optimum at 1.
pub(super) struct Line {
    pub(super) a: f64,
    pub(super) b: f64,
}

impl Line {
    pub(super) fn curvature(&self, weight: f64) -> f64 {
        weight * self.a + (1.0 - weight) * self.b
    }

    pub(super) fn optimum(&self, weight: f64) -> f64 {
        weight * self.a / self.curvature(weight)
    }

    /// Best λ and gap by search on the segment.
    pub(super) fn direct(&self, at: Preference) -> [f64; 2] {
        let [hat, first, second] = [at.mu, at.beta, 1.0 - at.beta].map(|weight| self.optimum(weight));
        let point = |lambda: f64| (1.0 - lambda) * second + lambda * first;
        let best = root(|lambda| (hat - point(lambda)) * (first - second));
        [best, 0.5 * self.curvature(at.mu) * (point(best) - hat).powi(2)]
    }

    /// The same by the formulas.
    fn formula(&self, at: Preference, planted: Option<usize>) -> [f64; 2] {
        let [c1, c2] = at.coefficients();
        let [first, second] = [at.beta, 1.0 - at.beta].map(|weight| self.curvature(weight));
        let lambda = if planted == Some(0) { c1 } else { c1 * first / (c1 * first + c2 * second) };
        let clipped = at.clipped();
        let own = self.curvature(at.mu);
        let other = if planted == Some(1) { own } else { self.curvature(clipped) };
        let gap = (self.a * self.b * (at.mu - clipped) / other).powi(2) / (2.0 * own);
        [lambda.clamp(0.0, 1.0), gap]
    }
}

impl Check for UnequalCurvature {
    fn formula(&self) -> &'static str {
        "λ = c₁ L(β)/L(μ) with L(w) = w a + (1 − w) b; gap = a² b² (μ − μ_c)² Δ² / (2 L(μ) L(μ_c)²), μ_c = clip(μ, 1 − β, β)"
    }

    fn caveat(&self) -> &'static str {
        "needs scalar curvatures: with general Hessians the optima leave the segment (T3)"
    }

    fn planted(&self) -> &'static [&'static str] {
        &["λ = c₁", "L(μ)² in place of L(μ_c)²", "a and b exchanged"]
    }

    fn run(&self, setup: &Setup, planted: Option<usize>) -> Outcome {
        let mut rng = Rng::new(setup.seed, "T2", "instances");
        let mut tally = Tally::default();
        let formula = |line: &Line, at: Preference| {
            let exchanged = Line { a: line.b, b: line.a };
            if planted == Some(2) { exchanged.formula(at, None) } else { line.formula(at, planted) }
        };
        for instance in 0..setup.instances {
            let at = preference(&mut rng, instance);
            let [a, b] = [(); 2].map(|()| 10f64.powf(rng.uniform(-1.0, 1.0)));
            let line = Line { a, b };
            let ([lambda, gap], [best, direct]) = (formula(&line, at), line.direct(at));
            tally.equal(lambda, best, TOLERANCE);
            tally.equal(gap, direct, TOLERANCE * (1.0 + a + b));
        }
        let stored = |b: f64, mu: f64| formula(&Line { a: 1.0, b }, Preference { mu, beta: 0.9 });
        tally.stored(stored(1.0, 0.0)[1], 0.005, 1e-12);
        tally.stored(stored(4.0, 0.3)[0], 0.10483871, 1e-8);
        tally.stored(stored(4.0, 0.95)[1], 0.010290712632, 1e-12);
        tally.stored(stored(4.0, 0.02)[1], 9.4922745492e-4, 1e-13);
        tally.outcome()
    }
}
