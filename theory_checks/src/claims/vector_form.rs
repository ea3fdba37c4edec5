//! T8: interpolating weights is adding preference vectors.

use sage_core::registry::{Entry, NoOptions};

use crate::{Check, Report, Setup, random::normals};

/// Dimensions, in turn.
const DIMENSIONS: [usize; 4] = [1, 10, 100, 1000];
const TOLERANCE: f64 = 1e-12;

/// The claim T8.
pub struct VectorForm;

impl Entry<dyn Check> for VectorForm {
    const NAME: &'static str = "T8";
    const SUMMARY: &'static str = "interpolating weights adds preference vectors to the prior, for any λ";
    const SOURCE: &'static str = "SAGE (ICLR 2026), preference vectors";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

impl Check for VectorForm {
    fn formula(&self) -> &'static str {
        "θ(λ) = θ_ref + λ Δ_adv + (1 − λ) Δ_real with Δ_i = θ_i − θ_ref"
    }

    fn experiment(&self) -> &'static str {
        "1000 instances in dimensions 1, 10, 100 and 1000, normal weights, λ in [−1, 2]"
    }

    fn caveat(&self) -> &'static str {
        "because the coefficients sum to 1; otherwise the prior matters"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["coefficients exchanged", "θ_ref added twice"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let tally = setup.each("T8", 1000, |instance, rng, tally| {
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            let [prior, adversarial, realistic] = [(); 3].map(|()| normals(rng, dimension));
            // Beyond the experts too.
            let lambda = rng.uniform(-1.0, 2.0);
            let mut worst = 0.0f64;
            for k in 0..dimension {
                let mixed = (1.0 - lambda) * realistic[k] + lambda * adversarial[k];
                let deltas = [adversarial[k] - prior[k], realistic[k] - prior[k]];
                let [a, b] =
                    if injected == Some(0) { [1.0 - lambda, lambda] } else { [lambda, 1.0 - lambda] };
                let start = if injected == Some(1) { 2.0 * prior[k] } else { prior[k] };
                worst = worst.max((start + a * deltas[0] + b * deltas[1] - mixed).abs());
            }
            tally.equal(worst, 0.0, TOLERANCE);
        });
        tally.report(vec![], vec![])
    }
}
