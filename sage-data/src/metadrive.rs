//! MetaDrive and ScenarioNet scenes: what the values of a file mean.

mod decode;
mod encode;
mod fields;

pub use decode::decode;
pub use encode::encode;
