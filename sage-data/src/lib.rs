//! Readers and writers of recorded scenes.
//!
//! A MetaDrive or ScenarioNet scene is a Python pickle. This crate treats a pickle as *data*: [`pickle`]
//! interprets its opcodes into a [`pickle::Document`] of plain values and never executes anything.
//! [`metadrive`] converts such a document into a [`sage_core::scene::Scene`] and back. Content that the
//! scene does not model stays in the document, so that writing loses nothing. Native files are safetensors.
//! [`womd`] reads the files of the Waymo Open Motion Dataset into such documents.
//!
//! - Reading: [`Recording`] is a scene with its document; `reading` holds the options, `repairs` what is mended or left out, and
//!   `contradictions` and [`checks`] what is warned about. [`stream`] reads many, [`folder`] lists them, `foreign` names files of
//!   other formats.
//! - Writing: [`VariantWriter`] adversarial scenes, [`dataset`] the tables of a data set, [`openscenario`] and [`opendrive`] scenarios
//!   and maps.
//! - [`procedural`] generates scenes; [`split`] chooses some of a list.
//!
//! From a file to the scores of what its adversary really did:
//!
//! ```
//! use std::{path::Path, sync::Arc};
//!
//! use sage_core::{
//!     motion::{NOW, Trajectory},
//!     objective::{Context, ContextOptions, Scorer},
//!     scene::SceneIndex,
//! };
//! use sage_data::Recording;
//!
//! # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
//! let scene = Arc::new(Recording::read(file)?.scene);
//! let index = SceneIndex::new(scene.map.clone());
//! let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
//!
//! let log = (1..=80).map(|step| ctx.adversary().point(NOW + step)).collect();
//! let scores = Scorer::new(&ctx).scores(&ctx.candidate(Trajectory::new("log", log)?));
//! assert!(scores.feasible && scores.collision == Some(false));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "argoverse2")]
mod argoverse2;
mod capabilities;
pub mod checks;
mod contradictions;
pub mod dataset;
mod error;
mod float_rows;
pub mod folder;
mod foreign;
mod format;
mod gpudrive;
mod gzip;
mod headings;
mod json;
mod lane_links;
mod lane_polygon;
mod map_in_order;
mod map_limits;
pub mod metadrive;
mod names;
mod native;
pub mod opendrive;
pub mod openscenario;
mod parquet_files;
pub mod pickle;
pub mod procedural;
mod reading;
mod recording;
pub mod repairs;
pub mod split;
pub mod stream;
mod variants;
mod warning;
pub mod womd;
mod xml;

pub use capabilities::Capabilities;
pub use error::Error;
pub use format::Format;
pub use gpudrive::EncodedGpuDrive;
pub use metadrive::{ADDED, added_tracks};
pub use reading::ReadOptions;
pub use recording::{MAX_SCENE_FILE, Recording, Source, is_source, read_bytes};
pub use sage_core::scene::PROVENANCE;
pub use variants::{Variant, VariantWriter};
pub use warning::Warning;
