//! The benchmark engine: a study is data, and everything else follows from its rows.
//!
//! - [`study`]: what a file says. [`prepared_study`]: a study with all its parts, checked before a scene is read.
//! - [`measure`]: what is measured in a scene, one file per kind of measurement. [`runner`]: all scenes, in parallel, resuming.
//! - [`rows`]: the results. [`estimate`]: means, shares and differences with intervals. [`curve`]: quantities of curves over λ.
//! - [`report`]: tables, charts and files from rows alone. [`chart`]: pictures. [`csv_text`]: CSV. [`published`]: numbers of
//!   the paper.
//! - What users name becomes a part in [`advsage`]; errors are those of that crate.

pub mod chart;
mod context;
pub mod csv_text;
pub mod curve;
pub mod estimate;
pub mod measure;
pub mod prepared_study;
pub mod published;
mod registries;
pub mod report;
pub mod rows;
pub mod runner;
pub mod study;

pub use advsage::{Error, Result, in_one_line};
pub use registries::{MetricRegistries, Registries};
