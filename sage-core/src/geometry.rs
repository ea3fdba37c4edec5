//! Oriented boxes, map segments and the tests between them.
//!
//! All sets are closed: touching counts as meeting.
//!
//! Box tests are our own, which are faster; parry's are their reference. Trees are parry's.

mod aabb;
mod oriented_box;
mod segments;
mod sweep;

pub use aabb::Aabb;
pub use oriented_box::OrientedBox;
pub use segments::{Nearest, Segment, SegmentIndex, Side};
pub use sweep::{SweptBox, boxes_meet_between};
pub(crate) use sweep::{bounds_between, turning_margin};

/// A position or a vector in the plane, metres.
pub type Point = [f64; 2];

/// Largest coordinate accepted, metres. Beyond it a 64-bit float resolves no more than 15 nm, and
/// no projection of the Earth needs more.
pub const MAX_COORDINATE: f64 = 1e8;

/// `a − b`.
#[inline]
pub fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// Scalar product.
#[inline]
pub fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Third component of the cross product: positive if `b` lies counter-clockwise of `a`.
#[inline]
pub fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Euclidean distance.
#[inline]
pub fn distance(a: Point, b: Point) -> f64 {
    norm(sub(a, b))
}

/// Length of a vector. Plain, since coordinates are bounded: `hypot` costs five times as much.
#[inline]
pub fn norm(a: Point) -> f64 {
    dot(a, a).sqrt()
}

/// The angle of the same direction in (−π, π].
///
/// ```
/// use std::f64::consts::PI;
///
/// use sage_core::geometry::wrap_angle;
///
/// // From 170° to −170° is a turn of 20° to the left, not of 340° to the right.
/// let turn = wrap_angle((-170.0_f64).to_radians() - 170.0_f64.to_radians());
/// assert!((turn - 20.0_f64.to_radians()).abs() < 1e-12);
/// assert_eq!(wrap_angle(-PI), PI);
/// ```
#[inline]
pub fn wrap_angle(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    if angle > -PI && angle <= PI {
        return angle;
    }
    let turned = (angle + PI).rem_euclid(TAU) - PI;
    if turned <= -PI { PI } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn wrapping_keeps_the_direction_and_the_half_open_range() {
        for (angle, expected) in [(0.0, 0.0), (PI, PI), (-PI, PI), (1.5 * PI, -0.5 * PI), (7.0 * PI, PI)] {
            assert!((wrap_angle(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }
}
