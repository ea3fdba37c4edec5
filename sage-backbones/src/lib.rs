//! Motion prediction: what a car may do next, learned from recordings.

pub mod backbone;
pub mod candidates;
pub mod densetnt;
mod error;
pub mod features;
mod labels;
pub mod nn;
pub mod parameters;
pub mod prediction;
pub mod training;

pub use backbone::{Backbone, backbones};
pub use error::Error;
pub use parameters::Parameters;
