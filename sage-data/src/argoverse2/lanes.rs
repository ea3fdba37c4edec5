//! Lanes, road lines and crossings of a map as MetaDrive values, all at height 0.

use std::collections::{HashMap, HashSet};

use sage_core::geometry::{Point, distance};

use super::map_file::{Crossing, LaneSegment, Point as FilePoint};
use crate::{metadrive::Values, pickle::Id};

/// Words of MetaDrive for marks of lanes; others keep their name behind ROAD_LINE_. `NONE` is no line.
const MARKS: [(&str, &str); 9] = [
    ("DASHED_WHITE", "ROAD_LINE_BROKEN_SINGLE_WHITE"),
    ("SOLID_WHITE", "ROAD_LINE_SOLID_SINGLE_WHITE"),
    ("DOUBLE_SOLID_WHITE", "ROAD_LINE_SOLID_DOUBLE_WHITE"),
    ("DASHED_YELLOW", "ROAD_LINE_BROKEN_SINGLE_YELLOW"),
    ("DOUBLE_DASH_YELLOW", "ROAD_LINE_BROKEN_DOUBLE_YELLOW"),
    ("SOLID_YELLOW", "ROAD_LINE_SOLID_SINGLE_YELLOW"),
    ("DOUBLE_SOLID_YELLOW", "ROAD_LINE_SOLID_DOUBLE_YELLOW"),
    ("SOLID_DASH_YELLOW", "ROAD_LINE_PASSING_DOUBLE_YELLOW"),
    ("DASH_SOLID_YELLOW", "ROAD_LINE_PASSING_DOUBLE_YELLOW"),
];
/// Ends of lines that are nearer are of one line, which two lanes share; metres.
const SAME: f64 = 0.05;

/// A lane with its derived centre line.
pub(super) struct Lane<'m> {
    pub(super) segment: &'m LaneSegment,
    left: Vec<Point>,
    right: Vec<Point>,
    center: Vec<Point>,
}

impl<'m> Lane<'m> {
    pub(super) fn new(segment: &'m LaneSegment) -> Self {
        let [left, right] =
            [&segment.left_lane_boundary, &segment.right_lane_boundary].map(|side| places(side));
        let center = match &segment.centerline {
            Some(line) if line.len() > 1 => places(line),
            _ => between(&left, &right),
        };
        Self { segment, left, right, center }
    }

    /// Whether motor vehicles drive on it.
    pub(super) fn is_motor(&self) -> bool {
        self.segment.lane_type != "BIKE"
    }

    /// Whether its centre line is derived.
    pub(super) fn is_derived(&self) -> bool {
        self.segment.centerline.as_ref().is_none_or(|line| line.len() < 2)
    }

    /// Its outline.
    pub(super) fn polygon(&self) -> Vec<Point> {
        self.left.iter().chain(self.right.iter().rev()).copied().collect()
    }

    fn direction(&self) -> Point {
        let (first, last) = (self.center.first(), self.center.last());
        first.zip(last).map_or([0.0; 2], |(a, b)| [b[0] - a[0], b[1] - a[1]])
    }

    fn value(&self, lanes: &HashMap<i64, &Self>, values: &mut Values) -> Id {
        let kind = values.word(if self.is_motor() { "LANE_SURFACE_STREET" } else { "LANE_BIKE_LANE" });
        let line = flat(&self.center, values);
        let width: Vec<f64> =
            self.center.iter().flat_map(|p| [nearest(*p, &self.left), nearest(*p, &self.right)]).collect();
        let width = values.doubles(&[self.center.len(), 2], &width);
        let [entries, exits] = [&self.segment.predecessors, &self.segment.successors].map(|ids| {
            let ids = ids.iter().map(|id| values.decimal(*id)).collect();
            values.list(ids)
        });
        let sides = [self.segment.left_neighbor_id, self.segment.right_neighbor_id];
        let [left, right] = sides.map(|id| self.neighbors(id, lanes, values));
        values.dict([
            ("type", kind),
            ("polyline", line),
            ("width", width),
            ("entry_lanes", entries),
            ("exit_lanes", exits),
            ("left_neighbor", left),
            ("right_neighbor", right),
        ])
    }

    /// The neighbour on a side, if it leads the same way: the files name those that lead the other way too.
    fn neighbors(&self, id: Option<i64>, lanes: &HashMap<i64, &Self>, values: &mut Values) -> Id {
        let other = id.and_then(|id| lanes.get(&id));
        let leads_along = |other: &&&Self| {
            let (u, v) = (self.direction(), other.direction());
            u[0] * v[0] + u[1] * v[1] > 0.0
        };
        let Some(other) = other.filter(leads_along) else { return values.list(Vec::new()) };
        let feature = values.decimal(other.segment.id);
        let [first, last, end] =
            [0, self.center.len() as i64 - 1, other.center.len() as i64 - 1].map(|index| values.int(index));
        let neighbor = values.dict([
            ("feature_id", feature),
            ("self_start_index", first),
            ("self_end_index", last),
            ("neighbor_start_index", first),
            ("neighbor_end_index", end),
        ]);
        values.list(vec![neighbor])
    }
}

