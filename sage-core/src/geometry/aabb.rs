//! Axis-aligned bounds: the cheap first test before any exact one.

use super::{Point, dot};

/// Axis-aligned rectangle, closed. [`Aabb::EMPTY`] meets nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Least coordinates, metres.
    pub min: Point,
    /// Greatest coordinates, metres.
    pub max: Point,
}

impl Aabb {
    /// The bounds of no point at all.
    pub const EMPTY: Self = Self { min: [f64::INFINITY; 2], max: [f64::NEG_INFINITY; 2] };

    /// Bounds of a square of half side `reach` around a point.
    #[inline]
    pub fn around(center: Point, reach: f64) -> Self {
        Self { min: [center[0] - reach, center[1] - reach], max: [center[0] + reach, center[1] + reach] }
    }

    /// Bounds of points.
    pub fn of(points: impl IntoIterator<Item = Point>) -> Self {
        points.into_iter().fold(Self::EMPTY, |bounds, p| bounds.union(&Self { min: p, max: p }))
    }

    /// The least bounds that hold both.
    #[inline]
    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: [self.min[0].min(other.min[0]), self.min[1].min(other.min[1])],
            max: [self.max[0].max(other.max[0]), self.max[1].max(other.max[1])],
        }
    }

    /// The bounds with a margin on every side.
    #[inline]
    pub fn grown(&self, margin: f64) -> Self {
        Self { min: self.min.map(|x| x - margin), max: self.max.map(|x| x + margin) }
    }

    /// Whether there is no point in it.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.min[0] > self.max[0]
    }

    /// Whether the closed rectangles share a point.
    #[inline]
    pub fn meets(&self, other: &Self) -> bool {
        self.min[0] <= other.max[0]
            && other.min[0] <= self.max[0]
            && self.min[1] <= other.max[1]
            && other.min[1] <= self.max[1]
    }

    /// Squared distance of a point, m²; 0 inside.
    #[inline]
    pub fn squared_distance(&self, p: Point) -> f64 {
        let out = |axis: usize| (self.min[axis] - p[axis]).max(p[axis] - self.max[axis]).max(0.0);
        let d = [out(0), out(1)];
        dot(d, d)
    }

    pub(super) fn to_parry(self) -> parry2d_f64::bounding_volume::Aabb {
        use parry2d_f64::math::Vector;
        parry2d_f64::bounding_volume::Aabb::new(
            Vector::new(self.min[0], self.min[1]),
            Vector::new(self.max[0], self.max[1]),
        )
    }
}
