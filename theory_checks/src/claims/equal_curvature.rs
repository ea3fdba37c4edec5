//! T1: with equal curvature the experts' segment holds every optimum between them.

use sage_core::registry::{Entry, NoOptions};

use super::instances::preference;
use crate::{
    Check, Report, Setup,
    random::{log_uniform, normals},
    root,
};

/// Dimensions, in turn.
const DIMENSIONS: [usize; 5] = [1, 2, 10, 100, 1000];
const TOLERANCE: f64 = 1e-9;

/// The claim T1.
pub struct EqualCurvature;

impl Entry<dyn Check> for EqualCurvature {
    const NAME: &'static str = "T1";
    const SUMMARY: &'static str =
        "equal curvature: interpolation is optimal inside, and its loss outside is known";
    const SOURCE: &'static str = "SAGE (ICLR 2026), appendix";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

impl Check for EqualCurvature {
    fn formula(&self) -> &'static str {
        "R_i = C_i − η/2 ‖θ − θ_i*‖²: θ̂_μ = μ θ_adv* + (1 − μ) θ_real*, best λ = clip(c₁, 0, 1), gap = η/2 (μ − clip(μ, 1 − β, β))² ‖θ_adv* − θ_real*‖²"
    }

    fn experiment(&self) -> &'static str {
        "1000 instances in dimensions 1, 2, 10, 100 and 1000, β in {0.51, 0.6, 0.75, 0.9, 1}, η in 10^[-1, 1], normal optima; optima by their gradient, best λ by bisection of the slope, gap as ½ xᵀHx"
    }

    fn caveat(&self) -> &'static str {
        "the distance of the experts is (2β − 1) times that of the optima; what λ = μ costs is T1b"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["without the factor ½", "μ clipped to [0, 1]", "λ = μ", "μ and 1 − μ exchanged in the optimum"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let tally = setup.each("T1", 1000, |instance, rng, tally| {
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            // Dimensions and values of β have the same period.
            let at = preference(rng, instance + instance / DIMENSIONS.len());
            let eta = log_uniform(rng, [-1.0, 1.0]);
            let [adversarial, realistic] = [(); 2].map(|()| normals(rng, dimension));
            let optimum = |weight: f64| {
                let weight = if injected == Some(3) { 1.0 - weight } else { weight };
                weight * &adversarial + (1.0 - weight) * &realistic
            };
            // The gradients of both rewards cancel there.
            for weight in [at.mu, at.beta, 1.0 - at.beta] {
                let theta = optimum(weight);
                let gradient =
                    weight * eta * (&adversarial - &theta) + (1.0 - weight) * eta * (&realistic - &theta);
                tally.equal(gradient.norm(), 0.0, TOLERANCE * (1.0 + eta));
            }
            let (hat, first, second) = (optimum(at.mu), optimum(at.beta), optimum(1.0 - at.beta));
            let at_lambda = |lambda: f64| (1.0 - lambda) * &second + lambda * &first;
            // The slope of R_μ along the segment, without the formula.
            let way = &first - &second;
            let best = root(|lambda| (&hat - at_lambda(lambda)).dot(&way));
            let direct = 0.5 * eta * (at_lambda(best) - &hat).norm_squared();
            let distance = (&adversarial - &realistic).norm_squared();
            let clipped = if injected == Some(1) { at.mu.clamp(0.0, 1.0) } else { at.clipped() };
            let half = if injected == Some(0) { 1.0 } else { 0.5 };
            let gap = half * eta * (at.mu - clipped) * (at.mu - clipped) * distance;
            tally.equal(gap, direct, TOLERANCE * (1.0 + eta * distance));
            let lambda = if injected == Some(2) { at.mu } else { at.coefficients()[0].clamp(0.0, 1.0) };
            tally.equal(lambda, best, TOLERANCE);
            let apart = (2.0 * at.beta - 1.0).powi(2) * distance;
            tally.equal(way.norm_squared(), apart, TOLERANCE * (1.0 + distance));
        });
        tally.report(vec![], vec![])
    }
}
