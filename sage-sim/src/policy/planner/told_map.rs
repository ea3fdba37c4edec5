//! The map that a planner is told: the features near the route, lanes with what leads to them, beside them and bounds them.

use sage_core::{
    geometry::{Aabb, Point},
    scene::{Boundary, Lane, LaneWidths, Map, MapFeature, Neighbor, SceneIndex},
};
use serde::{Serialize, Serializer, ser::SerializeSeq};

use super::{all_rounded, rounded};
use crate::route::Route;

/// The features of a map that come near a route.
pub(super) struct Features<'a> {
    pub(super) index: &'a SceneIndex,
    pub(super) route: &'a Route,
    /// Metres.
    pub(super) radius: f64,
}

/// A feature of the map.
#[derive(Serialize)]
struct Feature<'a> {
    id: &'a str,
    #[serde(rename = "type")]
    kind: &'a str,
    points: Vec<[f64; 3]>,
    #[serde(flatten)]
    lane: Option<ToldLane<'a>>,
}

/// What a lane adds to its points.
#[derive(Serialize)]
struct ToldLane<'a> {
    speed_limit: Option<f64>,
    entries: Vec<&'a str>,
    exits: Vec<&'a str>,
    left: Vec<&'a str>,
    right: Vec<&'a str>,
    stop_signs: Vec<&'a str>,
    width: Vec<[Option<f64>; 2]>,
    neighbors: Sides<ToldNeighbor<'a>>,
    boundaries: Sides<ToldBoundary<'a>>,
}

#[derive(Serialize)]
struct Sides<T> {
    left: Vec<T>,
    right: Vec<T>,
}

/// A lane beside, for a stretch of points; `line` is the type of what lies between most of it.
#[derive(Serialize)]
struct ToldNeighbor<'a> {
    lane: &'a str,
    from: usize,
    to: usize,
    other_from: usize,
    other_to: usize,
    line: Option<&'a str>,
}

/// A line or edge that bounds a lane for a stretch of points.
#[derive(Serialize)]
struct ToldBoundary<'a> {
    line: &'a str,
    #[serde(rename = "type")]
    kind: &'a str,
    from: usize,
    to: usize,
}

/// Widths are estimates: more digits would only make the message longer.
fn to_centimetres(metres: f64) -> f64 {
    (metres * 100.0).round() / 100.0
}

impl Serialize for Features<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let corners: Vec<Point> = self.route.points().collect();
        let legs: Vec<Aabb> =
            corners.windows(2).map(|leg| Aabb::of(leg.iter().copied()).grown(self.radius)).collect();
        let mut seq = serializer.serialize_seq(None)?;
        for (k, feature) in self.map().features.iter().enumerate() {
            if self.is_near(feature, &legs) {
                seq.serialize_element(&self.feature(k, feature))?;
            }
        }
        seq.end()
    }
}

impl<'a> Features<'a> {
    fn map(&self) -> &'a Map {
        self.index.map()
    }

    /// Whether a segment of a feature, or its only point, comes closer than the radius along both axes.
    fn is_near(&self, feature: &MapFeature, legs: &[Aabb]) -> bool {
        let points = self.map().points_of(feature);
        let meets = |part: &[[f64; 3]]| {
            let part = Aabb::of(part.iter().map(|[x, y, _]| [*x, *y]));
            legs.iter().any(|leg| leg.meets(&part))
        };
        meets(points) && (points.len() == 1 || points.windows(2).any(meets))
    }

    fn feature(&self, k: usize, feature: &'a MapFeature) -> Feature<'a> {
        let points = self.map().points_of(feature).iter().map(|p| all_rounded(*p)).collect();
        let lane = feature.lane.as_ref().map(|lane| self.lane(lane, &self.index.lane_widths()[k]));
        Feature { id: &feature.id, kind: feature.kind.name(), points, lane }
    }

    fn lane(&self, lane: &'a Lane, widths: &LaneWidths) -> ToldLane<'a> {
        let id = |k: usize| Some(&*self.map().features.get(k)?.id);
        let ids = |lanes: &[usize]| -> Vec<&'a str> { lanes.iter().filter_map(|k| id(*k)).collect() };
        let beside = |side: usize| lane.neighbors[side].iter().filter_map(|n| id(n.lane)).collect();
        let [left, right] = [0, 1].map(|side| {
            let neighbors = lane.neighbors[side].iter();
            neighbors.filter_map(|neighbor| self.neighbor(neighbor, &lane.boundaries[side])).collect()
        });
        let neighbors = Sides { left, right };
        let [left, right] = [0, 1].map(|side| {
            let boundaries = lane.boundaries[side].iter();
            boundaries.filter_map(|boundary| self.boundary(boundary)).collect()
        });
        ToldLane {
            speed_limit: lane.speed_limit.map(rounded),
            entries: ids(&lane.entries),
            exits: ids(&lane.exits),
            left: beside(0),
            right: beside(1),
            stop_signs: ids(&lane.stop_signs),
            width: widths.iter().map(|sides| sides.map(|width| width.map(to_centimetres))).collect(),
            neighbors,
            boundaries: Sides { left, right },
        }
    }

    fn neighbor(&self, neighbor: &Neighbor, boundaries: &[Boundary]) -> Option<ToldNeighbor<'a>> {
        let [from, to] = neighbor.own;
        let between = |b: &Boundary| (b.own[1].min(to) + 1).saturating_sub(b.own[0].max(from));
        // Of equal ones the first.
        let line = boundaries.iter().rev().max_by_key(|b| between(b)).filter(|b| between(b) > 0);
        Some(ToldNeighbor {
            lane: &self.map().features.get(neighbor.lane)?.id,
            from,
            to,
            other_from: neighbor.other[0],
            other_to: neighbor.other[1],
            line: line.and_then(|b| Some(self.map().features.get(b.feature)?.kind.name())),
        })
    }

    fn boundary(&self, boundary: &Boundary) -> Option<ToldBoundary<'a>> {
        let feature = self.map().features.get(boundary.feature)?;
        let [from, to] = boundary.own;
        Some(ToldBoundary { line: &feature.id, kind: feature.kind.name(), from, to })
    }
}
