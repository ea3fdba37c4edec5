//! SLERP: spherical interpolation, `sin((1 − λ) ψ)/sin ψ · v_0 + sin(λ ψ)/sin ψ · v_1`. Vectors of equal norm turn
//! at constant speed.
//!
//! By default `v` are the preference vectors of the whole model and ψ is the angle between them: raw weights
//! of experts of one prior are so nearly parallel that SLERP of them is interpolation. With `of: weights`,
//! each tensor has its own angle, and a tensor with a cosine above 0.9995 is interpolated, as in mergekit.
//!
//! Properties: at a corner the result is the expert's own values; the order of the two does not matter;
//! parallel vectors are interpolated.

use sage_core::{generator::corner, registry::Entry};
use serde::{Deserialize, Serialize};

use crate::{
    Error, ExpertSet, Geometry, Linear, Merger, PreferenceVector, Range, TensorMerger, TensorRule, TensorSet,
};

/// Cosine above which two vectors are interpolated.
const PARALLEL: f64 = 0.9995;

/// Options of [`Slerp`].
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlerpOptions {
    /// What is interpolated.
    pub of: SlerpOf,
}

/// What SLERP interpolates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SlerpOf {
    /// The preference vectors of the whole model.
    #[default]
    Vectors,
    /// The weights of each tensor.
    Weights,
}

/// Spherical interpolation of two experts.
#[derive(Clone, Copy)]
pub struct Slerp(SlerpOptions);

impl TensorMerger for Slerp {
    fn range(&self) -> Range {
        Range::Edge
    }

    fn prepare(&self, experts: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        if self.0.of == SlerpOf::Weights {
            return Ok(Box::new(PerTensor));
        }
        Ok(Box::new(WholeModel { geometry: Geometry::of(experts)? }))
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Weights of two vectors with a cosine, at the share of the second; `None` if they are parallel.
fn spherical(cosine: f64, share: f64) -> Option<[f64; 2]> {
    if cosine.is_nan() || cosine.abs() > PARALLEL {
        return None;
    }
    let angle = cosine.acos();
    Some([((1.0 - share) * angle).sin() / angle.sin(), (share * angle).sin() / angle.sin()])
}

/// The two experts of a mixture on an edge.
fn pair(at: &[f64]) -> [usize; 2] {
    let mut positive = (0..at.len()).filter(|&k| at[k] > 0.0);
    let first = positive.next().unwrap_or(0);
    [first, positive.next().unwrap_or(first)]
}

struct WholeModel {
    geometry: Geometry,
}

impl TensorRule for WholeModel {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        let [a, b] = pair(at);
        let product = |a: usize, b: usize| self.geometry.product(a, b);
        match spherical(product(a, b) / (product(a, a) * product(b, b)).sqrt(), at[b]) {
            None => PreferenceVector.merge(tensor, at, out),
            Some(_) if corner(at).is_some() => Linear.merge(tensor, at, out),
            Some([of_a, of_b]) => {
                for (k, out) in out.iter_mut().enumerate() {
                    let prior = f64::from(tensor.prior[k]);
                    let [x, y] = [a, b].map(|expert| f64::from(tensor.experts[expert][k]) - prior);
                    *out = (prior + of_a * x + of_b * y) as f32;
                }
            }
        }
    }
}

struct PerTensor;

impl TensorRule for PerTensor {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        let [a, b] = pair(at);
        let [x, y] = [a, b].map(|k| tensor.experts[k].iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
        match spherical(dot(&x, &y) / (dot(&x, &x) * dot(&y, &y)).sqrt(), at[b]) {
            None => Linear.merge(tensor, at, out),
            Some(_) if corner(at).is_some() => Linear.merge(tensor, at, out),
            Some([of_a, of_b]) => {
                for ((out, x), y) in out.iter_mut().zip(&x).zip(&y) {
                    *out = (of_a * x + of_b * y) as f32;
                }
            }
        }
    }
}

impl Entry<dyn Merger> for Slerp {
    const NAME: &'static str = "slerp";
    const SUMMARY: &'static str = "spherical interpolation of two experts";
    const SOURCE: &'static str = "Shoemake 1985; of weights as in mergekit";
    type Options = SlerpOptions;

    fn build(options: SlerpOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self(options)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_way_between_orthogonal_vectors_is_at_45_degrees() {
        let experts = [vec![4.0f32, 1.0], vec![1.0, 4.0]];
        let tensor = TensorSet { name: "w", prior: &[1.0, 1.0], experts: &experts };
        let mut out = [0.0f32; 2];
        // Vectors (3, 0) and (0, 3): half way has length 3.
        let geometry = Geometry::of_products(vec![vec![9.0, 0.0], vec![0.0, 9.0]]);
        WholeModel { geometry }.merge(&tensor, &[0.5, 0.5], &mut out);
        let expected = 1.0 + 3.0 * std::f32::consts::FRAC_1_SQRT_2;
        assert!(out.iter().all(|x| (x - expected).abs() < 1e-6), "{out:?}");
    }

    #[test]
    fn a_third_expert_and_shared_values_do_not_matter() {
        // Vectors (1, 0, 1) and (0, 1, 1): ψ = 60°, at half both weights are sin 30°/sin 60° = 1/√3.
        let experts = [vec![1.0f32, 0.0, 1.0], vec![0.0, 1.0, 1.0], vec![9.0, 9.0, 9.0]];
        let tensor = TensorSet { name: "w", prior: &[0.0; 3], experts: &experts };
        let mut products = vec![vec![2.0, 1.0, 18.0], vec![1.0, 2.0, 18.0]];
        products.push(vec![18.0, 18.0, 243.0]);
        let mut out = [0.0f32; 3];
        let rule = WholeModel { geometry: Geometry::of_products(products) };
        rule.merge(&tensor, &[0.5, 0.5, 0.0], &mut out);
        let weight = 1.0 / 3f32.sqrt();
        for (found, expected) in out.iter().zip([weight, weight, 2.0 * weight]) {
            assert!((found - expected).abs() < 1e-6, "{out:?}");
        }
    }

    #[test]
    fn weights_of_one_tensor_keep_their_norm() {
        let experts = [vec![1.0f32, 0.0], vec![0.0, 1.0]];
        let tensor = TensorSet { name: "w", prior: &[0.0, 0.0], experts: &experts };
        let mut out = [0.0f32; 2];
        PerTensor.merge(&tensor, &[0.25, 0.75], &mut out);
        let (sin, cos) = (0.75 * std::f32::consts::FRAC_PI_2).sin_cos();
        assert!((out[0] - cos).abs() < 1e-6 && (out[1] - sin).abs() < 1e-6, "{out:?}");
    }
}
