//! Widths of a lane: its distance to the boundaries of both sides, point by point, as ScenarioNet's converter
//! computes them.
//!
//! The arithmetic is that of numpy on 32-bit floats. The boundary is walked by index from its point nearest to the
//! start of each segment, and always forward, so widths can be far from the true ones.

use super::lanes::{Boundary, LaneFields};
use crate::womd::message_error::{MessageError, Place};

/// Names of the boundaries of both sides.
const SIDES: [&str; 2] = ["left_boundaries", "right_boundaries"];

/// Distances that may still be computed. Without a limit, a record that names one long boundary many times
/// would take long.
pub(super) struct Work(usize);

impl Work {
    /// The limit for a record. Recorded scenes need fewer than 2 distances a byte.
    pub(super) fn of(record: usize) -> Self {
        Self(record.saturating_mul(16).saturating_add(4 << 20))
    }
}

/// Left and right width at each point of a lane, metres; 0 where neither side has a boundary, and that of the
/// other side where one has none. `polyline` gives that of a feature by its id; the lane has a number and a line.
///
/// *Errors*: a boundary whose points the lane does not have, or too many distances.
pub(super) fn widths<'p>(
    polyline: impl Fn(i64) -> Option<&'p [[f32; 3]]>,
    number: usize,
    line: &[[f32; 3]],
    lane: &LaneFields,
    work: &mut Work,
) -> Result<Vec<[f32; 2]>, MessageError> {
    let root = Place::ROOT;
    let place = root.item("map_features", number);
    let place = place.field("lane");
    let mut widths = vec![[0.0; 2]; line.len()];
    for (side, name) in SIDES.into_iter().enumerate() {
        for (k, boundary) in lane.boundaries[side].iter().enumerate() {
            let place = place.item(name, k);
            let own = points_of(boundary, line.len(), &place)?;
            // A boundary that the map does not hold bounds nothing.
            let Some(other) = polyline(boundary.feature) else { continue };
            work.0 = work.0.checked_sub(other.len()).ok_or_else(|| {
                let found = "a boundary of a record that names long boundaries too often";
                let expected = "a scene whose boundaries are near their lanes";
                MessageError::value(boundary.offset, &place, found, expected)
            })?;
            add_segment(&mut widths, side, line, other, own);
        }
    }
    for [left, right] in &mut widths {
        if *left == 0.0 {
            *left = *right;
        }
        if *right == 0.0 {
            *right = *left;
        }
    }
    Ok(widths)
}

/// First and last point of the lane that a boundary names.
fn points_of(boundary: &Boundary, points: usize, place: &Place) -> Result<[usize; 2], MessageError> {
    let index = |k: usize| {
        let found = usize::try_from(boundary.own[k]).ok().filter(|index| *index < points);
        found.ok_or_else(|| {
            let place = place.field(["lane_start_index", "lane_end_index"][k]);
            let expected = format!("the index of one of the lane's {points} points");
            MessageError::value(boundary.offset, &place, boundary.own[k], expected)
        })
    };
    Ok([index(0)?, index(1)?])
}

/// Writes the widths along one segment; later segments overwrite earlier ones.
fn add_segment(
    widths: &mut [[f32; 2]],
    side: usize,
    line: &[[f32; 3]],
    other: &[[f32; 3]],
    [first, last]: [usize; 2],
) {
    if last < first {
        return;
    }
    let start = nearest(line[first], other);
    let count = (start + last - first).min(other.len() - 1) - start;
    for k in 0..=count.min(last - first) {
        widths[first + k][side] = square_distance(line[first + k], other[start + k]).sqrt();
    }
}

/// Index of the first point with the least distance to `from`. Distances are compared after the root, because
/// rounding makes some of them equal.
fn nearest(from: [f32; 3], points: &[[f32; 3]]) -> usize {
    let (mut best, mut least, mut least_square) = (0, f32::INFINITY, f32::INFINITY);
    for (k, point) in points.iter().enumerate() {
        let square = square_distance(from, *point);
        // A root is less only if its square is, so few roots are needed.
        if square < least_square && square.sqrt() < least {
            (best, least, least_square) = (k, square.sqrt(), square);
        }
    }
    best
}

/// Square of the horizontal distance in 32-bit arithmetic, rounded after each operation.
#[inline]
fn square_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    dx * dx + dy * dy
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(y: f32, n: usize) -> Vec<[f32; 3]> {
        (0..n).map(|k| [k as f32, y, 0.0]).collect()
    }

    #[test]
    fn a_segment_walks_the_boundary_by_index() {
        let (lane, other) = (line(0.0, 6), line(2.0, 4));
        let mut widths = [[0.0; 2]; 6];
        add_segment(&mut widths, 0, &lane, &other, [1, 5]);
        // Points 1 to 3 lie beside 1 to 3 of the boundary, which then ends.
        assert_eq!(widths.map(|[left, _]| left), [0.0, 2.0, 2.0, 2.0, 0.0, 0.0]);
    }

    #[test]
    fn of_equally_near_points_the_first_is_taken() {
        assert_eq!(nearest([0.0; 3], &[[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 0.0, 0.0]]), 1);
    }
}
