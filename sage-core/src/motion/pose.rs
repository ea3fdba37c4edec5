//! Poses and states of motion.

use crate::geometry::Point;

/// A position and a heading in the plane.
///
/// ```
/// use std::f64::consts::FRAC_PI_2;
///
/// use sage_core::motion::Pose;
///
/// // Facing +y, 2 m forward and 1 m to the left.
/// let [x, y] = Pose::new(10.0, 0.0, FRAC_PI_2).shifted(2.0, 1.0).position;
/// assert!((x - 9.0).abs() < 1e-12 && (y - 2.0).abs() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position, metres.
    pub position: Point,
    /// Heading, radians.
    pub heading: f64,
}

impl Pose {
    /// A pose by its numbers.
    pub fn new(x: f64, y: f64, heading: f64) -> Self {
        Self { position: [x, y], heading }
    }

    /// The pose translated by some metres forward and to the left.
    pub fn shifted(&self, forward: f64, left: f64) -> Self {
        let (s, c) = self.heading.sin_cos();
        let [x, y] = self.position;
        Self { position: [x + forward * c - left * s, y + forward * s + left * c], ..*self }
    }

    /// The pose with the opposite heading.
    pub fn turned(&self) -> Self {
        Self { heading: self.heading + std::f64::consts::PI, ..*self }
    }
}

/// State of a moving car: the pose of its centre, and the centre's speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Centre, metres.
    pub position: Point,
    /// Direction of the body, radians.
    pub heading: f64,
    /// Speed, m/s, ≥ 0.
    pub speed: f64,
}

impl State {
    /// The pose.
    pub fn pose(&self) -> Pose {
        Pose { position: self.position, heading: self.heading }
    }
}
