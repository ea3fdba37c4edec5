//! Benchmarks.

pub(crate) mod attack_grid;
pub(crate) mod bar_chart;
pub(crate) mod closed_loop;
pub(crate) mod closed_loop_report;
pub(crate) mod connectivity;
pub(crate) mod connectivity_report;
pub(crate) mod curve;
pub(crate) mod expert_path;
pub(crate) mod front;
pub(crate) mod gallery;
pub(crate) mod heat_map;
pub(crate) mod line_chart;
mod network_speed;
pub(crate) mod open_loop;
pub(crate) mod open_loop_report;
mod pairs;
pub(crate) mod pareto;
pub(crate) mod prediction;
pub(crate) mod principal_components;
mod simulation_speed;
pub mod speed;
pub(crate) mod tested_drivers;
pub(crate) mod tested_drivers_report;
mod timing;
pub(crate) mod triangle;
pub(crate) mod weight_and_output;
