//! The centre line of a lane: its points in the plane of the map, with heights and headings.

use sage_core::geometry::{Point, cross, distance, dot, norm, sub, wrap_angle};

use super::simplify;
use crate::xml::rounded;

/// Smallest distance between two points of a line, metres.
const SPACING: f64 = 1e-3;
/// Largest distance of a removed point from the line of the others, and from the curve, metres.
pub(super) const TOLERANCE: f64 = 0.03;
/// Decimals of a coordinate.
pub(super) const COORDINATE: usize = 6;

/// A line of at least one point. Consecutive points are at least a millimetre apart in the plane.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CenterLine {
    /// Points relative to the origin of the map, metres, as the file writes them.
    pub(super) points: Vec<[f64; 3]>,
    /// Heading at each point, radians.
    pub(super) headings: Vec<f64>,
}

impl CenterLine {
    /// The line through recorded points, relative to an origin; `None` if there is no point.
    pub(super) fn new(recorded: &[[f64; 3]], origin: [f64; 3]) -> Option<Self> {
        let mut points: Vec<[f64; 3]> = Vec::with_capacity(recorded.len());
        for point in recorded {
            let point = [0, 1, 2].map(|axis| rounded(point[axis] - origin[axis], COORDINATE));
            if points.last().is_none_or(|last| distance(plane(*last), plane(point)) >= SPACING) {
                points.push(point);
            }
        }
        let headings = tangents(&points);
        (!points.is_empty()).then_some(Self { points, headings })
    }

    /// Length of the polyline in the plane, metres.
    pub(super) fn length(&self) -> f64 {
        self.points.windows(2).map(|pair| distance(plane(pair[0]), plane(pair[1]))).sum()
    }

    /// First point in the plane.
    pub(super) fn first(&self) -> Point {
        plane(self.points[0])
    }

    /// Last point in the plane.
    pub(super) fn last(&self) -> Point {
        plane(self.points[self.points.len() - 1])
    }

    /// The line that starts at the end of the line before it. Points that would lead back to there, or turn
    /// sharply because they are too near, are removed. `None` if no point remains ahead.
    pub(super) fn starting_at_end_of(&self, before: &Self) -> Option<Self> {
        let start = *before.points.last()?;
        let gap = distance(plane(start), self.first());
        let room = 2.0 * gap;
        let is_ahead = |k: usize| {
            let direction = match self.points.get(k + 1) {
                Some(next) => sub(plane(*next), plane(self.points[k])),
                None => sub(plane(self.points[k]), plane(self.points[k - 1])),
            };
            let ahead = sub(plane(self.points[k]), plane(start));
            norm(ahead) >= SPACING && dot(ahead, direction) >= room * norm(direction)
        };
        let next = (1..self.points.len()).find(|k| is_ahead(*k))?;
        let mut points = vec![start];
        points.extend(&self.points[next..]);
        let headings = tangents(&points);
        Some(Self { points, headings })
    }

    /// Gives the end of `before` and the start of `after`, which are one point, the same heading.
    pub(super) fn align_joint(before: &mut Self, after: &mut Self) {
        let (Some(&from), Some(&to)) = (before.points.iter().nth_back(1), after.points.get(1)) else {
            return;
        };
        let across = sub(plane(to), plane(from));
        let end = before.headings.len() - 1;
        // Without a direction across, the line turns back on itself.
        if norm(across) >= SPACING {
            before.headings[end] = across[1].atan2(across[0]);
        }
        after.headings[0] = before.headings[end];
    }

    /// The line without its first `cut` metres, which are fewer than its length.
    pub(super) fn without_start(&self, cut: f64) -> Self {
        let mut before = 0.0;
        for (k, pair) in self.points.windows(2).enumerate() {
            let step = distance(plane(pair[0]), plane(pair[1]));
            if before + step > cut {
                let share = (cut - before) / step;
                let point = [0, 1, 2]
                    .map(|axis| rounded(pair[0][axis] + share * (pair[1][axis] - pair[0][axis]), COORDINATE));
                let turn = wrap_angle(self.headings[k + 1] - self.headings[k]);
                let heading = self.headings[k] + share * turn;
                // The last point always stays: a piece of a millimetre would have no heading.
                let is_near = distance(plane(point), plane(pair[1])) < SPACING;
                let next = if is_near && k + 2 < self.points.len() { k + 2 } else { k + 1 };
                let mut line = Self { points: vec![point], headings: vec![heading] };
                line.points.extend(&self.points[next..]);
                line.headings.extend(&self.headings[next..]);
                return line;
            }
            before += step;
        }
        self.clone()
    }

