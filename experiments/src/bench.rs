//! Benchmarks.

pub(crate) mod curve;
mod network_speed;
pub mod open_loop;
pub mod prediction;
pub mod speed;
