//! The target's frame.

use sage_core::geometry::Point;

/// Origin and direction of a local frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    origin: Point,
    heading: f64,
    cos: f64,
    sin: f64,
}

impl Frame {
    /// The frame at an origin, with x along a heading.
    pub fn new(origin: Point, heading: f64) -> Self {
        let (sin, cos) = heading.sin_cos();
        Self { origin, heading, cos, sin }
    }

    /// Its origin in the world.
    pub fn origin(&self) -> Point {
        self.origin
    }

    /// Direction of its x axis in the world, radians.
    pub fn heading(&self) -> f64 {
        self.heading
    }

    /// A position of the world in this frame.
    #[inline]
    pub fn frame_from_world(&self, p: Point) -> Point {
        self.direction_from_world([p[0] - self.origin[0], p[1] - self.origin[1]])
    }

    /// A direction of the world in this frame.
    #[inline]
    pub fn direction_from_world(&self, v: Point) -> Point {
        [self.cos * v[0] + self.sin * v[1], self.cos * v[1] - self.sin * v[0]]
    }

    /// A position of this frame in the world.
    #[inline]
    pub fn world_from_frame(&self, p: Point) -> Point {
        [
            self.origin[0] + self.cos * p[0] - self.sin * p[1],
            self.origin[1] + self.sin * p[0] + self.cos * p[1],
        ]
    }
}
