//! T0: any preference is a combination of the two experts' rewards.

use sage_core::registry::{Entry, NoOptions};

use super::instances::preference;
use crate::{Check, Report, Setup};

/// Rounding of one operation; `1/(2β − 1)` amplifies it.
const ROUNDING: f64 = 1e-14;

/// The claim T0.
pub struct TwoExpertsAreAnyPreference;

impl Entry<dyn Check> for TwoExpertsAreAnyPreference {
    const NAME: &'static str = "T0";
    const SUMMARY: &'static str = "every preference is a combination of the two experts' rewards";
    const SOURCE: &'static str = "SAGE (ICLR 2026), appendix";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

impl Check for TwoExpertsAreAnyPreference {
    fn formula(&self) -> &'static str {
        "R_μ = c₁ R₁ + c₂ R₂ with c₁ = (μ + β − 1)/(2β − 1), c₂ = (β − μ)/(2β − 1), c₁ + c₂ = 1"
    }

    fn experiment(&self) -> &'static str {
        "1000 instances, β in {0.51, 0.6, 0.75, 0.9, 1}, μ uniform, 0, 1 or at a border of [1 − β, β], each with 4 pairs of normal numbers as values or components of gradients; tolerance 1e-14 (|c₁| + |c₂|)"
    }

    fn caveat(&self) -> &'static str {
        "an identity of values and gradients; the coefficients are negative outside [1 − β, β]"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["c₁ and c₂ exchanged"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let tally = setup.each("T0", 1000, |instance, rng, tally| {
            let at = preference(rng, instance);
            let [mut c1, mut c2] = at.coefficients();
            if injected == Some(0) {
                (c1, c2) = (c2, c1);
            }
            let tolerance = ROUNDING * (c1.abs() + c2.abs());
            tally.equal(c1 + c2, 1.0, tolerance);
            // Values, and components of gradients.
            for _ in 0..4 {
                let (adversarial, realistic) = (rng.normal(), rng.normal());
                let mixed = |weight: f64| weight * adversarial + (1.0 - weight) * realistic;
                let scale = 1.0 + adversarial.abs() + realistic.abs();
                let combined = c1 * mixed(at.beta) + c2 * mixed(1.0 - at.beta);
                tally.equal(combined, mixed(at.mu), tolerance * scale);
            }
        });
        tally.report(vec![], vec![])
    }
}
