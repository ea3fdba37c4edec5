//! T1: with equal curvature the experts' segment holds every optimum between them.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::{normals, preference, root};
use crate::{Check, Outcome, Setup, Tally};

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
        "R_i = C_i − η/2 ‖θ − θ_i*‖²: best λ = clip(c₁, 0, 1), gap = η/2 (μ − clip(μ, 1 − β, β))² ‖θ_adv* − θ_real*‖²"
    }

    fn caveat(&self) -> &'static str {
        "λ = μ, as in experiments, is optimal for (1 − β) + (2β − 1) μ, not for μ"
    }

    fn planted(&self) -> &'static [&'static str] {
        &["without the factor ½", "μ clipped to [0, 1]", "λ = μ"]
    }

    fn run(&self, setup: &Setup, planted: Option<usize>) -> Outcome {
        let mut rng = Rng::new(setup.seed, "T1", "instances");
        let mut tally = Tally::default();
        for instance in 0..setup.instances {
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            // Dimensions and values of β have the same period.
            let at = preference(&mut rng, instance + instance / DIMENSIONS.len());
            let eta = 10f64.powf(rng.uniform(-1.0, 1.0));
            let [adversarial, realistic] = [(); 2].map(|()| normals(&mut rng, dimension));
            let optimum = |weight: f64| -> Vec<f64> {
                adversarial.iter().zip(&realistic).map(|(a, r)| weight * a + (1.0 - weight) * r).collect()
            };
            let (hat, first, second) = (optimum(at.mu), optimum(at.beta), optimum(1.0 - at.beta));
            let on_segment = |lambda: f64| -> Vec<f64> {
                first.iter().zip(&second).map(|(a, b)| (1.0 - lambda) * b + lambda * a).collect()
            };
            let squared = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            // The gradient of R_μ along the segment, without the formula.
            let slope = |lambda: f64| -> f64 {
                let here = on_segment(lambda);
                (0..dimension).map(|k| (hat[k] - here[k]) * (first[k] - second[k])).sum()
            };
            let best = root(slope);
            let direct = 0.5 * eta * squared(&on_segment(best), &hat);
            let distance = squared(&adversarial, &realistic);
            let clipped = if planted == Some(1) { at.mu.clamp(0.0, 1.0) } else { at.clipped() };
            let half = if planted == Some(0) { 1.0 } else { 0.5 };
            let gap = half * eta * (at.mu - clipped) * (at.mu - clipped) * distance;
            tally.equal(gap, direct, TOLERANCE * (1.0 + eta * distance));
            let lambda = if planted == Some(2) { at.mu } else { at.coefficients()[0].clamp(0.0, 1.0) };
            tally.equal(lambda, best, TOLERANCE);
        }
        tally.outcome()
    }
}
