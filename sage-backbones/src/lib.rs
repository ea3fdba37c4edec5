//! Motion prediction: what a car may do next, learned from recordings.

pub mod backbone;
pub mod candidates;
pub mod densetnt;
mod ego_branch;
mod encoder;
mod error;
pub mod features;
mod labels;
pub mod lane_graph;
pub mod nn;
pub mod parameters;
pub mod prediction;
pub mod query_transformer;
mod smooth_path;
pub mod training;

pub use backbone::{Backbone, backbones};
pub use error::Error;
pub use parameters::Parameters;
