//! The benchmark engine: a study is data, and everything else follows from its rows.
//!
//! - [`estimate`]: means, shares and differences with intervals; [`table`]: Markdown and CSV.
//! - [`part`], [`operating_point`], [`selection`], [`generators`]: parts by name, as studies and commands give them.

pub mod chart;
pub mod curve;
pub mod ego;
pub mod estimate;
pub mod generators;
pub mod measure;
pub mod operating_point;
pub mod part;
pub mod plan;
pub mod published;
pub mod react;
mod registries;
pub mod report;
pub mod rows;
pub mod runner;
pub mod selection;
pub mod study;
pub mod table;

pub use registries::{MetricRegistries, Registries};
