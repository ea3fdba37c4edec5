//! T1b: interpolation at λ = μ, as in experiments, is optimal for another preference.

use nalgebra::DVector;
use sage_core::registry::{Entry, NoOptions};

use super::instances::preference;
use crate::{
    Check, Report, Setup,
    random::{log_uniform, normals},
};

/// Dimensions, in turn.
const DIMENSIONS: [usize; 4] = [1, 2, 10, 100];
const TOLERANCE: f64 = 1e-9;

/// The claim T1b.
pub struct LambdaEqualsMu;

impl Entry<dyn Check> for LambdaEqualsMu {
    const NAME: &'static str = "T1b";
    const SUMMARY: &'static str = "equal curvature: what interpolation at λ = μ costs";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

impl Check for LambdaEqualsMu {
    fn formula(&self) -> &'static str {
        "θ(μ) is optimal for μ' = (1 − β) + (2β − 1) μ and misses η/2 (1 − β)² (1 − 2μ)² ‖θ_adv* − θ_real*‖² of R_μ"
    }

    fn experiment(&self) -> &'static str {
        "1000 instances in dimensions 1, 2, 10 and 100, β in {0.51, 0.6, 0.75, 0.9, 1}, η in 10^[-1, 1], normal optima"
    }

    fn caveat(&self) -> &'static str {
        "at β = 0.9, λ = μ means μ' = 0.1 + 0.8 μ: nothing is lost at μ = 0.5, and as much as by the best λ at 0 and 1"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["θ(μ) optimal for μ", "(1 − β) without its square"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let tally = setup.each("T1b", 1000, |instance, rng, tally| {
            let at = preference(rng, instance);
            let eta = log_uniform(rng, [-1.0, 1.0]);
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            let [adversarial, realistic] = [(); 2].map(|()| normals(rng, dimension));
            let optimum = |weight: f64| weight * &adversarial + (1.0 - weight) * &realistic;
            // θ(μ) is where the gradient of R_μ' is 0, in terms of the rewards.
            let theta = at.mu * optimum(at.beta) + (1.0 - at.mu) * optimum(1.0 - at.beta);
            let distance = (&adversarial - &realistic).norm_squared();
            let other =
                if injected == Some(0) { at.mu } else { (1.0 - at.beta) + (2.0 * at.beta - 1.0) * at.mu };
            let gradient =
                other * eta * (&adversarial - &theta) + (1.0 - other) * eta * (&realistic - &theta);
            tally.equal(gradient.norm_squared(), 0.0, TOLERANCE * (1.0 + eta * eta * distance));
            let share = (1.0 - at.beta).powi(if injected == Some(1) { 1 } else { 2 });
            let loss = 0.5 * eta * share * (1.0 - 2.0 * at.mu).powi(2) * distance;
            let value = |theta: &DVector<f64>| {
                let [own, other] =
                    [&adversarial, &realistic].map(|top| -0.5 * eta * (theta - top).norm_squared());
                at.mu * own + (1.0 - at.mu) * other
            };
            let direct = value(&optimum(at.mu)) - value(&theta);
            tally.equal(loss, direct, TOLERANCE * (1.0 + eta * distance));
        });
        tally.report(vec![], vec![])
    }
}
