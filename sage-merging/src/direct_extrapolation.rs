//! Direct extrapolation: the line through the experts, also outside them, `(1 − λ − φ) θ_real + (λ + φ) θ_adv`.
//!
//! Properties: on the simplex with φ = 0 it is [`crate::Linear`], with the same bits. It is vector
//! extrapolation from λ = 1 with the steps `φ` and `−φ`.

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use crate::{
    ADVERSARIAL, Error, ExpertSet, Linear, Merger, REALISTIC, Range, TensorMerger, TensorRule, TensorSet,
};

/// Options of [`DirectExtrapolation`].
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DirectOptions {
    /// Added to the weight of the adversarial expert and taken from that of the realistic one.
    pub phi: f64,
}

/// Extrapolation along the line through the experts.
#[derive(Clone, Copy)]
pub struct DirectExtrapolation(DirectOptions);

impl TensorMerger for DirectExtrapolation {
    fn range(&self) -> Range {
        Range::Affine
    }

    fn prepare(&self, experts: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, Error> {
        let mut shift = vec![0.0; experts.names().len()];
        if self.0.phi != 0.0 {
            let at = experts.mixture(&[(REALISTIC, -self.0.phi), (ADVERSARIAL, self.0.phi)])?;
            shift.copy_from_slice(at.weights());
        }
        Ok(Box::new(Shifted(shift)))
    }
}

/// The change of each weight.
struct Shifted(Vec<f64>);

impl TensorRule for Shifted {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        let at: Vec<f64> = at.iter().zip(&self.0).map(|(weight, shift)| weight + shift).collect();
        Linear.merge(tensor, &at, out);
    }
}

impl Entry<dyn Merger> for DirectExtrapolation {
    const NAME: &'static str = "direct-extrapolation";
    const SUMMARY: &'static str = "the line through the experts, also beyond them; phi is added to lambda";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    type Options = DirectOptions;

    fn build(options: DirectOptions) -> Result<Box<dyn Merger>, String> {
        if !options.phi.is_finite() {
            return Err(format!("`phi` is {}; expected a finite number", options.phi));
        }
        Ok(Box::new(Self(options)))
    }
}
