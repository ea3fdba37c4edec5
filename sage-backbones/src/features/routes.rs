//! Routes over the lane graph: which lanes the target can reach, at which distance along the road, and past
//! which red lights.

use std::{
    cmp::Ordering,
    collections::{BinaryHeap, HashMap, HashSet},
};

use sage_core::{
    geometry::{Aabb, Point, distance, wrap_angle},
    motion::NOW,
    scene::{LightState, Map, Neighbor, Scene, SceneIndex},
};

/// A route can start on a lane within this distance of the target, metres.
const BESIDE: f64 = 2.5;
/// Without such a lane, routes start on the nearest lane within this distance, metres.
const SEARCH: f64 = 6.0;
/// Maximum angle between the target and a lane on which a route starts, radians.
const ALIGNED: f64 = 1.0;
/// Maximum number of lane changes on a route.
const CHANGES: u8 = 2;
/// Cost of a lane change when routes are compared, metres.
const CHANGE_COST: f64 = 15.0;
/// Maximum length of a route, metres.
const LONGEST: f64 = 350.0;

/// The cheapest route of the target to a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Distance along the road from the target to the lane's start, metres; negative on the lanes
    /// on which routes start.
    pub distance: f64,
    /// Lane changes on the route.
    pub changes: u8,
    /// Distance along the road to the first stop line whose light is red or yellow, metres.
    pub stop: Option<f64>,
}

/// Routes from the target over the lane graph.
#[derive(Clone, Debug)]
pub struct Routes {
    reach: Vec<Option<Reach>>,
    lights: Vec<Option<LightState>>,
}

/// Input tables of the search, each built in one pass over the map.
struct Roads<'s> {
    map: &'s Map,
    /// Distance along its lane of each point of the map, metres.
    along: &'s [f64],
    /// Distance of the stop line along each lane whose light is red or yellow, metres.
    stops: Vec<Option<f64>>,
}

/// An entry of the search's heap: a route to a lane.
struct Step {
    cost: f64,
    lane: usize,
    route: Reach,
}

