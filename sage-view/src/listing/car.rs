//! A car of a thumbnail: its path and its box at the end of it.

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, distance},
    motion::NOW,
    scene::Track,
};
use serde::Serialize;

/// Length of the paths that a thumbnail shows, and how far it looks around them, metres.
const SHOWN_PATH: f64 = 25.0;
const AROUND: f64 = 35.0;

/// A car up to the moment of the thumbnail: its path in decimetres as differences, and its box.
#[derive(Serialize)]
pub struct Car {
    length: f64,
    width: f64,
    heading: f64,
    path: Vec<i64>,
}

impl Car {
    /// A car with its box and the path that leads there.
    pub fn new(area: &OrientedBox, path: &[Point]) -> Self {
        Self {
            length: 2.0 * area.half_length,
            width: 2.0 * area.half_width,
            heading: area.axis[1].atan2(area.axis[0]),
            path: decimetres(path),
        }
    }
}

/// The path of a car from *now* to a step.
pub fn path(track: &Track, points: &[Point], step: usize) -> Vec<Point> {
    std::iter::once(track.point(NOW)).chain(points.iter().take(step).copied()).collect()
}

/// The area that a thumbnail of these paths shows.
pub fn shown_area(paths: &[Vec<Point>]) -> Aabb {
    let is_shown = |p: &Point, path: &[Point]| path.last().is_some_and(|end| distance(*p, *end) < SHOWN_PATH);
    let shown = paths.iter().flat_map(|path| path.iter().filter(|p| is_shown(p, path)).copied());
    let area = Aabb::of(shown);
    Aabb { min: area.min.map(|x| x - AROUND), max: area.max.map(|x| x + AROUND) }
}

/// Points in decimetres, each as the difference to the one before.
pub(super) fn decimetres(points: &[Point]) -> Vec<i64> {
    let mut before = [0, 0];
    let differences = |p: &Point| {
        let at = p.map(|x| (10.0 * x).round() as i64);
        let difference = [at[0] - before[0], at[1] - before[1]];
        before = at;
        difference
    };
    points.iter().flat_map(differences).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_differences_in_decimetres() {
        assert_eq!(decimetres(&[[10.0, -2.0], [10.52, -2.0], [10.5, -1.04]]), [100, -20, 5, 0, 0, 10]);
    }
}
