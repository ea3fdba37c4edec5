//! What TIES and DARE share: sparse task vectors, and a consensus on their signs.
//!
//! `θ = θ_prior + scale · Σ w_i m_i τ_i / divisor`, with the sparse difference `τ_i` of each expert from the prior
//! and `m_i` 1 where its sign is that of the majority. Source: the generalised task arithmetic of mergekit.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use crate::{TensorRule, TensorSet};

/// How the experts agree on the sign of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Consensus {
    /// All values count.
    None,
    /// Values with the sign of the weighted sum count.
    Sum,
    /// Values with the sign of most experts count.
    Count,
}

impl Consensus {
    /// The sign that counts: 1 or −1; `None` if all count.
    fn sign(self, weighted: &[f64]) -> Option<f64> {
        let signs = || weighted.iter().map(|x| sign(*x)).sum::<f64>();
        match self {
            Self::None => None,
            Self::Sum => Some(if weighted.iter().sum::<f64>() >= 0.0 { 1.0 } else { -1.0 }),
            Self::Count => Some(if signs() >= 0.0 { 1.0 } else { -1.0 }),
        }
    }
}

/// Sign of a number; 0 for 0.
fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// The sum of sparse task vectors, added to the prior.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TaskArithmetic {
    pub(crate) consensus: Consensus,
    /// Whether the sum is divided by the weights that count.
    pub(crate) normalizes: bool,
    /// Factor of the sum.
    pub(crate) scale: f64,
}

impl TaskArithmetic {
    /// Writes the merged tensor. `vectors` are the sparse task vectors.
    pub(crate) fn merge(&self, tensor: &TensorSet, vectors: &[Vec<f64>], at: &[f64], out: &mut [f32]) {
        // An expert without weight counts nowhere.
        let (at, vectors): (Vec<f64>, Vec<&Vec<f64>>) =
            at.iter().zip(vectors).filter(|(weight, _)| **weight != 0.0).unzip();
        let mut weighted = vec![0.0; vectors.len()];
        for (k, out) in out.iter_mut().enumerate() {
            for (i, weighted) in weighted.iter_mut().enumerate() {
                *weighted = at[i] * vectors[i][k];
            }
            let majority = self.consensus.sign(&weighted);
            let counts = |i: &usize| majority.is_none_or(|majority| sign(weighted[*i]) == majority);
            let (mut sum, mut divisor) = (0.0, 0.0);
            for i in (0..weighted.len()).filter(counts) {
                sum += weighted[i];
                divisor += at[i];
            }
            if self.normalizes && divisor.abs() > 1e-8 {
                sum /= divisor;
            }
            *out = (f64::from(tensor.prior[k]) + self.scale * sum) as f32;
        }
    }
}

/// Makes the task vectors of a tensor sparse.
pub(crate) trait Sparsify: Send + Sync {
    /// Sets values of the experts' task vectors to 0, and may scale the others.
    fn sparsify(&self, tensor: &TensorSet, vectors: &mut [Vec<f64>]);

    /// How the sparse vectors are merged.
    fn arithmetic(&self) -> TaskArithmetic;
}

/// The rule of a sparse merger. Sparse vectors do not depend on the mixture, so they are computed once per tensor.
pub(crate) struct SparseRule<S> {
    sparsify: S,
    known: Mutex<BTreeMap<String, Arc<Vec<Vec<f64>>>>>,
}

impl<S> SparseRule<S> {
    pub(crate) fn new(sparsify: S) -> Self {
        Self { sparsify, known: Mutex::default() }
    }
}

impl<S: Sparsify> TensorRule for SparseRule<S> {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        // After a panic in another thread the map holds complete vectors only.
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let vectors = known.entry(tensor.name.to_owned()).or_insert_with(|| {
            let mut vectors = task_vectors(tensor);
            self.sparsify.sparsify(tensor, &mut vectors);
            Arc::new(vectors)
        });
        let vectors = vectors.clone();
        drop(known);
        self.sparsify.arithmetic().merge(tensor, &vectors, at, out);
    }
}

/// The experts' differences from the prior.
pub(crate) fn task_vectors(tensor: &TensorSet) -> Vec<Vec<f64>> {
    let difference = |(x, prior): (&f32, &f32)| f64::from(*x) - f64::from(*prior);
    tensor.experts.iter().map(|expert| expert.iter().zip(tensor.prior).map(difference).collect()).collect()
}

/// Checks a share of values that are kept, and a factor.
///
/// *Errors*: a share outside (0, 1]; a factor that is not finite.
pub(crate) fn check(density: f64, scale: f64) -> Result<(), String> {
    if !(density > 0.0 && density <= 1.0) {
        return Err(format!("`density` is {density}; expected a number above 0, up to 1"));
    }
    if !scale.is_finite() {
        return Err(format!("`scale` is {scale}; expected a finite number"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_values_of_the_elected_sign_count() {
        let experts = [vec![3.0f32, 1.0, 1.0], vec![-1.0, 2.0, 0.0]];
        let tensor = TensorSet { name: "w", prior: &[0.0, 0.0, 0.0], experts: &experts };
        let merged = |consensus, normalizes, at: [f64; 2]| {
            let mut out = [0.0f32; 3];
            let rule = TaskArithmetic { consensus, normalizes, scale: 1.0 };
            rule.merge(&tensor, &task_vectors(&tensor), &at, &mut out);
            out
        };
        assert_eq!(merged(Consensus::None, false, [0.5, 0.5]), [1.0, 1.5, 0.5]);
        // Column 1: 1.5 against −0.5, so the first alone, divided by its weight. Column 3: the zero counts not.
        assert_eq!(merged(Consensus::Sum, true, [0.5, 0.5]), [3.0, 1.5, 1.0]);
        // With weights 0.1 and 0.9 the second has the larger sum.
        assert_eq!(merged(Consensus::Sum, true, [0.1, 0.9])[0], -1.0);
        // A tie of signs counts as positive.
        assert_eq!(merged(Consensus::Count, true, [0.1, 0.9])[0], 3.0);
    }
}