/// The features of all lanes, the lines between them, and the crossings.
pub(super) fn features(lanes: &[Lane], crossings: &[Crossing], values: &mut Values) -> Vec<(Id, Id)> {
    let by_id: HashMap<i64, &Lane> = lanes.iter().map(|lane| (lane.segment.id, lane)).collect();
    let mut all: Vec<(Id, Id)> =
        lanes.iter().map(|lane| (values.decimal(lane.segment.id), lane.value(&by_id, values))).collect();
    let mut drawn = HashSet::new();
    for lane in lanes {
        let marks = [&lane.segment.left_lane_mark_type, &lane.segment.right_lane_mark_type];
        for (side, (mark, line)) in
            ["left", "right"].into_iter().zip(marks.into_iter().zip([&lane.left, &lane.right]))
        {
            let mark = mark.as_deref().unwrap_or("NONE");
            let (Some(first), Some(last)) = (line.first(), line.last()) else { continue };
            let cell = |p: &Point| p.map(|x| (x / SAME).round() as i64);
            let ends = [cell(first).min(cell(last)), cell(first).max(cell(last))];
            if mark == "NONE" || mark == "UNKNOWN" || line.len() < 2 || !drawn.insert(ends) {
                continue;
            }
            let kind = match MARKS.iter().find(|(name, _)| *name == mark) {
                Some((_, word)) => values.word(word),
                None => values.text(&format!("ROAD_LINE_{mark}")),
            };
            let line = flat(line, values);
            let feature = values.dict([("type", kind), ("polyline", line)]);
            all.push((values.text(&format!("{}-{side}", lane.segment.id)), feature));
        }
    }
    for crossing in crossings {
        let corners: Vec<Point> =
            crossing.edge1.iter().chain(crossing.edge2.iter().rev()).map(|p| p.place()).collect();
        let kind = values.word("CROSSWALK");
        let corners = flat(&corners, values);
        let feature = values.dict([("type", kind), ("polygon", corners)]);
        all.push((values.text(&format!("crossing-{}", crossing.id)), feature));
    }
    all
}

/// Points at height 0.
pub(super) fn flat(line: &[Point], values: &mut Values) -> Id {
    let numbers: Vec<f64> = line.iter().flat_map(|p| [p[0], p[1], 0.0]).collect();
    values.doubles(&[line.len(), 3], &numbers)
}

fn places(line: &[FilePoint]) -> Vec<Point> {
    line.iter().map(|point| point.place()).collect()
}

/// The line halfway between points at equal shares of two lines.
fn between(left: &[Point], right: &[Point]) -> Vec<Point> {
    let count = left.len().max(right.len()).max(2);
    if left.is_empty() || right.is_empty() {
        return left.iter().chain(right).copied().collect();
    }
    let share = |k: usize| k as f64 / (count - 1) as f64;
    let middle = |p: Point, q: Point| [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
    (0..count).map(|k| middle(at_share(left, share(k)), at_share(right, share(k)))).collect()
}

/// The point at a share of the length of a line that has points.
fn at_share(line: &[Point], share: f64) -> Point {
    let lengths: Vec<f64> = line.windows(2).map(|w| distance(w[0], w[1])).collect();
    let mut left = share * lengths.iter().sum::<f64>();
    for (w, length) in line.windows(2).zip(lengths) {
        if left <= length && length > 0.0 {
            let share = left / length;
            return [0, 1].map(|axis| w[0][axis] + share * (w[1][axis] - w[0][axis]));
        }
        left -= length;
    }
    line[line.len() - 1]
}

/// Distance of a point from a line, metres; 0 without points.
fn nearest(p: Point, line: &[Point]) -> f64 {
    let to = |w: &[Point]| {
        let (u, v) = ([w[1][0] - w[0][0], w[1][1] - w[0][1]], [p[0] - w[0][0], p[1] - w[0][1]]);
        let square = u[0] * u[0] + u[1] * u[1];
        let share = if square > 0.0 { ((u[0] * v[0] + u[1] * v[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
        (v[0] - share * u[0]).hypot(v[1] - share * u[1])
    };
    let found = line.windows(2).map(to).reduce(f64::min);
    found.or_else(|| line.first().map(|q| distance(p, *q))).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_centre_line_lies_halfway() {
        let (left, right) = ([[0.0, 2.0], [10.0, 2.0]], [[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]]);
        assert_eq!(between(&left, &right), [[0.0, 1.0], [5.0, 1.0], [10.0, 1.0]]);
        assert_eq!(nearest([5.0, 1.0], &left), 1.0);
    }
}
