//! From two experts to one network, at any point between them.
//!
//! - [`Experts`] are a realistic and an adversarial expert tuned from one prior, checked to fit.
//! - [`Merger`] mixes their weights at a λ; those shipped are in [`mergers`].
//! - [`Dial`] holds one network whose weights follow λ in place.

mod dial;
mod experts;
mod linear;
mod preference_vector;

use sage_backbones::{Error, Parameters};
use sage_core::registry::Registry;

pub use dial::Dial;
pub use experts::{ExpertFile, Experts};
pub use linear::Linear;
pub use preference_vector::PreferenceVector;

/// Mixes the weights of two experts.
///
/// Laws: at λ = 0 and λ = 1 the experts' own tensors, bit for bit; a tensor that both share is left as
/// it is; the result is continuous in λ.
pub trait Merger: Send + Sync {
    /// Name in the registry.
    fn name(&self) -> &'static str;

    /// One number of the mixture from the same number of the prior and of both experts.
    fn mix(&self, prior: f32, realistic: f32, adversarial: f32, lambda: f64) -> f32;

    /// All weights at λ in [0, 1]: 0 is the realistic expert, 1 the adversarial one.
    ///
    /// *Errors*: λ outside of that.
    fn merge(&self, experts: &Experts, lambda: f64) -> Result<Parameters, Error> {
        experts.merged(lambda, |prior, a, b| self.mix(prior, a, b, lambda))
    }
}

/// The mergers this crate ships.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two bear one name.
pub fn mergers() -> Result<Registry<dyn Merger>, sage_core::Error> {
    Registry::new("merger").with::<Linear>()?.with::<PreferenceVector>()
}

/// Refuses a λ that is not between the experts.
pub(crate) fn check(lambda: f64) -> Result<(), Error> {
    if (0.0..=1.0).contains(&lambda) {
        Ok(())
    } else {
        Err(Error::Training(format!(
            "lambda is {lambda}; expected 0 (realistic) to 1 (adversarial): going beyond the experts comes later"
        )))
    }
}
