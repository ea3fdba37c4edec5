//! Road edges from the drivable areas of a map.
//!
//! An edge is the outline of the union of all areas, which overlap, wound such that the road lies on its left. Maps are crops:
//! at the crop an outline closes across the lanes, where nothing is known. So what lies within 0.1 m of a motor lane is no
//! edge.

use i_overlay::{
    core::{fill_rule::FillRule, overlay_rule::OverlayRule},
    float::single::SingleFloatOverlay,
};
use sage_core::geometry::{Point, distance};

/// How near to a motor lane an outline is no edge, metres.
const NEAR: f64 = 0.1;
/// Shortest edge that is kept, metres.
const SHORTEST: f64 = 0.5;
/// Most pairs of a side of an outline and a side of a lane in whose surroundings it is: about two seconds of work.
const MOST_PAIRS: usize = 50_000_000;

/// The edges of a map: polylines with the road on their left. `None` if there are more than [`MOST_PAIRS`].
pub(super) fn edges(areas: &[Vec<Point>], motor_lanes: &[Vec<Point>]) -> Option<Vec<Vec<Point>>> {
    let areas: Vec<Vec<Point>> =
        areas.iter().filter(|area| area.len() > 2).map(|area| counterclockwise(area)).collect();
    // Outer outlines are counterclockwise and those of holes clockwise: the road is on the left of both.
    let shapes = areas.overlay(&Vec::<Vec<Point>>::new(), OverlayRule::Subject, FillRule::NonZero);
    let lanes: Vec<Lane> = motor_lanes.iter().filter(|lane| lane.len() > 2).map(Lane::new).collect();
    let (mut edges, mut pairs) = (Vec::new(), 0);
    for outline in shapes.into_iter().flatten() {
        edges.extend(outside(&outline, &lanes, &mut pairs)?);
    }
    edges.retain(|edge| edge.windows(2).map(|w| distance(w[0], w[1])).sum::<f64>() >= SHORTEST);
    Some(edges)
}

/// Whether sides of some outlines cross each other more often than a number.
pub(super) fn crosses_more_than(areas: &[Vec<Point>], most: usize) -> bool {
    let next = |area: &[Point]| area.iter().copied().cycle().skip(1).take(area.len()).collect::<Vec<_>>();
    let mut sides: Vec<[Point; 2]> =
        areas.iter().flat_map(|area| area.iter().copied().zip(next(area))).map(|(a, b)| [a, b]).collect();
    let least = |side: &[Point; 2], axis: usize| side[0][axis].min(side[1][axis]);
    let largest = |side: &[Point; 2], axis: usize| side[0][axis].max(side[1][axis]);
    sides.sort_by(|a, b| least(a, 0).total_cmp(&least(b, 0)));
    let mut count = 0;
    for (k, side) in sides.iter().enumerate() {
        let beside = sides[k + 1..].iter().take_while(|other| least(other, 0) <= largest(side, 0));
        let meets = |other: &&[Point; 2]| {
            least(other, 1) <= largest(side, 1)
                && largest(other, 1) >= least(side, 1)
                && crossing(*side, **other).is_some()
                && crossing(**other, *side).is_some()
        };
        count += beside.filter(meets).count();
        if count > most {
            return true;
        }
    }
    false
}

fn signed_area(ring: &[Point]) -> f64 {
    let next = ring.iter().cycle().skip(1);
    0.5 * ring.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum::<f64>()
}

fn counterclockwise(ring: &[Point]) -> Vec<Point> {
    let mut ring = ring.to_vec();
    if signed_area(&ring) < 0.0 {
        ring.reverse();
    }
    ring
}

/// The area of a lane.
struct Lane<'l> {
    ring: &'l Vec<Point>,
    least: Point,
    most: Point,
}

impl<'l> Lane<'l> {
    fn new(ring: &'l Vec<Point>) -> Self {
        let bound =
            |axis: usize, fold: fn(f64, f64) -> f64| ring.iter().map(|p| p[axis]).reduce(fold).unwrap_or(0.0);
        let least = [0, 1].map(|axis| bound(axis, f64::min) - NEAR);
        Self { ring, least, most: [0, 1].map(|axis| bound(axis, f64::max) + NEAR) }
    }

    fn may_meet(&self, [a, b]: [Point; 2]) -> bool {
        (0..2).all(|axis| a[axis].min(b[axis]) <= self.most[axis] && a[axis].max(b[axis]) >= self.least[axis])
    }

    fn sides(&self) -> impl Iterator<Item = [Point; 2]> {
        let next = self.ring.iter().cycle().skip(1);
        self.ring.iter().zip(next).map(|(a, b)| [*a, *b])
    }

