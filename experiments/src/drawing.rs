//! Pictures: one module that everything draws with.

mod candidate;
mod legend;
mod map_layer;
mod palette;
mod road_users;
mod scene;
mod svg;
mod viewport;

pub(crate) use candidate::drawn_path;
pub use scene::{DrawnPath, Picture, draw};
