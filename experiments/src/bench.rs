//! Benchmarks.

mod learning_speed;
mod network_speed;
mod simulation_speed;
pub mod speed;
mod timing;

pub(crate) use sage_bench::chart::line as line_chart;
