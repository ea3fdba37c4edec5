//! The benchmark engine: a study is data, and everything else follows from its rows.
//!
//! - [`study`]: what a file says. [`plan`]: a study with all its parts, checked before a scene is read.
//! - [`measure`]: what is measured in a scene, one file per kind of measurement. [`runner`]: all scenes, in parallel, resuming.
//! - [`rows`]: the results. [`estimate`]: means, shares and differences with intervals. [`curve`]: quantities of curves over λ.
//! - [`report`]: tables, charts and files from rows alone. [`chart`]: pictures. [`table`]: Markdown and CSV. [`published`]: numbers of
//!   the paper.
//! - What users name, as studies, commands and programs give it: [`part`], [`operating_point`], [`selection`], [`weights`],
//!   [`generators`] and [`named_generator`], [`ego`] and [`references`], [`latest_start`], [`search`] and [`named_search`].

pub mod chart;
pub mod curve;
pub mod driver_search;
pub mod ego;
mod error;
pub mod estimate;
pub mod generators;
pub mod latest_start;
mod learned_criticality;
pub mod measure;
pub mod named_generator;
pub mod named_search;
pub mod operating_point;
pub mod part;
pub mod plan;
pub mod published;
pub mod references;
mod registries;
pub mod report;
pub mod rows;
pub mod runner;
pub mod search;
pub mod searched_attacker;
pub mod selection;
pub mod study;
pub mod table;
pub mod weights;
pub mod wrap;

pub use error::Error;
pub use learned_criticality::{LearnedCriticality, LearnedCriticalityOptions};
pub use registries::{MetricRegistries, Registries};
