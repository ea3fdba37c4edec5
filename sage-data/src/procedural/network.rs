//! Roads and junctions, and their map.
//!
//! A road is a reference line with lanes on both sides. A junction connects road ends ([`Arm`]s) by
//! connecting lanes and rounds the corners between them. Edges have the road on their left.

use sage_core::{
    geometry::Point,
    motion::Pose,
    scene::{Boundary, Lane, Map, MapFeature, MapKind, Neighbor},
};

use super::curve::{beside, bezier, end_pose, resampled, start_pose};

/// Width of a lane for cars, metres.
pub(super) const LANE: f64 = 3.5;
/// Width of a bike lane, metres.
const BIKE: f64 = 1.8;
/// Distance between the outermost lane and the edge, metres.
const GUTTER: f64 = 0.6;
/// Distance between a median and the innermost lane, metres.
const MARGIN: f64 = 0.5;
/// Least change of heading of a turn.
pub(super) const STRAIGHT: f64 = 0.6;
/// Largest number of points of a lane's part; recorded maps also divide lanes.
const MAX_PART_POINTS: usize = 220;

/// A lane of the network under construction.
#[derive(Clone, Debug)]
pub(super) struct LaneLine {
    pub(super) points: Vec<Point>,
    pub(super) exits: Vec<usize>,
    /// Speed limit, m/s.
    pub(super) limit: f64,
    /// Junction that it crosses, and the arm that it starts from.
    pub(super) crossing: Option<(usize, usize)>,
    pub(super) bike: bool,
    /// Lanes of the same direction on the left and on the right.
    sides: [Option<usize>; 2],
    /// Lines or edges on the left and on the right, as indices in `lines`.
    bounds: [Option<usize>; 2],
}

/// Cross-section of a road, in the direction of its reference line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Section {
    /// Number of lanes in the direction of the reference line, on its right.
    pub(super) along: usize,
    /// Number of lanes against it, on its left.
    pub(super) against: usize,
    /// Whether there are bike lanes on the outside.
    pub(super) bikes: bool,
    /// Width of the raised median between the two directions, metres; 0 without one.
    pub(super) median: f64,
    /// Speed limit, m/s.
    pub(super) limit: f64,
}

impl Section {
    /// Distance from the reference line to the innermost lanes, metres.
    fn inner(&self) -> f64 {
        if self.median > 0.0 { 0.5 * self.median + MARGIN } else { 0.0 }
    }

    /// Distance from the reference line to the edge on the right, metres.
    pub(super) fn right(&self) -> f64 {
        self.inner()
            + self.along as f64 * LANE
            + if self.bikes && self.along > 0 { BIKE } else { 0.0 }
            + GUTTER
    }

    /// Distance from the reference line to the edge on the left, metres.
    pub(super) fn left(&self) -> f64 {
        self.inner()
            + self.against as f64 * LANE
            + if self.bikes && self.against > 0 { BIKE } else { 0.0 }
            + GUTTER
    }
}

/// The end of a road at a junction.
#[derive(Clone, Debug)]
pub(super) struct Arm {
    /// Pose on the reference line, heading away from the junction.
    pub(super) out: Pose,
    /// Lanes that enter the junction, innermost first.
    pub(super) entering: Vec<usize>,
    /// Lanes that leave it, innermost first.
    pub(super) leaving: Vec<usize>,
    /// Distance from the reference line to the edge on the left and on the right, facing away from the
    /// junction.
    pub(super) reach: [f64; 2],
}

/// Data of a junction for traffic.
#[derive(Clone, Debug, Default)]
pub(super) struct Junction {
    /// Lanes that cross it.
    pub(super) crossing: Vec<usize>,
    /// Arms that must yield to the others.
    pub(super) minor: Vec<usize>,
    /// Whether lights control it.
    pub(super) lights: bool,
    /// Light phase of each arm, 0 or 1; opposite arms share one.
    pub(super) phases: Vec<usize>,
}

/// Lanes, lines and junctions.
#[derive(Clone, Debug, Default)]
pub(super) struct Network {
    pub(super) lanes: Vec<LaneLine>,
    pub(super) lines: Vec<(MapKind, Vec<Point>)>,
    pub(super) areas: Vec<(MapKind, Vec<Point>)>,
    pub(super) junctions: Vec<Junction>,
}

impl Network {
    /// Adds a lane, divided into parts; returns the first and the last part.
    pub(super) fn lane(&mut self, points: &[Point], limit: f64, bike: bool) -> (usize, usize) {
        let first = self.lanes.len();
        let count = points.len().div_ceil(MAX_PART_POINTS).max(1);
        let size = (points.len() - 1).div_ceil(count).max(1);
        for (k, start) in (0..points.len() - 1).step_by(size).enumerate() {
            let end = (start + size).min(points.len() - 1);
            if k > 0 {
                let before = self.lanes.len() - 1;
                self.lanes[before].exits.push(before + 1);
            }
            self.lanes.push(LaneLine {
                points: points[start..=end].to_vec(),
                exits: Vec::new(),
                limit,
                crossing: None,
                bike,
                sides: [None; 2],
                bounds: [None; 2],
            });
        }
        (first, self.lanes.len() - 1)
    }

