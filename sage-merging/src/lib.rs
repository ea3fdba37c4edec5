//! Merging of experts: from a set of experts to one model at any mixture.
//!
//! - An [`ExpertSet`] is a prior with any number of experts tuned from it, checked for consistency.
//! - A [`Merger`] builds a model from a set at a mixture; [`mergers`] lists those of this crate. Mergers
//!   of weights are written per tensor ([`TensorMerger`]).

mod dare;
mod direct_extrapolation;
mod error;
mod expert_set;
mod geometry;
mod linear;
mod logit;
mod merger;
mod model_stock;
mod output_mixture;
mod per_layer;
mod preference_vector;
mod probability;
mod slerp;
mod task_arithmetic;
mod ties;
mod trajectory;
mod uniform_soup;
mod vector_extrapolation;

pub use dare::{Dare, DareOptions};
pub use direct_extrapolation::{DirectExtrapolation, DirectOptions};
pub use error::Error;
pub use expert_set::{ADVERSARIAL, ExpertFile, ExpertSet, LAWFUL, REALISTIC, TensorSet};
pub use geometry::{Geometry, TensorGeometry};
pub use linear::Linear;
pub use logit::LogitMixing;
pub use merger::{Merger, Range, TensorMerger, TensorRule, merged_weights, mix_numbers};
pub use model_stock::ModelStock;
pub use per_layer::{PerLayer, PerLayerOptions};
pub use preference_vector::PreferenceVector;
pub use probability::ProbabilityMixing;
pub use slerp::{Slerp, SlerpOf, SlerpOptions};
pub use task_arithmetic::Consensus;
pub use ties::{Ties, TiesOptions};
pub use trajectory::{Pairs, TrajectoryMixing, TrajectoryOptions};
pub use uniform_soup::UniformSoup;
pub use vector_extrapolation::{Base, VectorExtrapolation, VectorOptions};

use sage_core::registry::Registry;

/// The mergers of this crate. Add a line here to register a new one.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two mergers have the same name.
pub fn mergers() -> Result<Registry<dyn Merger>, sage_core::Error> {
    Registry::new("merger")
        .with::<Linear>()?
        .with::<PreferenceVector>()?
        .with::<VectorExtrapolation>()?
        .with::<DirectExtrapolation>()?
        .with::<LogitMixing>()?
        .with::<ProbabilityMixing>()?
        .with::<TrajectoryMixing>()?
        .with::<Slerp>()?
        .with::<Ties>()?
        .with::<Dare>()?
        .with::<ModelStock>()?
        .with::<PerLayer>()?
        .with::<UniformSoup>()
}
