//! Motion of cars: trajectories, quantities derived from them, and two motion models.

pub mod bicycle;
pub mod idm;
pub mod kinematics;
mod path_limits;
mod pose;
pub(crate) mod trajectory;

pub use path_limits::{MAX_PATH, MAX_STEP, PathTooLong, check_path};
pub use pose::{Pose, State};
pub use trajectory::{Trajectory, backward_velocity};

/// Duration of a frame, seconds (10 Hz).
pub const DT: f64 = 0.1;
/// Frames of history, *now* included.
pub const HISTORY: usize = 11;
/// The frame *now*, regardless of a file's `current_time_index`.
pub const NOW: usize = 10;
/// Planned steps T; step t (1 to T) is frame `NOW + t`.
pub const HORIZON: usize = 80;
/// Least horizon of a scene that can be attacked: 1 s after *now*.
pub const LEAST_HORIZON: usize = 10;

pub use crate::geometry::MAX_COORDINATE;
