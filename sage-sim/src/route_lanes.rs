//! The lanes that a route follows.
//!
//! Matching by dynamic programming: at each sample of the route the lanes that lie near and lead its way are candidates; a
//! sequence of them costs their distances and angles, and more where one lane does not lead to the next.

use sage_core::{
    geometry::{Aabb, Point, Segment, norm, sub, wrap_angle},
    scene::{Lane, Map, SceneIndex},
};

use crate::route::{Coordinates, Route};

/// Distance of samples on the route, metres, and the largest number of them.
const SAMPLE: f64 = 2.0;
const MOST_SAMPLES: f64 = 2000.0;
/// Largest distance of a lane, metres, and largest angle to the route, rad.
const REACH: f64 = 4.0;
const LARGEST_ANGLE: f64 = 50.0 * std::f64::consts::PI / 180.0;
/// Cost of an angle beside a squared distance, m².
const ANGLE_COST: f64 = 4.0;
/// Cost of going on to a lane that follows, to one beside, and to any other, m².
const FOLLOWS: f64 = 0.2;
const BESIDE: f64 = 6.0;
const JUMPS: f64 = 60.0;
/// Most candidates of a sample, and most links of a lane on each side that are followed.
const MOST_CANDIDATES: usize = 16;
const MOST_LINKS: usize = 64;

/// A lane that a sample may lie on.
struct Candidate {
    lane: usize,
    cost: f64,
    /// Candidate of the sample before.
    before: usize,
}

/// The lanes that a route follows (indices into [`Map::features`]), in their order. Where no lane is near, none is named.
pub fn route_lanes(route: &Route, index: &SceneIndex) -> Vec<usize> {
    let count = (route.length() / SAMPLE).min(MOST_SAMPLES).floor();
    let spacing = if count >= 1.0 { route.length() / count } else { SAMPLE };
    let mut samples: Vec<Vec<Candidate>> = Vec::new();
    for k in 0..=count as usize {
        let along = k as f64 * spacing;
        let point = route.point(Coordinates { along, across: 0.0 });
        let mut found = candidates(index, point, route.heading(along));
        if let Some(before) = samples.last() {
            for candidate in &mut found {
                let costs = before.iter().map(|b| b.cost + transition(index.map(), b.lane, candidate.lane));
                if let Some((k, cost)) = costs.enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b)) {
                    (candidate.before, candidate.cost) = (k, candidate.cost + cost);
                }
            }
        }
        if !found.is_empty() {
            samples.push(found);
        }
    }
    let last = samples.last().and_then(|last| {
        let costs = last.iter().enumerate();
        costs.min_by(|(_, a), (_, b)| a.cost.total_cmp(&b.cost)).map(|(k, _)| k)
    });
    let Some(mut at) = last else { return Vec::new() };
    let mut lanes = Vec::with_capacity(samples.len());
    for sample in samples.iter().rev() {
        lanes.push(sample[at].lane);
        at = sample[at].before;
    }
    lanes.reverse();
    lanes.dedup();
    lanes
}

/// A lane near a point.
pub(crate) struct NearLane {
    /// Index into [`Map::features`].
    pub lane: usize,
    /// Distance of a segment of it, metres.
    pub distance: f64,
    /// Angle of that segment to a direction, rad, in [0, π].
    pub angle: f64,
}

/// The segments of lanes within some metres of a point, with their angles to a direction.
pub(crate) fn lanes_near(
    index: &SceneIndex,
    point: Point,
    heading: f64,
    reach: f64,
) -> impl Iterator<Item = NearLane> {
    let lanes = index.motor_lanes();
    let near = lanes.near(&Aabb::of([point]).grown(reach)).flatten().map(|k| &lanes.segments()[k]);
    let lane = move |segment: &Segment| {
        let way = sub(segment.b, segment.a);
        NearLane {
            lane: segment.feature as usize,
            distance: norm(sub(segment.at(segment.nearest_share(point)), point)),
            angle: wrap_angle(way[1].atan2(way[0]) - heading).abs(),
        }
    };
    near.map(lane).filter(move |lane| lane.distance <= reach)
}

