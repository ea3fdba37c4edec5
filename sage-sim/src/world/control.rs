//! What moves a car in one step.

use sage_core::{
    geometry::{MAX_COORDINATE, Point, sub, wrap_angle},
    motion::{DT, Pose},
};

use crate::vehicle::{Action, Motion};

/// What moves a car in one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Control {
    /// Steering and throttle, through the tyres.
    Drive(Action),
    /// The pose at the end of the step, without physics.
    Pose {
        /// The pose.
        pose: Pose,
        /// Velocity, m/s; `None` for the motion since the last pose.
        velocity: Option<Point>,
    },
    /// The same with its velocity, for a car that follows a plan without error: contacts end its drive as that of a car which is
    /// driven.
    Follow {
        /// The pose.
        pose: Pose,
        /// Velocity, m/s.
        velocity: Point,
    },
}

impl Control {
    /// What is wrong with its numbers; `None` if they are finite and in range.
    pub(super) fn problem(&self) -> Option<String> {
        match *self {
            Self::Drive(Action { steer, throttle }) => (!(steer.is_finite() && throttle.is_finite()))
                .then(|| format!("the action is [{steer}, {throttle}]; expected finite numbers")),
            Self::Follow { pose, velocity } => Self::Pose { pose, velocity: Some(velocity) }.problem(),
            Self::Pose { pose: Pose { position: [x, y], heading }, velocity } => {
                let [vx, vy] = velocity.unwrap_or_default();
                let is_far = |v: &f64| !(v.abs() <= MAX_COORDINATE);
                [x, y, heading, vx, vy].iter().any(is_far).then(|| {
                    format!(
                        "the pose is [{x}, {y}, {heading}], its velocity [{vx}, {vy}]; expected finite numbers"
                    )
                })
            }
        }
    }
}

/// The motion of a car that is set to a pose; without a velocity it has that of the way there in a step.
pub(super) fn posed(start: &Motion, pose: Pose, velocity: Option<Point>) -> Motion {
    let moved = sub(pose.position, start.position);
    Motion {
        position: pose.position,
        heading: pose.heading,
        velocity: velocity.unwrap_or(moved.map(|d| d / DT)),
        yaw_rate: wrap_angle(pose.heading - start.heading) / DT,
    }
}
