//! Merging of experts: from a set of experts to one model at any mixture.
//!
//! - An [`ExpertSet`] is a prior with any number of experts tuned from it, checked for consistency.
//! - A [`Merger`] builds a model from a set at a mixture; [`mergers`] lists those of this crate. Mergers
//!   of weights are written per tensor ([`TensorMerger`]).
//! - An [`InterpolatedModel`] is one network whose weights follow a mixture in place.

mod error;
mod expert_set;
mod interpolated_model;
mod linear;
mod merger;
mod preference_vector;
mod uniform_soup;

pub use error::Error;
pub use expert_set::{ADVERSARIAL, ExpertFile, ExpertSet, REALISTIC, TensorSet};
pub use interpolated_model::InterpolatedModel;
pub use linear::Linear;
pub use merger::{Merger, Range, TensorMerger, TensorRule, merged_weights, mix_numbers};
pub use preference_vector::PreferenceVector;
pub use uniform_soup::UniformSoup;

use sage_core::registry::Registry;

/// The mergers of this crate. Add a line here to register a new one.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two mergers have the same name.
pub fn mergers() -> Result<Registry<dyn Merger>, sage_core::Error> {
    Registry::new("merger").with::<Linear>()?.with::<PreferenceVector>()?.with::<UniformSoup>()
}
