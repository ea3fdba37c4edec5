//! Weight interpolation: `(1 − λ) θ_real + λ θ_adv`, and `Σ w_i θ_i` for more experts.
//!
//! Properties: at a corner the result is the expert's own values, bit for bit; a value that all experts
//! share is unchanged; the result is continuous in the weights.

use sage_core::registry::{Entry, NoOptions};

use crate::{Error, ExpertSet, Merger, TensorMerger, TensorRule, TensorSet, merger::mix_numbers};

/// The paper's mixture.
#[derive(Clone, Copy)]
pub struct Linear;

impl TensorMerger for Linear {
    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(*self))
    }
}

impl TensorRule for Linear {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        mix_numbers(tensor, at, out, |numbers, _| {
            let terms = numbers.iter().zip(at).map(|(x, weight)| weight * f64::from(*x));
            terms.reduce(|sum, term| sum + term).unwrap_or(0.0)
        });
    }
}

impl Entry<dyn Merger> for Linear {
    const NAME: &'static str = "linear";
    const SUMMARY: &'static str = "weight interpolation, (1 − λ) realistic + λ adversarial";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}
