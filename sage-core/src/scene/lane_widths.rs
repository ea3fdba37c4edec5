//! How wide lanes are: distances from their centre lines to the lines and edges that bound them.
//!
//! Recorded widths are not used: converters measure them between points of the same number, and are wrong by tens of metres where a line
//! has other points than the lane.

use super::{Lane, Map};
use crate::geometry::{Aabb, Point, dot, sub};

/// Lines farther than this bound no lane, metres.
const REACH: f64 = 10.0;
/// Segments of a line that have bounds in common.
const RUN: usize = 16;
/// Most runs of a line and most boundaries of a side that are looked at, so that no map takes long: eight kilometres at a metre.
const MOST_RUNS: usize = 512;
const MOST_BOUNDARIES: usize = 256;

/// Distance from each point of a lane to what bounds it on the left and on the right, metres; `None` where nothing does.
pub type LaneWidths = Vec<[Option<f64>; 2]>;

/// A line or edge that bounds lanes.
struct Line {
    points: Vec<Point>,
    /// Bounds of each run of segments.
    runs: Vec<Aabb>,
}

/// The widths of all features of a map; empty for those that are no lanes.
pub(super) fn lane_widths(map: &Map) -> Vec<LaneWidths> {
    let mut lines: Vec<Option<Line>> = map.features.iter().map(|_| None).collect();
    let lanes = map.features.iter().filter_map(|feature| feature.lane.as_deref());
    for bound in lanes.flat_map(|lane| lane.boundaries.iter().flatten()) {
        if let Some(line) = lines.get_mut(bound.feature) {
            line.get_or_insert_with(|| Line::new(map.points_of(&map.features[bound.feature])));
        }
    }
    let width = |lane: &Lane, side: usize, k: usize, point: Point| {
        let here = |bound: &&super::Boundary| (bound.own[0]..=bound.own[1]).contains(&k);
        // Where two meet, the first.
        let bound = lane.boundaries[side].iter().take(MOST_BOUNDARIES).find(here)?;
        lines.get(bound.feature)?.as_ref()?.distance(point)
    };
    let of_feature = |feature: &super::MapFeature| -> LaneWidths {
        let Some(lane) = feature.lane.as_deref() else { return Vec::new() };
        let points = map.points_of(feature).iter().enumerate();
        points.map(|(k, [x, y, _])| [0, 1].map(|side| width(lane, side, k, [*x, *y]))).collect()
    };
    map.features.iter().map(of_feature).collect()
}

impl Line {
    fn new(points: &[[f64; 3]]) -> Self {
        let points: Vec<Point> = points.iter().map(|[x, y, _]| [*x, *y]).collect();
        let run = |first: usize| Aabb::of(points[first..].iter().take(RUN + 1).copied());
        let runs = (0..points.len().saturating_sub(1)).step_by(RUN).take(MOST_RUNS).map(run).collect();
        Self { points, runs }
    }

    /// Distance of a point, metres, if it is in reach.
    fn distance(&self, point: Point) -> Option<f64> {
        let mut least = REACH * REACH;
        let mut is_near = false;
        for (run, bounds) in self.runs.iter().enumerate() {
            if bounds.squared_distance(point) > least {
                continue;
            }
            let points = self.points[run * RUN..].iter().take(RUN + 1);
            for (a, b) in points.clone().zip(points.skip(1)) {
                let squared = squared_distance(point, *a, *b);
                if squared <= least {
                    (least, is_near) = (squared, true);
                }
            }
        }
        is_near.then(|| least.sqrt())
    }
}

/// Squared distance of a point to a segment, m².
fn squared_distance(point: Point, a: Point, b: Point) -> f64 {
    let (way, from) = (sub(b, a), sub(point, a));
    let length = dot(way, way);
    let share = if length > 0.0 { (dot(from, way) / length).clamp(0.0, 1.0) } else { 0.0 };
    let away = sub(from, [share * way[0], share * way[1]]);
    dot(away, away)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Boundary, MapFeature, MapKind};

    #[test]
    fn widths_are_distances_to_what_bounds_the_lane_there() {
        let mut map = Map::default();
        let mut add = |id: &str, kind, line: &[[f64; 2]], lane: Option<Lane>| {
            let first = map.points.len();
            map.points.extend(line.iter().map(|[x, y]| [*x, *y, 0.0]));
            let points = first..map.points.len();
            map.features.push(MapFeature { id: id.into(), kind, points, lane: lane.map(Box::new) });
        };
        // The lines have fewer points than the lane, and one is far away.
        let boundaries =
            [vec![Boundary { feature: 1, own: [0, 1] }], vec![Boundary { feature: 2, own: [0, 2] }]];
        let lane = Lane { boundaries, ..Lane::default() };
        add("lane", MapKind::LaneSurfaceStreet, &[[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]], Some(lane));
        add("left", MapKind::EdgeBoundary, &[[-5.0, 1.8], [30.0, 1.8]], None);
        add("right", MapKind::EdgeBoundary, &[[-5.0, -1.7], [12.0, -1.7], [20.0, -30.0]], None);
        let widths = lane_widths(&map);
        assert_eq!(widths[0][0], [Some(1.8), Some(1.7)]);
        assert_eq!(widths[0][1], [Some(1.8), Some(1.7)]);
        assert_eq!(widths[0][2][0], None, "nothing bounds it there");
        assert!(widths[0][2][1].is_some_and(|width| width > 3.0));
        assert!(widths[1].is_empty());
        assert_eq!(lane_widths(&Map::default()), Vec::<LaneWidths>::new());
    }
}
