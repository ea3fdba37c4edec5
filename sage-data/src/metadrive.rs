//! MetaDrive and ScenarioNet scenes: what the values of a file mean.

mod decode;
mod encode;
mod fields;
mod fresh;
mod summary;

pub(crate) use decode::MAX_FRAMES;
pub use decode::decode;
pub use encode::encode;
pub(crate) use encode::{annotate, write_changes};
pub(crate) use fresh::{PROCEDURAL_DATASET, fresh};
pub(crate) use summary::{complete, update};
