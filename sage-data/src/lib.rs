//! Readers and writers of recorded scenes.
//!
//! A MetaDrive or ScenarioNet scene is a Python pickle. Here a pickle is *data*: [`pickle`]
//! interprets its opcodes into a [`pickle::Document`] of plain values and never runs anything.
//! [`metadrive`] turns such a document into a [`sage_core::scene::Scene`] and back; what the scene
//! does not model stays in the document, so that writing loses nothing. Native files are safetensors.
//!
//! ```no_run
//! let recording = sage_data::Recording::read("scene.pkl".as_ref())?;
//! println!("{} tracks", recording.scene.tracks.len());
//! # Ok::<(), sage_data::Error>(())
//! ```

pub mod checks;
mod error;
pub mod folder;
mod format;
pub mod metadrive;
mod native;
pub mod pickle;
pub mod procedural;
mod recording;
pub mod split;

pub use error::Error;
pub use format::Format;
pub use recording::{MAX_FILE, PROVENANCE, Recording, Source};
