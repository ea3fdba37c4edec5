//! MetaDrive and ScenarioNet scenes: what the values of a file mean.

mod decode;
mod encode;
mod fields;
mod fresh;

pub use decode::decode;
pub(crate) use encode::annotate;
pub use encode::encode;
pub(crate) use fresh::{PROCEDURAL_DATASET, fresh};
