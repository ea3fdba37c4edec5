//! Benchmarks.

pub(crate) mod curve;
pub(crate) mod dial_chart;
pub(crate) mod gallery;
mod network_speed;
pub mod open_loop;
pub mod open_loop_report;
pub mod prediction;
pub mod speed;
pub mod steering;
