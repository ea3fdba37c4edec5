//! MetaDrive and ScenarioNet scenes: what the values of a file mean.

mod added;
mod columns;
mod decode;
mod encode;
mod fields;
mod fresh;
mod lights;
mod removed;
mod retime;
mod summary;
mod tracks;
mod values;

pub(crate) use added::add_standing;
pub use added::{ADDED, added_tracks};
pub use decode::decode;
pub(crate) use decode::{MAX_FRAMES, entries_of_features};
pub(crate) use encode::{annotate, write_changes, write_roles};
pub(crate) use fresh::{PROCEDURAL_DATASET, fresh};
pub(crate) use removed::remove_tracks;
pub(crate) use retime::retimed;
pub(crate) use summary::{complete, update};
pub(crate) use values::{SceneValues, Values};

/// Key of the metadata of a converted scene whose sizes are assumed: what was assumed, as [`crate::repairs::Repair::NoSize`]
/// notes it.
pub(crate) const ASSUMED_SIZES: &str = "sage_assumed_sizes";
