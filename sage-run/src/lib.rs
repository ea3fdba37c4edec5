//! Runs over many scenes.
//!
//! [`output`]: folders that one run at a time writes, their records, shards and locks. [`scene_queue`]: scenes one after the other, on
//! all cores, with what went wrong. [`scenes`]: the scenes that a run is given. [`outcome`]: how a run ends, [`Error`]: why it
//! fails. Nothing here knows the arguments of a command.

mod error;
pub mod generate;
pub mod input;
pub mod networks;
pub mod outcome;
pub mod output;
pub mod printing;
pub mod progress;
pub mod scene_queue;
pub mod scenes;
pub mod signals;
pub mod terminal;
pub mod threads;

pub use error::{AnyError, Error, Result, WorkError, causes, io_causes};
pub use outcome::Outcome;
