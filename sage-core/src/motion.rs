//! How cars move: planned positions, what follows from them, and two laws of motion.

pub mod bicycle;
pub mod idm;
pub mod kinematics;
mod pose;
pub(crate) mod trajectory;

pub use pose::{Pose, State};
pub use trajectory::{Trajectory, backward_velocity};

/// Duration of a frame, seconds (10 Hz).
pub const DT: f64 = 0.1;
/// Frames of history, *now* included.
pub const HISTORY: usize = 11;
/// The frame that is *now*, whatever a file's `current_time_index` says.
pub const NOW: usize = 10;
/// Planned steps T; step t (1 to T) is frame `NOW + t`.
pub const HORIZON: usize = 80;

pub use crate::geometry::MAX_COORDINATE;