    /// Makes two lanes of one direction neighbours, part by part.
    pub(super) fn neighbors(&mut self, left: (usize, usize), right: (usize, usize)) {
        for (part, k) in (right.0..=right.1).enumerate() {
            let beside = (left.0 + part).min(left.1);
            self.lanes[k].sides[0] = Some(beside);
            self.lanes[beside].sides[1] = Some(k);
        }
    }

    /// Sets the lines on the left and on the right of a lane.
    pub(super) fn bounds(&mut self, lane: (usize, usize), bounds: [Option<usize>; 2]) {
        self.lanes[lane.0..=lane.1].iter_mut().for_each(|part| part.bounds = bounds);
    }

    /// Sets the line on the right of a lane only.
    pub(super) fn outer_bound(&mut self, lane: (usize, usize), line: usize) {
        self.lanes[lane.0..=lane.1].iter_mut().for_each(|part| part.bounds[1] = Some(line));
    }

    pub(super) fn line(&mut self, kind: &str, points: Vec<Point>) -> usize {
        self.lines.push((MapKind::from_name(kind), points));
        self.lines.len() - 1
    }

    /// Adds a road along a reference line, without its median; returns its ends, the one at the start first.
    pub(super) fn road(&mut self, reference: &[Point], section: &Section) -> [Arm; 2] {
        let center = (section.along > 0 && section.against > 0 && section.median <= 0.0)
            .then(|| self.line("ROAD_LINE_SOLID_DOUBLE_YELLOW", reference.to_vec()));
        let back: Vec<Point> = reference.iter().rev().copied().collect();
        let sides =
            [(section.along, reference.to_vec(), section.right()), (section.against, back, section.left())];
        let mut ends: [[Vec<usize>; 2]; 2] = Default::default();
        for (side, (count, line, edge)) in sides.into_iter().enumerate() {
            let edge = self.line("ROAD_EDGE_BOUNDARY", beside(&line, -edge));
            let mut inner: Option<(usize, usize)> = None;
            let yellow = "ROAD_LINE_SOLID_SINGLE_YELLOW";
            let mut inner_line = if section.median > 0.0 {
                Some(self.line(yellow, beside(&line, -section.inner())))
            } else {
                center
            };
            // Distance of a number of lanes from the reference line, to the left.
            let at = |lanes: f64| -(section.inner() + lanes * LANE);
            for lane in 0..count {
                let middle = at(lane as f64 + 0.5);
                let (first, last) = self.lane(&beside(&line, middle), section.limit, false);
                let outer = if lane + 1 < count {
                    Some(self.line("ROAD_LINE_BROKEN_SINGLE_WHITE", beside(&line, at(lane as f64 + 1.0))))
                } else if section.bikes {
                    Some(self.line("ROAD_LINE_SOLID_SINGLE_WHITE", beside(&line, at(count as f64))))
                } else {
                    Some(edge)
                };
                self.bounds((first, last), [inner_line, outer]);
                if let Some(inner) = inner {
                    self.neighbors(inner, (first, last));
                }
                (inner, inner_line) = (Some((first, last)), outer);
                ends[side][0].push(first);
                ends[side][1].push(last);
            }
            if section.bikes && count > 0 {
                let middle = at(count as f64) - 0.5 * BIKE;
                self.lane(&beside(&line, middle), 6.0, true);
            }
        }
        let [[along_first, along_last], [against_first, against_last]] = ends;
        let start = Arm {
            out: start_pose(reference),
            entering: against_last,
            leaving: along_first,
            reach: [section.left(), section.right()],
        };
        let end = Arm {
            out: end_pose(reference).turned(),
            entering: along_last,
            leaving: against_first,
            reach: [section.right(), section.left()],
        };
        // The pose of the end faces away from the junction, back along the road.
        [start, end]
    }

    /// Connects arms, which must be in counter-clockwise order around the junction.
    pub(super) fn junction(&mut self, arms: &[Arm], minor: &[usize], lights: bool) -> usize {
        self.junction_where(arms, minor, lights, |_, _| true)
    }