    /// The straight connection from the end of one line to the start of another, with their headings.
    pub(super) fn connecting(from: &Self, to: &Self) -> Self {
        let (end, heading) = (from.points[from.points.len() - 1], from.headings[from.headings.len() - 1]);
        Self { points: vec![end, to.points[0]], headings: vec![heading, to.headings[0]] }
    }

    /// Distance from a point to the start of this line, along the line's heading there.
    pub(super) fn start_ahead_of(&self, point: Point) -> f64 {
        let heading = self.headings[0];
        dot(sub(self.first(), point), [heading.cos(), heading.sin()])
    }

    /// Indices of the points that describe the line within 3 cm.
    pub(super) fn kept(&self) -> Vec<usize> {
        simplify::kept(self.points.len(), TOLERANCE, |a, b, k| {
            let [a, b, k] = [a, b, k].map(|index| plane(self.points[index]));
            let (chord, to) = (sub(b, a), sub(k, a));
            let length = norm(chord);
            if length > 0.0 { cross(chord, to).abs() / length } else { norm(to) }
        })
    }
}

/// A point without its height.
pub(super) fn plane([x, y, _]: [f64; 3]) -> Point {
    [x, y]
}

/// Heading at each point. Inside, it is that of the circle through three points: each side's direction,
/// weighted by the length of the other side.
fn tangents(points: &[[f64; 3]]) -> Vec<f64> {
    let mut headings = Vec::with_capacity(points.len());
    let mut before: Option<(f64, f64)> = None;
    for pair in points.windows(2) {
        let step = sub(plane(pair[1]), plane(pair[0]));
        let (heading, length) = (step[1].atan2(step[0]), norm(step));
        headings.push(match before {
            None => heading,
            Some((last, last_length)) => {
                last + wrap_angle(heading - last) * last_length / (last_length + length)
            }
        });
        before = Some((heading, length));
    }
    headings.extend(before.map(|(heading, _)| heading));
    if headings.is_empty() && !points.is_empty() {
        headings.push(0.0);
    }
    headings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: &[[f64; 2]]) -> CenterLine {
        let points: Vec<[f64; 3]> = points.iter().map(|[x, y]| [*x, *y, 1.0]).collect();
        CenterLine::new(&points, [0.0, 0.0, 1.0]).unwrap()
    }

    #[test]
    fn headings_on_a_circle_are_its_tangents() {
        // Steps of 0.1 and 0.3 rad: the tangent at each inner point is its angle and a right angle.
        let angles = [0.0, 0.1, 0.4, 0.5, 0.8f64];
        let circle = line(&angles.map(|a| [10.0 * a.cos(), 10.0 * a.sin()]));
        for (angle, heading) in angles.iter().zip(&circle.headings).take(4).skip(1) {
            let tangent = angle + std::f64::consts::FRAC_PI_2;
            assert!((heading - tangent).abs() < 1e-3, "{heading} {tangent}");
        }
    }

    #[test]
    fn a_cut_line_starts_where_the_cut_ends() {
        let whole = line(&[[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]]);
        assert_eq!(whole.without_start(2.0).points, [[2.0, 0.0, 0.0], [4.0, 0.0, 0.0]]);
        // A point half a millimetre behind the cut is left out, but not the last one.
        assert_eq!(whole.without_start(0.9995).points, [[0.9995, 0.0, 0.0], [4.0, 0.0, 0.0]]);
        assert_eq!(whole.without_start(3.9995).points, [[3.9995, 0.0, 0.0], [4.0, 0.0, 0.0]]);
    }

    #[test]
    fn a_line_that_starts_too_early_loses_the_points_that_lead_back() {
        let before = line(&[[-5.0, 0.0], [0.0, 0.0]]);
        let after = line(&[[-0.3, 0.1], [-0.1, 0.1], [0.2, 0.1], [0.7, 0.1], [3.0, 0.1]]);
        let joined = after.starting_at_end_of(&before).unwrap();
        assert_eq!(joined.points, [[0.0, 0.0, 0.0], [0.7, 0.1, 0.0], [3.0, 0.1, 0.0]]);
        let behind = line(&[[-0.3, 0.0], [-0.1, 0.0]]);
        assert_eq!(behind.starting_at_end_of(&before), None);
        let touching = line(&[[0.0, 0.0], [0.01, 0.0], [3.0, 0.0]]);
        assert_eq!(touching.starting_at_end_of(&before).unwrap().points.len(), 3);
    }
}
