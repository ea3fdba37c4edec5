//! Motion prediction: what a car may do next, learned from recordings.
//!
//! - [`features::Features`] is what one target sees of a scene, with the goals it could reach.
//! - [`MotionModel`] proposes from it: modes with probabilities, and a path for each; a [`Backbone`] has
//!   parameters beside, and a [`Trainable`] one learns. Those shipped are in [`backbones`]: DenseTNT in our arrangement and in the published one, a query transformer,
//!   and a prior over the lane graph without weights.
//! - [`prediction::predict`] chooses candidates; [`training::pretrain`] learns a prior.
//!
//! Scenes are worked on side by side, each on one thread; `docs/backbones.md` says how to keep candle
//! to that, and what everything here was chosen for.
//!
//! ```
//! use sage_backbones::{backbones, candidates::Selection, prediction::predict};
//! use sage_core::{generator::Observation, scene::SceneIndex, seed::Rng};
//! use sage_data::procedural::{Kind, generate};
//!
//! let scene = generate(Kind::FourWay, 1, 0).ok_or("no scene came of the seed")?;
//! let index = SceneIndex::new(scene.map.clone());
//! let network = backbones()?.build_default("lane-graph")?;
//! let now = Observation::of(&scene, &index)?;
//! let features = network.features(&now, scene.adversary_index()?, None)?;
//! let mut rng = Rng::new(0, &scene.id, "prediction");
//! let six = predict(&*network, features.into(), 6, Selection::Nms { radius: 5.0 }, &mut rng)?;
//! assert_eq!(six.len(), 6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod backbone;
pub mod candidates;
pub mod densetnt;
mod encoder;
pub mod encoding;
mod error;
pub mod features;
pub mod forecast;
pub mod labels;
pub mod lane_graph;
pub mod nn;
pub mod parameters;
pub mod prediction;
pub mod query_transformer;
pub mod smooth_path;
mod steering_branch;
pub mod training;
pub mod weights;

pub use backbone::{Backbone, MotionModel, Trainable};
/// Tensors, for networks of your own: the version that the layers here work with.
pub use candle_core as candle;
pub use error::Error;
pub use parameters::Parameters;

use densetnt::{Cat, DenseTnt};
use lane_graph::LaneGraph;
use query_transformer::QueryTransformer;
use sage_core::registry::Registry;

/// The backbones this crate ships. Add a line here to make a new one known everywhere.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two bear one name.
pub fn backbones() -> Result<Registry<dyn Backbone>, sage_core::Error> {
    Registry::new("backbone")
        .with::<DenseTnt>()?
        .with::<QueryTransformer>()?
        .with::<LaneGraph>()?
        .with::<Cat>()
}