    /// Connects those pairs of arms, from one to the other, that `is_open` selects.
    pub(super) fn junction_where(
        &mut self,
        arms: &[Arm],
        minor: &[usize],
        lights: bool,
        is_open: impl Fn(usize, usize) -> bool,
    ) -> usize {
        let number = self.junctions.len();
        let across = |arm: &Arm| (arm.out.heading - arms[0].out.heading).sin().abs() > 0.7;
        let phases = arms.iter().map(|arm| usize::from(across(arm))).collect();
        let mut junction = Junction { minor: minor.to_vec(), lights, phases, ..Junction::default() };
        for (i, from) in arms.iter().enumerate() {
            for (_, to) in arms.iter().enumerate().filter(|(j, _)| *j != i && is_open(i, *j)) {
                for (a, b) in movements(from, to) {
                    let (enter, leave) = (end_pose(&self.lanes[a].points), start_pose(&self.lanes[b].points));
                    let limit = self.lanes[a].limit.min(turning_speed(&enter, &leave));
                    let (first, last) = self.lane(&bezier(&enter, &leave), limit, false);
                    for lane in first..=last {
                        self.lanes[lane].crossing = Some((number, i));
                        junction.crossing.push(lane);
                    }
                    self.lanes[a].exits.push(first);
                    self.lanes[last].exits.push(b);
                }
            }
            // The corner to the next arm: from this arm's left edge to the next arm's right edge.
            let next = &arms[(i + 1) % arms.len()];
            let inward = from.out.shifted(0.0, from.reach[0]).turned();
            let outward = next.out.shifted(0.0, -next.reach[1]);
            self.line("ROAD_EDGE_BOUNDARY", bezier(&inward, &outward));
        }
        self.junctions.push(junction);
        number
    }

    /// The network as a map, rotated and translated, and the feature indices of its lanes.
    pub(super) fn map(&self, origin: &Pose, height: f64) -> (Map, Vec<usize>) {
        let mut map = Map::default();
        let put = |map: &mut Map, kind: MapKind, points: &[Point]| {
            let first = map.points.len();
            map.points.extend(points.iter().map(|p| {
                let [x, y] = origin.shifted(p[0], p[1]).position;
                [x, y, height]
            }));
            let id = map.features.len().to_string();
            map.features.push(MapFeature { id, kind, points: first..map.points.len(), lane: None });
            map.features.len() - 1
        };
        let lanes: Vec<usize> = self
            .lanes
            .iter()
            .map(|lane| {
                let kind = if lane.bike { MapKind::LaneBike } else { MapKind::LaneSurfaceStreet };
                put(&mut map, kind, &lane.points)
            })
            .collect();
        let lines: Vec<usize> =
            self.lines.iter().map(|(kind, points)| put(&mut map, kind.clone(), points)).collect();
        for (kind, points) in &self.areas {
            put(&mut map, kind.clone(), points);
        }
        for (k, lane) in self.lanes.iter().enumerate() {
            let entries =
                (0..self.lanes.len()).filter(|j| self.lanes[*j].exits.contains(&k)).map(|j| lanes[j]);
            let last = lane.points.len() - 1;
            let neighbor = |side: Option<usize>| {
                let other = |j: usize| Neighbor {
                    lane: lanes[j],
                    own: [0, last],
                    other: [0, self.lanes[j].points.len() - 1],
                };
                side.map(other).into_iter().collect()
            };
            let boundary = |line: Option<usize>| {
                line.map(|line| Boundary { feature: lines[line], own: [0, last] }).into_iter().collect()
            };
            let half = if lane.bike { 0.5 * BIKE } else { 0.5 * LANE };
            map.features[lanes[k]].lane = Some(Box::new(Lane {
                speed_limit: Some(lane.limit),
                entries: entries.collect(),
                exits: lane.exits.iter().map(|j| lanes[*j]).collect(),
                neighbors: [neighbor(lane.sides[0]), neighbor(lane.sides[1])],
                boundaries: [boundary(lane.bounds[0]), boundary(lane.bounds[1])],
                stop_signs: Vec::new(),
                width: vec![[half, half]; lane.points.len()],
            }));
        }
        (map, lanes)
    }
}

/// Pairs of connected lanes of two arms: right turns from the outermost lane, left turns from the
/// innermost, straight on from all.
fn movements(from: &Arm, to: &Arm) -> Vec<(usize, usize)> {
    let turn = turn(from, to);
    let (n, m) = (from.entering.len(), to.leaving.len());
    if n == 0 || m == 0 {
        return Vec::new();
    }
    if turn < -STRAIGHT {
        return vec![(from.entering[n - 1], to.leaving[m - 1])];
    }
    if turn > STRAIGHT {
        return vec![(from.entering[0], to.leaving[0])];
    }
    // Outer lanes connect to outer lanes if the numbers differ.
    (0..n.min(m)).map(|k| (from.entering[n - 1 - k], to.leaving[m - 1 - k])).collect()
}

/// Change of heading from one arm to another, positive to the left.
pub(super) fn turn(from: &Arm, to: &Arm) -> f64 {
    sage_core::geometry::wrap_angle(to.out.heading - from.out.turned().heading)
}

/// Driving speed of a turn, m/s.
fn turning_speed(from: &Pose, to: &Pose) -> f64 {
    let turn = sage_core::geometry::wrap_angle(to.heading - from.heading).abs();
    if turn < 0.4 { f64::INFINITY } else { (9.0 - 2.2 * turn).max(4.5) }
}

/// Edge of a roundabout's island, with the road on its left.
pub(super) fn circle_clockwise(center: Point, radius: f64) -> Vec<Point> {
    let n = 96;
    let at = |k: usize| {
        let a = -std::f64::consts::TAU * k as f64 / n as f64;
        [center[0] + radius * a.cos(), center[1] + radius * a.sin()]
    };
    resampled(&(0..=n).map(at).collect::<Vec<_>>())
}
