//! Preference vectors: `θ_prior + Σ w_i (θ_i − θ_prior)`.
//!
//! On the simplex this is the same mixture as [`crate::Linear`], written relative to the prior, with the
//! same properties.

use sage_core::registry::{Entry, NoOptions};

use crate::{Error, ExpertSet, Merger, TensorMerger, TensorRule, TensorSet, merger::mix_numbers};

/// Merging by preference vectors.
#[derive(Clone, Copy)]
pub struct PreferenceVector;

impl TensorMerger for PreferenceVector {
    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(*self))
    }
}

impl TensorRule for PreferenceVector {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        mix_numbers(tensor, at, out, |numbers, prior| {
            let prior = f64::from(prior);
            numbers.iter().zip(at).fold(prior, |sum, (x, weight)| sum + weight * (f64::from(*x) - prior))
        });
    }
}

impl Entry<dyn Merger> for PreferenceVector {
    const NAME: &'static str = "preference-vector";
    const SUMMARY: &'static str = "the prior plus the weighted differences of the experts from it";
    const SOURCE: &'static str = "SAGE (ICLR 2026), after task arithmetic (Ilharco et al. 2023)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}
