//! Benchmarks.

pub(crate) mod curve;
mod network_speed;
pub mod prediction;
pub mod speed;
