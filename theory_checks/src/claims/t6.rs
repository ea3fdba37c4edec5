//! T6: the appendix's bound, read with the theorem's preference, is not a bound.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::t2::Line;
use crate::{Check, Outcome, Preference, Setup, Tally, Verdict};

/// Values of β, in turn; at 1 the threshold is infinite.
const BETAS: [f64; 4] = [0.51, 0.6, 0.75, 0.9];
/// Relative distance from the threshold below which rounding decides.
const NEAR: f64 = 1e-9;

/// The claim T6.
pub struct PrintedBound;

impl Entry<dyn Check> for PrintedBound {
    const NAME: &'static str = "T6";
    const SUMMARY: &'static str =
        "the appendix's bound with the theorem's preference is below the gap for unequal curvatures";
    const SOURCE: &'static str = "SAGE (ICLR 2026), appendix; counterexamples of this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Bounds of the gap.
struct Bounds {
    /// As printed: c₁ and c₂, and μ and 1 − μ in the curvature, are exchanged.
    printed: f64,
    /// With the convention of the theorem, and with the smaller of both products.
    max: f64,
    min: f64,
}

impl Bounds {
    fn of(line: &Line, at: Preference) -> Self {
        let [c1, c2] = at.coefficients().map(f64::abs);
        let [first, second] = [at.beta, 1.0 - at.beta].map(|weight| line.curvature(weight));
        let distance = line.optimum(at.beta) - line.optimum(1.0 - at.beta);
        let bound = |f: f64, weight: f64| f * f * distance * distance / (2.0 * line.curvature(weight));
        Self {
            printed: bound((c2 * first).max(c1 * second), 1.0 - at.mu),
            max: bound((c1 * first).max(c2 * second), at.mu),
            min: bound((c1 * first).min(c2 * second), at.mu),
        }
    }
}

impl Check for PrintedBound {
    fn formula(&self) -> &'static str {
        "printed: max(|c₂| L₁, |c₁| L₂)² D² / (2 [(1 − μ) m_adv + μ m_real]); at μ = 1 below the gap iff b/a > (β/(1 − β))²"
    }

    fn caveat(&self) -> &'static str {
        "the appendix is coherent alone: it uses the reversed preference (1 − μ) R_adv + μ R_real; with equal curvatures both readings coincide"
    }

    fn planted(&self) -> &'static [&'static str] {
        &["equal curvatures", "c₁ and c₂ in the theorem's order"]
    }

    fn confirmed(&self) -> Verdict {
        Verdict::FailsAsPrinted
    }

    fn run(&self, setup: &Setup, planted: Option<usize>) -> Outcome {
        let mut rng = Rng::new(setup.seed, "T6", "instances");
        let mut tally = Tally::default();
        let printed = |bounds: &Bounds| if planted == Some(1) { bounds.max } else { bounds.printed };
        let mut counterexamples = 0;
        for instance in 0..setup.instances {
            let beta = BETAS[instance % BETAS.len()];
            let a = 10f64.powf(rng.uniform(-1.0, 1.0));
            let ratio = 10f64.powf(rng.uniform(-1.0, 3.0));
            let line = Line { a, b: if planted == Some(0) { a } else { a * ratio } };
            let at = Preference { mu: 1.0, beta };
            let [_, gap] = line.direct(at);
            let bounds = Bounds::of(&line, at);
            // The bounds of the theorem's convention hold.
            tally.holds(bounds.min >= gap * (1.0 - NEAR) && bounds.max >= bounds.min);
            let threshold = (beta / (1.0 - beta)).powi(2);
            let is_below = printed(&bounds) < gap;
            let is_predicted = line.b / line.a > threshold;
            if (line.b / line.a / threshold - 1.0).abs() > NEAR {
                tally.holds(is_below == is_predicted);
            }
            counterexamples += usize::from(is_below);
        }
        tally.holds(counterexamples > 0);
        for (beta, a, b, mu, [gap, wrong, max, min]) in [
            (0.6, 1.0, 10.0, 1.0, [0.378072, 0.0850662, 0.439453, 0.378072]),
            (0.6, 10.0, 1.0, 0.0, [0.378072, 0.0850662, 0.439453, 0.378072]),
            (0.6, 1.0, 10.0, 0.95, [0.199628, 0.0748473, 0.254664, 0.199628]),
            (0.6, 1.0, 3.0, 1.0, [0.222222, 0.166667, 0.334711, 0.222222]),
            (0.9, 1.0, 1000.0, 1.0, [0.491120, 0.0397807, 0.499889, 0.491120]),
            (0.75, 1.0, 5.0, 1.0, [0.195312, 0.351562, 0.439453, 0.195312]),
        ] {
            let (line, at) = (Line { a, b }, Preference { mu, beta });
            let bounds = Bounds::of(&line, at);
            let found = [line.direct(at)[1], printed(&bounds), bounds.max, bounds.min];
            for (found, stored) in found.into_iter().zip([gap, wrong, max, min]) {
                tally.stored(found, stored, 1e-6);
            }
        }
        tally.outcome()
    }
}
