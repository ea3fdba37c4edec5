//! Weight interpolation: `(1 − λ) θ_real + λ θ_adv`.

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use crate::Merger;

/// The paper's mixture.
pub struct Linear;

/// [`Linear`] has no options.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinearOptions {}

impl Merger for Linear {
    fn name(&self) -> &'static str {
        <Self as Entry<dyn Merger>>::NAME
    }

    fn mix(&self, _prior: f32, realistic: f32, adversarial: f32, lambda: f64) -> f32 {
        ((1.0 - lambda) * f64::from(realistic) + lambda * f64::from(adversarial)) as f32
    }
}

impl Entry<dyn Merger> for Linear {
    const NAME: &'static str = "linear";
    const SUMMARY: &'static str = "weight interpolation, (1 − λ) realistic + λ adversarial";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    type Options = LinearOptions;

    fn build(_: LinearOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}