/// The lanes near a point that lead in a direction.
fn candidates(index: &SceneIndex, point: Point, heading: f64) -> Vec<Candidate> {
    let near = lanes_near(index, point, heading, REACH).filter(|near| near.angle <= LARGEST_ANGLE);
    let candidate = |near: NearLane| {
        let cost = near.distance * near.distance + ANGLE_COST * (1.0 - near.angle.cos());
        Candidate { lane: near.lane, cost, before: 0 }
    };
    let mut found: Vec<Candidate> = near.map(candidate).collect();
    // Each lane once, by its nearest segment.
    found.sort_by(|a, b| a.lane.cmp(&b.lane).then(a.cost.total_cmp(&b.cost)));
    found.dedup_by_key(|candidate| candidate.lane);
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.lane.cmp(&b.lane)));
    found.truncate(MOST_CANDIDATES);
    found
}

/// Cost of a lane after another, m².
fn transition(map: &Map, from: usize, to: usize) -> f64 {
    let lane = |k: usize| map.features.get(k).and_then(|feature| feature.lane.as_deref());
    let leads = |a: Option<&Lane>, b: usize| {
        a.is_some_and(|lane| lane.exits.iter().take(MOST_LINKS).any(|k| *k == b))
    };
    let is_entry = |a: Option<&Lane>, b: usize| {
        a.is_some_and(|lane| lane.entries.iter().take(MOST_LINKS).any(|k| *k == b))
    };
    let is_beside = |a: Option<&Lane>, b: usize| {
        let neighbors = |lane: &Lane| {
            lane.neighbors.each_ref().map(|side| side.iter().take(MOST_LINKS).any(|n| n.lane == b))
        };
        a.is_some_and(|lane| neighbors(lane).contains(&true))
    };
    if from == to {
        0.0
    } else if leads(lane(from), to) || is_entry(lane(to), from) {
        FOLLOWS
    } else if is_beside(lane(from), to) || is_beside(lane(to), from) {
        BESIDE
    } else {
        JUMPS
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use sage_core::scene::{MapFeature, MapKind, Neighbor};

    use super::*;

    /// Two lanes side by side of 40 m each, and one that leads on from the left one.
    fn index() -> Arc<SceneIndex> {
        let mut map = Map::default();
        let mut add = |id: &str, line: [[f64; 2]; 2], lane: Lane| {
            let first = map.points.len();
            map.points.extend(line.map(|[x, y]| [x, y, 0.0]));
            let (kind, points) = (MapKind::LaneSurfaceStreet, first..map.points.len());
            map.features.push(MapFeature { id: id.into(), kind, points, lane: Some(lane.into()) });
        };
        let beside = vec![Neighbor { lane: 0, own: [0, 1], other: [0, 1] }];
        let exits = vec![2];
        add("left", [[0.0, 3.5], [40.0, 3.5]], Lane { exits, ..Lane::default() });
        add("right", [[0.0, 0.0], [40.0, 0.0]], Lane { neighbors: [beside, vec![]], ..Lane::default() });
        add("on", [[40.0, 3.5], [80.0, 3.5]], Lane::default());
        SceneIndex::new(Arc::new(map))
    }

    #[test]
    fn a_route_follows_lanes_and_changes_them_once() {
        let lanes = |points: &[Point]| route_lanes(&Route::new(points), &index());
        assert_eq!(lanes(&[[0.0, 3.0], [80.0, 3.0]]), [0, 2]);
        assert_eq!(lanes(&[[0.0, 0.2], [15.0, 0.2], [25.0, 3.3], [80.0, 3.3]]), [1, 0, 2]);
        // Between two lanes it keeps to one.
        assert_eq!(lanes(&[[0.0, 1.8], [20.0, 1.7], [40.0, 1.8]]).len(), 1);
        // No lane leads its way, or none is near.
        assert_eq!(lanes(&[[80.0, 3.0], [0.0, 3.0]]), [0_usize; 0]);
        assert_eq!(lanes(&[[0.0, 50.0], [80.0, 50.0]]), [0_usize; 0]);
    }
}