    fn holds(&self, p: Point) -> bool {
        let crosses = |[a, b]: &[Point; 2]| {
            (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        };
        self.sides().filter(crosses).count() % 2 == 1
    }

    /// The parts of a line that meets the surroundings, as shares of its length, that lie in the lane or within [`NEAR`] of it.
    fn covers(&self, line: [Point; 2], parts: &mut Vec<[f64; 2]>) {
        let mut cuts = Vec::new();
        for side in self.sides() {
            parts.extend(near(line, side));
            if is_left(line, side[0]) != is_left(line, side[1]) {
                cuts.extend(crossing(line, side));
            }
        }
        cuts.sort_by(f64::total_cmp);
        // At each crossing the line goes into the lane or out of it.
        let mut from = 0.0;
        let mut is_inside = self.holds(at(line, 0.5 * cuts.first().copied().unwrap_or(1.0)));
        for to in cuts.into_iter().chain([1.0]) {
            parts.extend(is_inside.then_some([from, to]));
            (from, is_inside) = (to, !is_inside);
        }
    }
}

fn is_left([a, b]: [Point; 2], p: Point) -> bool {
    (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0.0
}

fn at([a, b]: [Point; 2], share: f64) -> Point {
    [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]
}

/// Share of a line at which another line crosses it.
fn crossing([a, b]: [Point; 2], [c, d]: [Point; 2]) -> Option<f64> {
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [d[0] - c[0], d[1] - c[1]]);
    let turn = u[0] * v[1] - u[1] * v[0];
    let to = [c[0] - a[0], c[1] - a[1]];
    let share = (to[0] * v[1] - to[1] * v[0]) / turn;
    // NaN for parallel lines.
    (share > 0.0 && share < 1.0).then_some(share)
}

/// The part of a line within [`NEAR`] of another: one, because the distance from a convex set is convex along a line.
fn near(line: [Point; 2], side: [Point; 2]) -> Option<[f64; 2]> {
    let [a, b] = line;
    let [c, d] = side;
    let (u, v) = ([b[0] - a[0], b[1] - a[1]], [d[0] - c[0], d[1] - c[1]]);
    let mut found: Option<[f64; 2]> = None;
    let mut join = |part: Option<[f64; 2]>| {
        let Some([from, to]) =
            part.map(|[from, to]| [from.max(0.0), to.min(1.0)]).filter(|[from, to]| from <= to)
        else {
            return;
        };
        found = Some(found.map_or([from, to], |[first, last]| [first.min(from), last.max(to)]));
    };
    let length = v[0].hypot(v[1]);
    if length > 0.0 {
        // A rectangle along the side.
        let unit = [v[0] / length, v[1] / length];
        let to = [a[0] - c[0], a[1] - c[1]];
        let along = between(to[0] * unit[0] + to[1] * unit[1], u[0] * unit[0] + u[1] * unit[1], 0.0, length);
        let across =
            between(to[0] * -unit[1] + to[1] * unit[0], u[0] * -unit[1] + u[1] * unit[0], -NEAR, NEAR);
        join(along.zip(across).map(|(p, q)| [p[0].max(q[0]), p[1].min(q[1])]));
    }
    for centre in side {
        // A disc around each end.
        let to = [a[0] - centre[0], a[1] - centre[1]];
        let (p, q, r) = (
            u[0] * u[0] + u[1] * u[1],
            u[0] * to[0] + u[1] * to[1],
            to[0] * to[0] + to[1] * to[1] - NEAR * NEAR,
        );
        let root = q * q - p * r;
        if p > 0.0 && root >= 0.0 {
            join(Some([(-q - root.sqrt()) / p, (-q + root.sqrt()) / p]));
        }
    }
    found
}

/// Where `start + share * step` lies between two bounds.
fn between(start: f64, step: f64, least: f64, most: f64) -> Option<[f64; 2]> {
    if step == 0.0 {
        return (least..=most).contains(&start).then_some([f64::NEG_INFINITY, f64::INFINITY]);
    }
    let (p, q) = ((least - start) / step, (most - start) / step);
    Some([p.min(q), p.max(q)])
}

/// The parts of an outline that no lane covers, as polylines. Counts the pairs of sides; `None` beyond [`MOST_PAIRS`].
fn outside(outline: &[Point], lanes: &[Lane], pairs: &mut usize) -> Option<Vec<Vec<Point>>> {
    let mut lines: Vec<Vec<Point>> = Vec::new();
    let next = outline.iter().cycle().skip(1);
    let mut covered = Vec::new();
    for (a, b) in outline.iter().zip(next) {
        let line = [*a, *b];
        covered.clear();
        for lane in lanes.iter().filter(|lane| lane.may_meet(line)) {
            *pairs += lane.ring.len();
            if *pairs > MOST_PAIRS {
                return None;
            }
            lane.covers(line, &mut covered);
        }
        covered.sort_by(|p, q| p[0].total_cmp(&q[0]));
        let mut from = 0.0;
        for [start, end] in covered.iter().copied().chain([[1.0, 1.0]]) {
            if start > from {
                let part = [at(line, from), if start == 1.0 { *b } else { at(line, start) }];
                match lines.last_mut().filter(|last| from == 0.0 && last.last() == Some(&part[0])) {
                    Some(last) => last.push(part[1]),
                    None => lines.push(part.to_vec()),
                }
            }
            from = f64::max(from, end);
        }
    }
    // An outline has no start: the last line may lead into the first.
    if lines.len() > 1 && lines[0].first() == lines[lines.len() - 1].last() {
        let mut last = lines.pop().unwrap_or_default();
        last.extend(lines[0].iter().skip(1));
        lines[0] = last;
    }
    Some(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rectangle(from: Point, to: Point) -> Vec<Point> {
        // Clockwise, as in the files.
        vec![from, [from[0], to[1]], to, [to[0], from[1]]]
    }

    fn length(edges: &[Vec<Point>]) -> f64 {
        edges.iter().flat_map(|edge| edge.windows(2)).map(|w| distance(w[0], w[1])).sum()
    }

    #[test]
    fn the_road_is_on_the_left_and_areas_are_one() {
        let areas = [rectangle([0.0, 0.0], [10.0, 8.0]), rectangle([10.0, 0.0], [30.0, 8.0])];
        let found = edges(&areas, &[]).unwrap();
        assert_eq!(found.len(), 1);
        assert!((length(&found) - 76.0).abs() < 1e-6, "{found:?}");
        assert!(signed_area(&found[0]) > 0.0);
    }

    #[test]
    fn holes_have_the_road_on_the_left_too() {
        // A ring road of four parts around an island.
        let areas = [
            rectangle([0.0, 0.0], [30.0, 5.0]),
            rectangle([0.0, 25.0], [30.0, 30.0]),
            rectangle([0.0, 0.0], [5.0, 30.0]),
            rectangle([25.0, 0.0], [30.0, 30.0]),
        ];
        let found = edges(&areas, &[]).unwrap();
        let mut turns: Vec<bool> = found.iter().map(|edge| signed_area(edge) > 0.0).collect();
        turns.sort_unstable();
        assert_eq!(turns, [false, true]);
        assert!((length(&found) - 200.0).abs() < 1e-6);
    }

    #[test]
    fn lanes_cut_the_outline_where_the_map_ends() {
        // A road of 8 m with a lane in its middle that leads out of the map on both sides.
        let road = [rectangle([0.0, 0.0], [40.0, 8.0])];
        let lane = [rectangle([0.0, 2.0], [40.0, 6.0])];
        let found = edges(&road, &lane).unwrap();
        assert_eq!(found.len(), 2, "{found:?}");
        // Both long sides, and of each short side what is farther than 0.1 m from the lane.
        assert!((length(&found) - (80.0 + 4.0 * 1.9)).abs() < 1e-6, "{}", length(&found));
        for edge in &found {
            assert!(edge.iter().all(|p| p[1] <= 1.9 + 1e-9 || p[1] >= 6.1 - 1e-9), "{edge:?}");
        }
    }

    #[test]
    fn a_map_with_very_many_pairs_of_sides_is_refused() {
        // A comb as a drivable area, and a lane that goes to and fro across it.
        let tooth = |k: usize| [[k as f64, 0.0], [k as f64 + 0.5, 1000.0]];
        let comb: Vec<Point> = (0..10_000).flat_map(tooth).chain([[1e4, -10.0], [0.0, -10.0]]).collect();
        let lane = |count: usize| -> Vec<Point> {
            (0..count)
                .map(|k| [if k % 2 == 0 { -1.0 } else { 1e4 + 1.0 }, k as f64 * 1000.0 / count as f64])
                .collect()
        };
        assert_eq!(edges(std::slice::from_ref(&comb), &[lane(10_000)]), None);
        assert!(edges(&[comb], &[lane(100)]).is_some());
    }

    #[test]
    fn a_line_beside_a_lane_is_covered_as_far_as_it_is_near() {
        let side = [[0.0, 0.0], [10.0, 0.0]];
        let covered = |y: f64| near([[-10.0, y], [20.0, y]], side);
        assert_eq!(covered(0.2), None);
        let [from, to] = covered(0.0).unwrap();
        assert!((30.0 * from - 9.9).abs() < 1e-9 && (30.0 * to - 20.1).abs() < 1e-9);
        // A line that comes down to it.
        let [from, to] = near([[5.0, 1.0], [5.0, -1.0]], side).unwrap();
        assert!((from - 0.45).abs() < 1e-9 && (to - 0.55).abs() < 1e-9);
    }
}
