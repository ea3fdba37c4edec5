//! Speed, acceleration, heading and yaw rate of a trajectory, in two conventions.
//!
//! [`paper`] takes backward differences from the pose at *now* and holds the heading of a standing car.
//! [`release`] is what the published code computes: central differences of the planned points alone and a
//! smoothed heading.

pub mod paper;
pub mod release;

use crate::geometry::Point;

/// Kinematic quantities of a trajectory, one value per step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    /// Speed, m/s, ≥ 0.
    pub speed: Vec<f64>,
    /// Heading, rad: in (−π, π] in `paper`, unwrapped in `release`.
    pub heading: Vec<f64>,
    /// Unit vectors of the headings, for the orientation of boxes.
    pub axis: Vec<Point>,
    /// Yaw rate, rad/s, counter-clockwise positive.
    pub yaw_rate: Vec<f64>,
    /// Change of the speed, m/s², signed.
    pub acceleration: Vec<f64>,
    /// Norm of the acceleration vector, m/s². Empty in `paper`, where no measure uses it.
    pub acceleration_norm: Vec<f64>,
    /// Total rotation from the first step to the last, rad, signed, full turns included.
    pub total_turn: f64,
}
