//! Pictures: one module that everything draws with.

mod legend;
mod map_layer;
mod palette;
mod road_users;
mod scene;
mod svg;
mod view;

pub use scene::{DrawnPath, Picture, draw};
