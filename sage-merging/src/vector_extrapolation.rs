//! Vector extrapolation: from a base along preference vectors, `θ_base + Σ φ_i (θ_i − θ_prior)`.
//!
//! The base is the interpolation at λ, or the option `base`. Outside the simplex the base is the nearest
//! mixture, and what a weight exceeds 1 is added to the φ of its expert: λ = 1.3 is the adversarial expert
//! with φ = 0.3. Property: with φ = 0 on the simplex it is [`crate::Linear`], with the same bits.

use std::collections::BTreeMap;

use sage_core::{generator::Mixture, registry::Entry};
use serde::{Deserialize, Serialize};

use crate::{Error, ExpertSet, Linear, Merger, Range, TensorMerger, TensorRule, TensorSet};

/// Name of the prior as a base.
const PRIOR: &str = "prior";

/// Options of [`VectorExtrapolation`].
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VectorOptions {
    /// Where the vectors begin: `prior`, the name of an expert, or a λ; by default the mixture itself.
    pub base: Option<Base>,
    /// Length of the step along the preference vector of each expert, by name; 0 for others.
    pub phi: BTreeMap<String, f64>,
}

/// Where the vectors begin.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Base {
    /// A mixture at a λ.
    Lambda(f64),
    /// The prior, or an expert.
    Name(String),
}

/// Extrapolation along preference vectors.
#[derive(Clone)]
pub struct VectorExtrapolation(VectorOptions);

impl TensorMerger for VectorExtrapolation {
    fn range(&self) -> Range {
        Range::Affine
    }

    fn prepare(&self, experts: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        let VectorOptions { base, phi } = &self.0;
        let named: Vec<(&str, f64)> = phi.iter().map(|(name, phi)| (&**name, *phi)).collect();
        let base = match base {
            None => Start::Mixture,
            Some(Base::Name(name)) if name == PRIOR => Start::Prior,
            Some(Base::Name(name)) => Start::At(experts.mixture(&[(&**name, 1.0)])?),
            Some(Base::Lambda(lambda)) => {
                let at = experts.between(*lambda)?;
                Range::Affine.check(experts, &at)?;
                Start::At(at)
            }
        };
        Ok(Box::new(Steps { base, phi: experts.mixture(&named)?.weights().to_vec() }))
    }
}

enum Start {
    /// The mixture that the rule gets.
    Mixture,
    Prior,
    At(Mixture),
}

struct Steps {
    base: Start,
    phi: Vec<f64>,
}

impl TensorRule for Steps {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        let (nearest, excess) = nearest_on_simplex(at);
        let phi: Vec<f64> = self.phi.iter().zip(&excess).map(|(phi, excess)| phi + excess).collect();
        match &self.base {
            Start::Prior => out.copy_from_slice(tensor.prior),
            Start::Mixture => Linear.merge(tensor, &nearest, out),
            Start::At(base) => Linear.merge(tensor, base.weights(), out),
        }
        if phi.iter().all(|phi| *phi == 0.0) {
            return;
        }
        for (k, out) in out.iter_mut().enumerate() {
            let prior = f64::from(tensor.prior[k]);
            let vectors = tensor.experts.iter().map(|expert| f64::from(expert[k]) - prior);
            let step: f64 = vectors.zip(&phi).map(|(vector, phi)| phi * vector).sum();
            *out = (f64::from(*out) + step) as f32;
        }
    }
}

/// Weights within 0 to 1 that sum to 1, and by how much each weight exceeds 1.
fn nearest_on_simplex(at: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let excess: Vec<f64> = at.iter().map(|weight| (weight - 1.0).max(0.0)).collect();
    if at.iter().all(|weight| (0.0..=1.0).contains(weight)) {
        return (at.to_vec(), excess);
    }
    let clamped: Vec<f64> = at.iter().map(|weight| weight.clamp(0.0, 1.0)).collect();
    let sum: f64 = clamped.iter().sum();
    (clamped.iter().map(|weight| weight / sum).collect(), excess)
}

impl Entry<dyn Merger> for VectorExtrapolation {
    const NAME: &'static str = "vector-extrapolation";
    const SUMMARY: &'static str =
        "a base plus steps phi along the preference vectors; lambda may exceed [0, 1]";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    type Options = VectorOptions;

    fn build(options: VectorOptions) -> Result<Box<dyn Merger>, String> {
        if let Some((name, phi)) = options.phi.iter().find(|(_, phi)| !phi.is_finite()) {
            return Err(format!("`phi` of `{name}` is {phi}; expected a finite number"));
        }
        Ok(Box::new(Self(options)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_beyond_the_simplex_become_steps() {
        let (nearest, excess) = nearest_on_simplex(&[-0.25, 1.25]);
        assert_eq!((nearest, excess), (vec![0.0, 1.0], vec![0.0, 0.25]));
        assert_eq!(nearest_on_simplex(&[0.3, 0.7]), (vec![0.3, 0.7], vec![0.0, 0.0]));
        let (nearest, excess) = nearest_on_simplex(&[-0.5, 0.75, 0.75]);
        assert_eq!((nearest, excess), (vec![0.0, 0.5, 0.5], vec![0.0; 3]));
    }

    #[test]
    fn a_step_is_taken_along_the_vector() {
        let experts = [vec![2.0f32], vec![5.0]];
        let tensor = TensorSet { name: "w", prior: &[1.0], experts: &experts };
        let merged = |base, phi: [f64; 2], at: [f64; 2]| {
            let mut out = [0.0f32];
            Steps { base, phi: phi.to_vec() }.merge(&tensor, &at, &mut out);
            out[0]
        };
        // The vectors are 1 and 4.
        assert_eq!(merged(Start::Mixture, [0.0, 0.5], [0.0, 1.0]), 5.0 + 0.5 * 4.0);
        assert_eq!(merged(Start::Mixture, [0.0, 0.0], [-0.5, 1.5]), 5.0 + 0.5 * 4.0);
        assert_eq!(merged(Start::Prior, [1.0, 1.0], [0.5, 0.5]), 1.0 + 1.0 + 4.0);
        assert_eq!(merged(Start::At(Mixture::between(0.5)), [-1.0, 0.0], [0.0, 1.0]), 3.5 - 1.0);
    }
}
