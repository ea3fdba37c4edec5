//! Preference vectors: `θ_prior + Σ w_i (θ_i − θ_prior)`.
//!
//! On the simplex this is the same mixture as [`crate::Linear`], written relative to the prior, with the
//! same properties. The weights may be any numbers: task arithmetic with a sum of 2 goes twice as far from the prior.

use sage_core::registry::{Entry, NoOptions};

use crate::{Error, ExpertSet, Merger, Range, TensorMerger, TensorRule, TensorSet, merger::mix_numbers};

/// Tolerance of a sum of 1.
const ROUNDING: f64 = 1e-9;

/// Merging by preference vectors.
#[derive(Clone, Copy)]
pub struct PreferenceVector;

impl TensorMerger for PreferenceVector {
    fn range(&self) -> Range {
        Range::Beyond
    }

    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(*self))
    }
}

impl TensorRule for PreferenceVector {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        let mixed = |numbers: &mut dyn Iterator<Item = f32>, prior: f32| {
            let prior = f64::from(prior);
            numbers.zip(at).fold(prior, |sum, (x, weight)| sum + weight * (f64::from(x) - prior))
        };
        if (at.iter().sum::<f64>() - 1.0).abs() <= ROUNDING {
            return mix_numbers(tensor, at, out, |numbers, prior| mixed(&mut numbers.iter().copied(), prior));
        }
        for (k, out) in out.iter_mut().enumerate() {
            let mut numbers = tensor.experts.iter().map(|expert| expert[k]);
            *out = mixed(&mut numbers, tensor.prior[k]) as f32;
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_of_any_sum_go_as_far_from_the_prior() {
        // The first value is shared, the second is not.
        let experts = [vec![3.0f32, 2.0], vec![3.0, 4.0]];
        let tensor = TensorSet { name: "w", prior: &[1.0, 1.0], experts: &experts };
        let mut out = [0.0f32; 2];
        PreferenceVector.merge(&tensor, &[1.0, 1.0], &mut out);
        assert_eq!(out, [5.0, 5.0]);
        PreferenceVector.merge(&tensor, &[0.0, 0.0], &mut out);
        assert_eq!(out, [1.0, 1.0]);
        PreferenceVector.merge(&tensor, &[0.5, 0.5], &mut out);
        assert_eq!(out, [3.0, 3.0]);
    }
}
