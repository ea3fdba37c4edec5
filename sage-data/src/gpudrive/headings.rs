//! The unit of headings, which no file names.

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
    /// The unit by the values: more than a turn of radians is degrees. Where none is, what agrees with the motion, in the old
    /// dialect; and what its dialect has, if nothing moves.
    pub(super) fn of(objects: &[Of<Object>], dialect: Dialect) -> Self {
        let there = |object: &Object, frame: usize| object.valid.as_ref().is_some_and(|all| all[frame].0);
        let mut off = [0.0; 2];
        for Of(object) in objects {
            let headings = object.heading.as_deref().unwrap_or_default();
            let velocities = object.velocity.as_deref().unwrap_or_default();
            let valid = object.valid.as_ref().map_or(0, Vec::len);
            for (frame, heading) in headings.iter().enumerate().take(valid).filter(|(f, _)| there(object, *f))
            {
                if heading.abs() > std::f64::consts::TAU {
                    return Self::Degrees;
                }
                let Some(Point([vx, vy, _])) = velocities.get(frame) else { continue };
                if vx.hypot(*vy) > 1.0 {
                    let course = vy.atan2(*vx);
                    let turn = |angle: f64| wrap_angle(angle - course).abs();
                    off[0] += turn(*heading);
                    off[1] += turn(heading.to_radians());
                }
            }
        }
        match dialect {
            Dialect::Old if off[0] < off[1] => Self::Radians,
            Dialect::Old => Self::Degrees,
            Dialect::Present => Self::Radians,
        }
    }
}
