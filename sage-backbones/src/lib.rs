//! Motion prediction: modes, probabilities and trajectories of one agent for the next 8 s.
//!
//! - [`features::Features`] describes the surroundings of one target agent and the goals it could reach.
//! - A [`MotionModel`] gives modes with probabilities and trajectories of an encoded scene. A [`Backbone`] is a
//!   motion model with parameters and an encoder; a [`Trainable`] backbone also has a training loss. [`backbones`] is the
//!   registry of this crate: DenseTNT in our version and as published, a query transformer, and a lane-graph
//!   prior without weights.
//! - [`prediction::predict`] selects candidates; [`training::pretrain`] trains a prior and
//!   [`training::finetune`] an expert.
//!
//! Scenes run in parallel, each on one thread. `docs/extending.md` says how to limit candle's threads and
//! explains the design of the networks.
//!
//! ```
//! use sage_backbones::{backbones, candidates::Sampling, prediction::predict};
//! use sage_core::{generator::Observation, scene::SceneIndex, seed::Rng};
//! use sage_data::procedural::{Kind, generate};
//!
//! let scene = generate(Kind::FourWay, 1, 0).ok_or("the seed gives no scene")?;
//! let index = SceneIndex::new(scene.map.clone());
//! let network = backbones()?.build_default("lane-graph")?;
//! let now = Observation::of(&scene, &index)?;
//! let features = network.features(&now, scene.adversary_index()?, None)?;
//! let mut rng = Rng::new(0, &scene.id, "prediction");
//! let six = predict(&*network, features.into(), 6, Sampling::Nms { radius: 5.0 }, &mut rng)?;
//! assert_eq!(six.len(), 6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod backbone;
pub mod candidates;
mod definition;
pub mod densetnt;
pub mod device;
pub mod diffusion;
mod encoder;
pub mod encoding;
mod error;
pub mod features;
pub mod forecast;
mod interaction_head;
pub mod labels;
pub mod lane_graph;
pub mod metrics;
pub mod nn;
mod own_encoder;
mod parameter_group;
pub mod parameters;
pub mod prediction;
pub mod query_transformer;
pub mod smooth_path;
pub mod subsampling;
pub mod training;
pub mod weights;

pub use backbone::{Backbone, MotionModel, Trainable};
/// The tensor library, in the version that the layers of this crate use.
pub use candle_core as candle;
/// Ready layers, which take their tensors from [`parameters::Scope::var_builder`].
pub use candle_nn;
pub use error::Error;
pub use own_encoder::OwnEncoder;
pub use parameters::Parameters;

use densetnt::{Cat, DenseTnt};
use diffusion::Diffusion;
use lane_graph::LaneGraph;
use query_transformer::QueryTransformer;
use sage_core::registry::Registry;

/// Registry of this crate's backbones. A new backbone needs one line here.
///
/// *Errors*: [`sage_core::Error::Duplicate`] if two backbones have the same name.
pub fn backbones() -> Result<Registry<dyn Backbone>, sage_core::Error> {
    Registry::new("backbone")
        .with::<DenseTnt>()?
        .with::<QueryTransformer>()?
        .with::<Diffusion>()?
        .with::<LaneGraph>()?
        .with::<Cat>()
}
