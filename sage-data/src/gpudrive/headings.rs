//! The unit of headings, which no file names.

use std::f64::consts::TAU;

use sage_core::geometry::wrap_angle;

use super::{
    Dialect,
    file::{Object, Point},
    keyed::Of,
};

/// Unit of the headings of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    Radians,
    Degrees,
}

impl Unit {
    /// The unit by dialect and values. In the present dialect it is radians, unless a heading is beyond a turn and degrees agree
    /// better with the motion: Waymo's own headings reach two turns. In the old one it is degrees, unless all are within a turn
    /// and radians agree better.
    pub(super) fn of(objects: &[Of<Object>], dialect: Dialect) -> Self {
        let there = |object: &Object, frame: usize| object.valid.as_ref().is_some_and(|all| all[frame].0);
        let (mut off, mut largest) = ([0.0; 2], 0.0f64);
        for Of(object) in objects {
            let headings = object.heading.as_deref().unwrap_or_default();
            let velocities = object.velocity.as_deref().unwrap_or_default();
            let valid = object.valid.as_ref().map_or(0, Vec::len);
            for (frame, heading) in headings.iter().enumerate().take(valid).filter(|(f, _)| there(object, *f))
            {
                largest = largest.max(heading.abs());
                let Some(Point([vx, vy, _])) = velocities.get(frame) else { continue };
                if vx.hypot(*vy) > 1.0 {
                    let course = vy.atan2(*vx);
                    let turn = |angle: f64| wrap_angle(angle - course).abs();
                    off[0] += turn(*heading);
                    off[1] += turn(heading.to_radians());
                }
            }
        }
        let (is_beyond, [as_radians, as_degrees]) = (largest > TAU, off);
        match dialect {
            Dialect::Present if is_beyond && as_degrees < as_radians => Self::Degrees,
            Dialect::Present => Self::Radians,
            Dialect::Old if !is_beyond && as_radians < as_degrees => Self::Radians,
            Dialect::Old => Self::Degrees,
        }
    }
}
