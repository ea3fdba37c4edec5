//! Pictures of scenes as SVG. All commands use this module.
//!
//! They have no text on the road: candidates end in marks, and the legend names them.

mod candidate;
mod legend;
mod map_layer;
mod palette;
mod road_users;
mod scene;
mod svg;
mod tried;
mod viewport;

pub use candidate::drawn_path;
pub use map_layer::lane_width;
pub use scene::{DrawnPath, Picture, draw};
pub use tried::{Outcome, Tried};
