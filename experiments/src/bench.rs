//! Benchmarks.

pub(crate) mod connectivity;
pub(crate) mod connectivity_report;
pub(crate) mod curve;
pub(crate) mod expert_path;
mod learning_speed;
mod network_speed;
pub(crate) mod principal_components;
mod simulation_speed;
pub mod speed;
mod timing;
pub(crate) mod weight_and_output;

pub(crate) use sage_bench::chart::{bar as bar_chart, heat_map, line as line_chart};
