//! Search structures of the map, each built on first use, because `paper` needs road boundaries only.

use std::sync::{Arc, OnceLock};

use super::{LaneWidths, Map, MapFeature, MapKind, Sidewalks, lane_widths, levels, map::JOINED};
use crate::geometry::{Point, Segment, SegmentIndex, distance};

/// Largest distance of a lane whose height something follows, metres.
const GROUND_REACH: f64 = 8.0;

/// Which boundaries of a map say on which side the road lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sided {
    /// None, or there is no boundary.
    None,
    /// Some: a search must leave the others out.
    Some,
    /// All of them.
    All,
}

/// Search structures over one map. Build it once per scene and share it.
///
/// How far a point is from the edge of the road, and on which side of it:
///
/// ```
/// use sage_core::{
///     geometry::Side,
///     scene::{Map, MapFeature, MapKind, SceneIndex},
/// };
///
/// let points = vec![[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]];
/// let edge = MapFeature { id: "edge".to_owned(), kind: MapKind::EdgeBoundary, points: 0..2, lane: None };
/// let index = SceneIndex::new(Map { points, features: vec![edge] }.into());
///
/// let edges = index.boundaries();
/// let nearest = edges.nearest([30.0, 4.0], 10.0, |_| true).ok_or("no edge within 10 m")?;
/// assert_eq!(nearest.distance, 4.0);
/// // The road lies on the left of a boundary.
/// assert_eq!(edges.side([30.0, 4.0], &nearest), Some(Side::Left));
/// # Ok::<(), &str>(())
/// ```
pub struct SceneIndex {
    map: Arc<Map>,
    boundaries: OnceLock<SegmentIndex>,
    open_ends: OnceLock<Vec<Point>>,
    sided: OnceLock<Sided>,
    sidewalks: OnceLock<Sidewalks>,
    medians: OnceLock<SegmentIndex>,
    edges: OnceLock<SegmentIndex>,
    motor_lanes: OnceLock<SegmentIndex>,
    solid_lines: OnceLock<SegmentIndex>,
    along: OnceLock<Vec<f64>>,
    lane_widths: OnceLock<Vec<LaneWidths>>,
    largest_step: OnceLock<f64>,
}

impl SceneIndex {
    /// An index of a map. Each structure is built on first use.
    pub fn new(map: Arc<Map>) -> Arc<Self> {
        Arc::new(Self {
            map,
            boundaries: OnceLock::new(),
            open_ends: OnceLock::new(),
            sided: OnceLock::new(),
            sidewalks: OnceLock::new(),
            medians: OnceLock::new(),
            edges: OnceLock::new(),
            motor_lanes: OnceLock::new(),
            solid_lines: OnceLock::new(),
            along: OnceLock::new(),
            lane_widths: OnceLock::new(),
            largest_step: OnceLock::new(),
        })
    }

    /// The indexed map.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Road boundaries: all edges but medians, and with them the outlines of sidewalks.
    pub fn boundaries(&self) -> &SegmentIndex {
        self.boundaries.get_or_init(|| self.build(MapKind::is_boundary))
    }

    /// Which boundaries have the road on their left (`ROAD_EDGE_BOUNDARY`).
    pub fn sided(&self) -> Sided {
        *self.sided.get_or_init(|| {
            let is_line = |f: &&MapFeature| f.kind.is_boundary() && f.points.len() > 1;
            let mut lines = self.map.features.iter().filter(is_line);
            let count = lines.clone().filter(|f| f.kind == MapKind::EdgeBoundary).count();
            match (count, lines.any(|f| f.kind != MapKind::EdgeBoundary)) {
                (0, _) => Sided::None,
                (_, false) => Sided::All,
                (_, true) => Sided::Some,
            }
        })
    }

    /// Sidewalks that are areas.
    pub fn sidewalks(&self) -> &Sidewalks {
        self.sidewalks.get_or_init(|| Sidewalks::of(&self.map))
    }

