//! Preference vectors: `θ_prior + (1 − λ) (θ_real − θ_prior) + λ (θ_adv − θ_prior)`.
//!
//! The same line as [`crate::Linear`] seen from the prior, and the form that goes on to more experts
//! and beyond them.

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use crate::Merger;

/// The vector form.
pub struct PreferenceVector;

/// [`PreferenceVector`] has no options.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreferenceVectorOptions {}

impl Merger for PreferenceVector {
    fn name(&self) -> &'static str {
        <Self as Entry<dyn Merger>>::NAME
    }

    fn mix(&self, prior: f32, realistic: f32, adversarial: f32, lambda: f64) -> f32 {
        let [prior, realistic, adversarial] = [prior, realistic, adversarial].map(f64::from);
        (prior + (1.0 - lambda) * (realistic - prior) + lambda * (adversarial - prior)) as f32
    }
}

impl Entry<dyn Merger> for PreferenceVector {
    const NAME: &'static str = "preference-vector";
    const SUMMARY: &'static str = "the prior plus the mixture of what each expert moved";
    const SOURCE: &'static str = "SAGE (ICLR 2026), after task arithmetic (Ilharco et al. 2023)";
    type Options = PreferenceVectorOptions;

    fn build(_: PreferenceVectorOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}