impl Ord for Step {
    // The heap returns the largest entry first, so the order of costs is reversed.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.lane.cmp(&self.lane))
    }
}
impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl PartialEq for Step {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Step {}

impl Routes {
    /// Routes from a position with a heading, by a search over exits and neighbours, the cheapest route
    /// first.
    pub fn from(scene: &Scene, index: &SceneIndex, position: Point, heading: f64) -> Self {
        let lights = lights(scene);
        let roads = Roads::new(scene, index, &lights);
        let mut reach: Vec<Option<Reach>> = vec![None; scene.map.features.len()];
        let mut heap = BinaryHeap::new();
        for (lane, along) in roads.starts(index, position, heading) {
            let route = roads.route(lane, -along, 0, None);
            heap.push(Step { cost: -along, lane, route });
        }
        while let Some(Step { lane, route, .. }) = heap.pop() {
            if reach[lane].is_none() {
                reach[lane] = Some(route);
                roads.expand(lane, route, &reach, &mut heap);
            }
        }
        Self { reach, lights: lights.into_iter().map(|light| light.map(|(_, state)| state)).collect() }
    }

    /// Route of the target to a map feature; `None` if that is not a lane that the target can reach.
    pub fn reach(&self, feature: usize) -> Option<&Reach> {
        self.reach[feature].as_ref()
    }

    /// State *now* of the traffic light of a map feature, without flashing.
    pub fn light(&self, feature: usize) -> Option<LightState> {
        self.lights[feature]
    }
}

/// For each map feature, its traffic light and the state of that light *now*, without flashing.
fn lights(scene: &Scene) -> Vec<Option<(usize, LightState)>> {
    let shown: HashMap<&str, (usize, LightState)> = scene
        .lights
        .iter()
        .enumerate()
        .filter_map(|(k, light)| Some((light.lane.as_str(), (k, light.states.get(NOW)?.steady()))))
        .collect();
    if shown.is_empty() {
        return vec![None; scene.map.features.len()];
    }
    scene.map.features.iter().map(|f| f.lane.as_ref().and(shown.get(f.id.as_str()).copied())).collect()
}

impl<'s> Roads<'s> {
    fn new(scene: &'s Scene, index: &'s SceneIndex, lights: &[Option<(usize, LightState)>]) -> Self {
        let map = &*scene.map;
        let mut roads = Self { map, along: index.along(), stops: vec![None; map.features.len()] };
        for (lane, light) in lights.iter().enumerate() {
            if let Some((light, LightState::Stop | LightState::Caution)) = light {
                let line = scene.lights[*light].stop_point;
                roads.stops[lane] = Some(line.map_or(0.0, |line| roads.project(lane, [line[0], line[1]])));
            }
        }
        roads
    }

    /// Distance along a lane of its point of this index, metres; of its last point for larger indices.
    fn arc(&self, lane: usize, point: usize) -> f64 {
        let points = &self.map.features[lane].points;
        if points.is_empty() { 0.0 } else { self.along[points.start + point.min(points.len() - 1)] }
    }

    /// Distance along a lane of its point nearest to a position, metres.
    fn project(&self, lane: usize, position: Point) -> f64 {
        let points = self.map.points_of(&self.map.features[lane]);
        let gap = |p: &[f64; 3]| distance([p[0], p[1]], position);
        let nearest = (0..points.len()).min_by(|a, b| gap(&points[*a]).total_cmp(&gap(&points[*b])));
        nearest.map_or(0.0, |k| self.arc(lane, k))
    }

    /// The route to a lane that starts at a distance. `stop` is the first stop line before the lane, if any.
    /// Stop lines behind the target are left out.
    fn route(&self, lane: usize, distance: f64, changes: u8, stop: Option<f64>) -> Reach {
        let own = || self.stops[lane].map(|along| distance + along).filter(|stop| *stop >= 0.0);
        Reach { distance, changes, stop: stop.or_else(own) }
    }

    /// Pushes the lanes that follow a lane or lie beside it.
    fn expand(&self, lane: usize, route: Reach, reach: &[Option<Reach>], heap: &mut BinaryHeap<Step>) {
        let Some(links) = self.map.features[lane].lane.as_deref() else { return };
        let mut push = |lane: usize, distance: f64, changes: u8| {
            let known = self.map.features.get(lane).is_some_and(|f| f.kind.is_motor_lane());
            if known && distance <= LONGEST && reach[lane].is_none() {
                let cost = distance + f64::from(changes) * CHANGE_COST;
                heap.push(Step { cost, lane, route: self.route(lane, distance, changes, route.stop) });
            }
        };
        for &exit in &links.exits {
            push(exit, route.distance + self.arc(lane, usize::MAX), route.changes);
        }
        if route.changes == CHANGES {
            return;
        }
        for Neighbor { lane: other, own, other: range } in links.neighbors.iter().flatten() {
            // Sources that list only ids leave the range of points at 0. The range is then the whole lane.
            let end = if own[1] == 0 { usize::MAX } else { own[1] };
            // The whole range may lie behind the target.
            if route.distance + self.arc(lane, end) > 0.0 {
                let shift = self.arc(lane, own[0]) - self.arc(*other, range[0]);
                push(*other, route.distance + shift, route.changes + 1);
            }
        }
    }

    /// Lanes that the target is on, with its distance along each.
    fn starts(&self, index: &SceneIndex, position: Point, heading: f64) -> Vec<(usize, f64)> {
        let lanes = index.motor_lanes();
        let segments = lanes.segments();
        let mut found: Vec<(f64, usize, f64)> = Vec::new();
        for k in lanes.near(&Aabb::around(position, SEARCH)).flatten() {
            let segment = &segments[k];
            let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
            let share = segment.nearest_share(position);
            let gap = distance(position, segment.at(share));
            if gap <= SEARCH && wrap_angle(dy.atan2(dx) - heading).abs() <= ALIGNED {
                found.push((gap, k, share));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let limit = found.first().map_or(0.0, |nearest| BESIDE.max(nearest.0));
        let mut visited = HashSet::new();
        found
            .into_iter()
            .filter(|(gap, k, _)| *gap <= limit && visited.insert(segments[*k].feature))
            .map(|(_, k, share)| {
                let lane = segments[k].feature as usize;
                (lane, self.project(lane, segments[k].a) + share * distance(segments[k].a, segments[k].b))
            })
            .collect()
    }
}
