//! Where something is, and how it moves.

use crate::geometry::Point;

/// A place and a direction in the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position, metres.
    pub position: Point,
    /// Heading, radians.
    pub heading: f64,
}

/// A car that moves: the pose of its centre, and the centre's speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Centre, metres.
    pub position: Point,
    /// Direction of the body, radians.
    pub heading: f64,
    /// Speed, m/s, ≥ 0.
    pub speed: f64,
}
