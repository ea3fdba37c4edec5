//! T9: norm and cosine of the preference vector along the path.

use nalgebra::DVector;
use sage_core::registry::{Entry, NoOptions};

use crate::{
    Check, Report, Setup, Verdict,
    random::{log_uniform, normals},
};

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

impl Check for NormAndCosine {
    fn formula(&self) -> &'static str {
        "v(λ) = Δ_real + λ w, w = Δ_adv − Δ_real: cos(v, Δ_adv) rises for every angle ψ; ‖v‖ rises iff ⟨Δ_real, w⟩ ≥ 0, falls iff ⟨Δ_adv, w⟩ ≤ 0, else dips at −⟨Δ_real, w⟩/‖w‖²"
    }

    fn experiment(&self) -> &'static str {
        "5000 pairs of vectors in dimensions 2, 3, 10 and 100, correlated, one of them scaled by 10^[-1, 1]; the norm by the signs of its slope at both ends, the dip and the cosine on 21 points"
    }

    fn caveat(&self) -> &'static str {
        "a cosine that rises is geometry, no evidence about training; the condition of the norm is a ratio of the lengths of at least 1/cos ψ, 2 at 60°"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["the cosine to Δ_real rises", "the sign of the criterion of the norm flipped"]
    }

    fn expected(&self) -> Verdict {
        Verdict::HoldsIf
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let mut tally = setup.each("T9", 5000, |instance, rng, tally| {
            let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
            let adversarial = normals(rng, dimension);
            // Correlated and of another length, so that all three cases of the norm occur.
            let (shared, scale) = (rng.uniform(-1.0, 1.0), log_uniform(rng, [-1.0, 1.0]));
            let other = normals(rng, dimension);
            let realistic = scale * (shared * &adversarial + (1.0 - shared.abs()) * other);
            let way = &adversarial - &realistic;
            let at = |k: usize| &realistic + k as f64 / (POINTS - 1) as f64 * &way;
            let path: Vec<DVector<f64>> = (0..POINTS).map(at).collect();
            let target = if injected == Some(0) { &realistic } else { &adversarial };
            let cosines: Vec<f64> = path.iter().map(|v| v.dot(target) / (v.norm() * target.norm())).collect();
            tally.holds(cosines.windows(2).all(|pair| pair[1] >= pair[0] - 1e-12));
            // The condition in terms of the angle against the path itself.
            let (long, short) = (adversarial.norm(), realistic.norm());
            let cosine = adversarial.dot(&realistic) / (long * short);
            let sign = if injected == Some(1) { -1.0 } else { 1.0 };
            let (rises, falls) =
                (sign * (cosine - short / long) >= 0.0, sign * (cosine - long / short) >= 0.0);
            let (start, end) = (realistic.dot(&way), adversarial.dot(&way));
            tally.holds(rises == (start >= 0.0) && falls == (end <= 0.0));
            // The path itself, where 21 points can show it.
            let norms: Vec<f64> = path.iter().map(|v| v.norm()).collect();
            let slack = 1e-12 * long.max(short);
            if rises {
                tally.holds(norms.windows(2).all(|pair| pair[1] >= pair[0] - slack));
            } else if falls {
                tally.holds(norms.windows(2).all(|pair| pair[1] <= pair[0] + slack));
            }
            let dip = (-start / way.norm_squared()).clamp(0.0, 1.0);
            let least = (&realistic + dip * &way).norm();
            let on_path = path.iter().map(|v| v.norm()).fold(f64::INFINITY, f64::min);
            tally.at_most(least, on_path, 1e-12 * long);
            // Where the condition is missed the norm dips below both ends.
            if !rises && !falls {
                tally.exception(least < long.min(short));
            }
        });
        // Equal lengths at an angle dip to the cosine of half of it.
        for degrees in [10.0f64, 60.0, 120.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let middle = 0.5 * DVector::from_row_slice(&[1.0 + cos, sin]);
            tally.compare_stored(middle.norm(), (0.5 * degrees.to_radians()).cos(), 1e-12);
        }
        tally.report(vec![], vec![])
    }
}
