//! T9: norm and cosine of the preference vector along the path.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::normals;
use crate::{Check, Outcome, Setup, Tally};

/// Dimensions, in turn.
const DIMENSIONS: [usize; 4] = [2, 3, 10, 100];
/// Points on the path.
const POINTS: usize = 21;

/// The claim T9.
pub struct NormAndCosine;

impl Entry<dyn Check> for NormAndCosine {
    const NAME: &'static str = "T9";
    const SUMMARY: &'static str =
        "along the path the cosine always rises, the norm only if the norms differ enough";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Check for NormAndCosine {
    fn formula(&self) -> &'static str {
        "v(λ) = Δ_real + λ (Δ_adv − Δ_real): cos(v, Δ_adv) rises; ‖v‖ rises iff ⟨Δ_real, Δ_adv − Δ_real⟩ ≥ 0, falls iff ⟨Δ_adv, Δ_adv − Δ_real⟩ ≤ 0, else dips"
    }

    fn caveat(&self) -> &'static str {
        "a cosine that rises is geometry, no evidence about training; the norm is monotone only for a ratio of the norms of at least 1/cos ψ"
    }

    fn planted(&self) -> &'static [&'static str] {
        &["the cosine to Δ_real rises", "the sign of the criterion of the norm flipped"]
    }

    fn run(&self, setup: &Setup, planted: Option<usize>) -> Outcome {
        let mut rng = Rng::new(setup.seed, "T9", "instances");
        let mut tally = Tally::default();
        for instance in 0..setup.instances {
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            let adversarial = normals(&mut rng, dimension);
            // Correlated and of another length, so that all three cases of the norm occur.
            let (shared, scale) = (rng.uniform(-1.0, 1.0), 10f64.powf(rng.uniform(-1.0, 1.0)));
            let other = normals(&mut rng, dimension);
            let realistic: Vec<f64> = adversarial
                .iter()
                .zip(&other)
                .map(|(a, b)| scale * (shared * a + (1.0 - shared.abs()) * b))
                .collect();
            let way: Vec<f64> = adversarial.iter().zip(&realistic).map(|(a, r)| a - r).collect();
            let at = |k: usize| -> Vec<f64> {
                let lambda = k as f64 / (POINTS - 1) as f64;
                realistic.iter().zip(&way).map(|(r, w)| r + lambda * w).collect()
            };
            let path: Vec<Vec<f64>> = (0..POINTS).map(at).collect();
            let target = if planted == Some(0) { &realistic } else { &adversarial };
            let cosine = |v: &[f64]| dot(v, target) / (dot(v, v) * dot(target, target)).sqrt();
            let cosines: Vec<f64> = path.iter().map(|v| cosine(v)).collect();
            tally.holds(cosines.windows(2).all(|pair| pair[1] >= pair[0] - 1e-12));
            let norms: Vec<f64> = path.iter().map(|v| dot(v, v)).collect();
            let steps = || norms.windows(2).map(|pair| pair[1] - pair[0]);
            let slack = 1e-12 * norms.iter().copied().fold(0.0, f64::max);
            let sign = if planted == Some(1) { -1.0 } else { 1.0 };
            let (first, last) = (sign * dot(&realistic, &way), sign * dot(&adversarial, &way));
            // Between the ends of the criterion the grid cannot tell a dip from a monotone norm.
            let resolution = dot(&way, &way) / (POINTS - 1) as f64;
            if first.abs() > resolution && last.abs() > resolution {
                tally.holds(steps().all(|step| step >= -slack) == (first >= 0.0));
                tally.holds(steps().all(|step| step <= slack) == (last <= 0.0));
            }
        }
        tally.outcome()
    }
}