    /// Ends of road boundaries that no other boundary continues: a car can pass between them to the other side.
    pub fn open_ends(&self) -> &[Point] {
        self.open_ends.get_or_init(|| {
            let boundaries = self.boundaries();
            let segments = boundaries.segments();
            let is_open = |feature: u32, end: Point| {
                boundaries.nearest(end, JOINED, |other| other.feature != feature).is_none()
            };
            let mut open = Vec::new();
            for (k, segment) in segments.iter().enumerate() {
                if segment.joined[0] {
                    continue;
                }
                let Some(last) = segments[k..].iter().find(|other| !other.joined[1]) else { continue };
                // A closed polyline ends where it starts.
                if distance(segment.a, last.b) > JOINED {
                    let ends = [segment.a, last.b];
                    open.extend(ends.into_iter().filter(|end| is_open(segment.feature, *end)));
                }
            }
            open
        })
    }

    /// Medians (`ROAD_EDGE_MEDIAN`).
    pub fn medians(&self) -> &SegmentIndex {
        self.medians.get_or_init(|| self.build(|kind| *kind == MapKind::EdgeMedian))
    }

    /// Road boundaries and medians.
    pub fn edges(&self) -> &SegmentIndex {
        self.edges.get_or_init(|| self.build(MapKind::is_edge))
    }

    /// Centre lines of lanes for motor vehicles.
    pub fn motor_lanes(&self) -> &SegmentIndex {
        self.motor_lanes.get_or_init(|| self.build(MapKind::is_motor_lane))
    }

    /// Solid lines that are painted on the road.
    pub fn solid_lines(&self) -> &SegmentIndex {
        self.solid_lines.get_or_init(|| self.build(MapKind::is_solid_line))
    }

    /// Distance of each point of the map along its feature from the feature's first point, metres, in the
    /// plane. No two features share a point.
    pub fn along(&self) -> &[f64] {
        self.along.get_or_init(|| {
            let points = &self.map.points;
            let mut along = vec![0.0; points.len()];
            for feature in &self.map.features {
                for k in feature.points.clone().skip(1) {
                    let [dx, dy] = [points[k][0] - points[k - 1][0], points[k][1] - points[k - 1][1]];
                    along[k] = along[k - 1] + (dx * dx + dy * dy).sqrt();
                }
            }
            along
        })
    }

    /// Distances from the points of each lane to what bounds it, by the number of its feature; empty for other features.
    pub fn lane_widths(&self) -> &[LaneWidths] {
        self.lane_widths.get_or_init(|| lane_widths::lane_widths(&self.map))
    }

    /// Builds the structures that features and scoring use, so that time measurements exclude it.
    pub fn build_all(&self) {
        self.boundaries();
        self.edges();
        self.motor_lanes();
        self.along();
    }

    /// Height of the ground at a point, metres, for something that was at a height `before`: that of the nearest
    /// motor lane within 8 m whose height differs by at most `gap` metres. Without one the height stays.
    pub fn follow_ground(&self, p: Point, before: f64, gap: f64) -> f64 {
        let lanes = self.motor_lanes();
        let is_level = |lane: &Segment| (lane.height(lane.nearest_share(p)) - before).abs() <= gap;
        let found = lanes.nearest(p, GROUND_REACH, is_level);
        found.map_or(before, |found| lanes.segments()[found.segment].height(found.share))
    }

    /// Whether a feature of the map passes more than `gap` metres above another one. Slopes do not count.
    pub fn has_levels(&self, gap: f64) -> bool {
        *self.largest_step.get_or_init(|| levels::largest_step(&self.map)) > gap
    }

    fn build(&self, accept: impl Fn(&MapKind) -> bool) -> SegmentIndex {
        SegmentIndex::build(self.map.polylines(accept))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_along_a_feature_begin_anew_with_each() {
        let points =
            vec![[0.0, 0.0, 5.0], [3.0, 4.0, 0.0], [3.0, 6.0, 0.0], [9.0, 9.0, 0.0], [9.0, 10.0, 0.0]];
        let feature =
            |id: &str, points| MapFeature { id: id.into(), kind: MapKind::EdgeBoundary, points, lane: None };
        let features = vec![feature("a", 0..3), feature("none", 3..3), feature("b", 3..5)];
        let index = SceneIndex::new(Arc::new(Map { points, features }));
        assert_eq!(index.along(), [0.0, 5.0, 7.0, 0.0, 1.0]);
    }
}
