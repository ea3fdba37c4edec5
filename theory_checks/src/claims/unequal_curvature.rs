//! T2: with unequal scalar curvatures the interval is the same, and λ is not linear in μ.

use sage_core::registry::{Entry, NoOptions};

use super::instances::preference;
use crate::{Bounds, Check, Preference, Report, Setup, random::log_uniform, reward::Curvature, root};

const TOLERANCE: f64 = 1e-9;
/// b and μ for a = 1 and β = 0.9, then λ, gap, max-bound and min-bound.
const FIXTURE: [(f64, f64, [f64; 4]); 4] = [
    (1.0, 0.0, [0.0, 0.005, 0.405, 0.005]),
    (4.0, 0.3, [0.10483871, 0.0, 0.549723230, 0.00754023422]),
    (4.0, 0.95, [1.0, 0.010290712632, 0.367135643, 0.010290712632]),
    (4.0, 0.02, [0.0, 9.4922745492e-4, 0.930405791, 9.4922745492e-4]),
];

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

    /// Distance between the experts.
    pub(super) fn distance(&self, beta: f64) -> f64 {
        self.optimum(beta) - self.optimum(1.0 - beta)
    }

    /// Bounds of the gap.
    pub(super) fn bounds(&self, at: Preference) -> Bounds {
        let curvatures = [self.a, self.b].map(|curvature| Curvature { m: curvature, l: curvature });
        Bounds::of(at, curvatures, self.distance(at.beta))
    }

    /// The same as [`Self::direct`] by the formulas.
    fn formula(&self, at: Preference, injected: Option<usize>) -> [f64; 2] {
        let [c1, c2] = at.coefficients();
        let [first, second] = [at.beta, 1.0 - at.beta].map(|weight| self.curvature(weight));
        let lambda = if injected == Some(0) { c1 } else { c1 * first / (c1 * first + c2 * second) };
        let clipped = at.clipped();
        let own = self.curvature(at.mu);
        let other = if injected == Some(1) { own } else { self.curvature(clipped) };
        let gap = (self.a * self.b * (at.mu - clipped) / other).powi(2) / (2.0 * own);
        [lambda.clamp(0.0, 1.0), gap]
    }
}

impl Check for UnequalCurvature {
    fn formula(&self) -> &'static str {
        "λ = c₁ L(β)/L(μ) with L(w) = w a + (1 − w) b; gap = a² b² (μ − μ_c)² Δ² / (2 L(μ) L(μ_c)²), μ_c = clip(μ, 1 − β, β)"
    }

    fn experiment(&self) -> &'static str {
        "1000 instances, curvatures in 10^[-1, 1], β in {0.51, 0.6, 0.75, 0.9, 1}, optima 1 apart (all optima lie on one line); best λ by bisection, gap as ½ L(μ) x²"
    }

    fn caveat(&self) -> &'static str {
        "needs scalar curvatures: with general Hessians the optima leave the segment (T3)"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["λ = c₁", "L(μ)² in place of L(μ_c)²", "a and b exchanged"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let formula = |line: &Line, at: Preference| {
            let exchanged = Line { a: line.b, b: line.a };
            if injected == Some(2) { exchanged.formula(at, None) } else { line.formula(at, injected) }
        };
        let mut tally = setup.each("T2", 1000, |instance, rng, tally| {
            let at = preference(rng, instance);
            let [a, b] = [(); 2].map(|()| log_uniform(rng, [-1.0, 1.0]));
            let line = Line { a, b };
            // Where the gradients w a (1 − θ) and (1 − w) b (0 − θ) cancel.
            for weight in [at.mu, at.beta, 1.0 - at.beta] {
                let theta = if injected == Some(2) {
                    Line { a: b, b: a }.optimum(weight)
                } else {
                    line.optimum(weight)
                };
                tally.equal(
                    weight * a * (1.0 - theta) - (1.0 - weight) * b * theta,
                    0.0,
                    TOLERANCE * (a + b),
                );
            }
            let ([lambda, gap], [best, direct]) = (formula(&line, at), line.direct(at));
            tally.equal(lambda, best, TOLERANCE);
            tally.equal(gap, direct, TOLERANCE * (1.0 + a + b));
            let width = 2.0 * at.beta - 1.0;
            let apart = a * b * width / (line.curvature(at.beta) * line.curvature(1.0 - at.beta));
            tally.equal(line.distance(at.beta), apart, TOLERANCE * (1.0 + apart));
        });
        for (b, mu, [lambda, gap, max, min]) in FIXTURE {
            let (line, at) = (Line { a: 1.0, b }, Preference { mu, beta: 0.9 });
            let ([found, direct], bounds) = (formula(&line, at), line.bounds(at));
            tally.compare_stored(found, lambda, 1e-8);
            tally.compare_stored(direct, gap, 1e-12);
            tally.compare_stored(bounds.max(), max, 1e-9);
            tally.compare_stored(bounds.min(), min, 1e-11);
            tally.compare_stored(bounds.centre().unwrap_or(0.0), 0.0, 1e-12);
        }
        tally.compare_stored(Line { a: 1.0, b: 4.0 }.distance(0.9), 0.66528067, 1e-8);
        let coefficients = Preference { mu: 0.3, beta: 0.9 }.coefficients();
        for (found, known) in coefficients.into_iter().zip([0.25, 0.75]) {
            tally.compare_stored(found, known, 1e-12);
        }
        tally.report(vec![], vec![])
    }
}
