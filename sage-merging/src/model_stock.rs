//! Model stock: the mean of the experts, drawn towards the prior by the angle between them,
//! `t θ_mean + (1 − t) θ_prior` with `t = k cos ψ / (1 + (k − 1) cos ψ)`, for each tensor.
//!
//! `cos ψ` is the mean cosine between the preference vectors of `k` experts. λ has no effect. Properties: experts with
//! the same weights merge to them; the order of the experts does not matter, except for rounding.

use sage_core::registry::{Entry, NoOptions};

use crate::{Error, ExpertSet, Merger, TensorMerger, TensorRule, TensorSet, task_arithmetic::task_vectors};

/// The centre of the experts' weights, estimated from their angle.
#[derive(Clone, Copy)]
pub struct ModelStock;

impl TensorMerger for ModelStock {
    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        Ok(Box::new(*self))
    }
}

impl TensorRule for ModelStock {
    fn merge(&self, tensor: &TensorSet, _: &[f64], out: &mut [f32]) {
        let share = share_of_mean(&task_vectors(tensor));
        for (k, out) in out.iter_mut().enumerate() {
            let first = tensor.experts[0][k];
            if share == 1.0 && tensor.experts.iter().all(|expert| expert[k] == first) {
                *out = first;
                continue;
            }
            let sum: f64 = tensor.experts.iter().map(|expert| f64::from(expert[k])).sum();
            let mean = sum / tensor.experts.len() as f64;
            *out = (share * mean + (1.0 - share) * f64::from(tensor.prior[k])) as f32;
        }
    }
}

/// Weight of the mean, from the mean cosine of all pairs; 1 for a single expert and for equal ones.
fn share_of_mean(vectors: &[Vec<f64>]) -> f64 {
    let count = vectors.len();
    let dot = |a: usize, b: usize| vectors[a].iter().zip(&vectors[b]).map(|(x, y)| x * y).sum::<f64>();
    let norms: Vec<f64> = (0..count).map(|k| dot(k, k).sqrt()).collect();
    let cosine = |a: usize, b: usize| {
        if vectors[a] == vectors[b] {
            return 1.0;
        }
        // An expert that is the prior here has no direction.
        if norms[a] * norms[b] > 0.0 { (dot(a, b) / (norms[a] * norms[b])).clamp(-1.0, 1.0) } else { 0.0 }
    };
    let pairs = (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b)));
    let cosines: Vec<f64> = pairs.map(|(a, b)| cosine(a, b)).collect();
    if cosines.iter().all(|cosine| *cosine == 1.0) {
        return 1.0;
    }
    let cosine = cosines.iter().sum::<f64>() / cosines.len() as f64;
    // Experts that point away from each other have no common centre beyond the prior.
    if cosine <= 0.0 {
        return 0.0;
    }
    (count as f64 * cosine / (1.0 + (count as f64 - 1.0) * cosine)).clamp(0.0, 1.0)
}

impl Entry<dyn Merger> for ModelStock {
    const NAME: &'static str = "model-stock";
    const SUMMARY: &'static str =
        "the mean of all experts, drawn to the prior by their angle, for any mixture";
    const SOURCE: &'static str = "Jang et al. 2024 (Model Stock)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_worked_by_hand() {
        // Vectors (1, 0) and (1, 1): cos ψ = 1/√2, t = 2 cos ψ / (1 + cos ψ) = 0.828.
        let experts = [vec![1.0f32, 0.0], vec![1.0, 1.0]];
        let tensor = TensorSet { name: "w", prior: &[0.0, 0.0], experts: &experts };
        let mut out = [0.0f32; 2];
        ModelStock.merge(&tensor, &[1.0, 0.0], &mut out);
        let cosine = std::f32::consts::FRAC_1_SQRT_2;
        let share = 2.0 * cosine / (1.0 + cosine);
        assert!((out[0] - share).abs() < 1e-6 && (out[1] - 0.5 * share).abs() < 1e-6, "{out:?}");
        // Opposite vectors leave the prior.
        assert_eq!(share_of_mean(&[vec![1.0, 0.0], vec![-1.0, 0.0]]), 0.0);
        assert_eq!(share_of_mean(&[vec![0.3, 0.1], vec![0.3, 0.1]]), 1.0);
    }
}
