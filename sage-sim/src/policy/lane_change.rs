//! Lane changes by MOBIL (Kesting et al., 2007): change if it is safe for the new follower, and if the gain of
//! all concerned exceeds a threshold.
//!
//! The car leaves its route only for a lane that runs parallel to the one it is in, and returns before that
//! lane ends.

use sage_core::{
    geometry::{Point, distance, dot},
    motion::DT,
    motion::idm::{Idm, Leader},
    scene::{Map, MapFeature},
};
use serde::{Deserialize, Serialize};

use super::View;
use crate::{
    body::Body,
    following::{Follower, areas, leader},
    route::{Coordinates, Localization, Route},
};

/// Options of MOBIL.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MobilOptions {
    /// Weight of the gains of others.
    pub politeness: f64,
    /// Largest deceleration that a change may ask of the new follower, m/s².
    pub safe_braking: f64,
    /// Least gain of a change, m/s².
    pub threshold: f64,
}

impl Default for MobilOptions {
    fn default() -> Self {
        Self { politeness: 0.3, safe_braking: 4.0, threshold: 0.1 }
    }
}

/// Lateral speed of a lane change, m/s.
const LATERAL_SPEED: f64 = 1.0;
/// Least length for which the other lane must still run parallel, metres …
const LEAST_AHEAD: f64 = 20.0;
/// … and least time, s.
const LEAST_TIME: f64 = 5.0;
/// Largest distance of the lane that the car is in, metres.
const LANE_REACH: f64 = 2.5;
/// Distances across at which two lanes count as neighbours, metres.
const LANE_WIDTHS: [f64; 2] = [2.0, 6.0];
/// Steps between two decisions.
const DECISION_STEPS: usize = 10;
/// Slower cars do not change lanes, m/s.
const LEAST_SPEED: f64 = 3.0;
/// Reach of the search for followers, metres.
const FOLLOWER_REACH: f64 = 60.0;

impl MobilOptions {
    /// Checks the ranges.
    pub(super) fn check(&self) -> Result<(), String> {
        let Self { politeness, safe_braking, threshold } = *self;
        let least = [("politeness", politeness), ("safe_braking", safe_braking), ("threshold", threshold)];
        match least.into_iter().find(|(_, value)| !(*value >= 0.0 && value.is_finite())) {
            Some((name, value)) => {
                Err(format!("`lane_changes.{name}` is {value}; expected a number, at least 0"))
            }
            None => Ok(()),
        }
    }
}

/// State of a driver's lane changes.
#[derive(Clone, Copy, Debug)]
pub(super) struct LaneChange {
    options: MobilOptions,
    /// Offset of the target lane from the route, positive to the right, metres.
    target: f64,
    /// Offset that is driven now.
    current: f64,
    /// Whether the lane beside the route ends ahead and the way back is occupied: the car must stop.
    is_stuck: bool,
}

impl LaneChange {
    pub(super) fn new(options: MobilOptions) -> Self {
        Self { options, target: 0.0, current: 0.0, is_stuck: false }
    }

    /// Offset from the route to drive at now, metres.
    pub(super) fn offset(&mut self, view: &View, model: &Idm, at: Coordinates) -> f64 {
        let speed = view.motion().speed();
        let is_settled = (self.current - self.target).abs() < 1e-9;
        let is_away = self.target != 0.0;
        if is_settled && view.step().is_multiple_of(DECISION_STEPS) && (is_away || speed > LEAST_SPEED) {
            self.decide(view, model, at, speed);
        }
        let step = LATERAL_SPEED * DT;
        self.current += (self.target - self.current).clamp(-step, step);
        self.current
    }

    /// Distance in which the car must stop, because its lane ends, metres.
    pub(super) fn stop(&self) -> Option<f64> {
        self.is_stuck.then_some(LEAST_AHEAD)
    }

    fn decide(&mut self, view: &View, model: &Idm, at: Coordinates, speed: f64) {
        let ahead = LEAST_AHEAD.max(LEAST_TIME * speed);
        let parallel = parallel_lanes(view, at, ahead);
        if self.target != 0.0 {
            // Away from the route: back before the lane ends, or if that is better.
            let stays = parallel.iter().any(|lane| (lane - self.target).abs() < LANE_WIDTHS[0])
                || runs_beside(view, at, self.target, ahead);
            let others: Vec<Body> = view.others().copied().collect();
            let gain = self.gain(view, model, at, 0.0, &others);
            let is_safe = self.is_safe(view, model, at, 0.0, &others);
            self.is_stuck = !stays && !is_safe;
            if (!stays && is_safe) || gain.is_some_and(|gain| gain > self.options.threshold) {
                self.target = 0.0;
            }
            return;
        }
        if parallel.is_empty() {
            return;
        }
        let others: Vec<Body> = view.others().copied().collect();
        let gains =
            parallel.into_iter().filter_map(|lane| Some((lane, self.gain(view, model, at, lane, &others)?)));
        let best =
            gains.filter(|(_, gain)| *gain > self.options.threshold).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((lane, _)) = best {
            self.target = lane;
        }
    }

    fn is_safe(&self, view: &View, model: &Idm, at: Coordinates, lane: f64, others: &[Body]) -> bool {
        let place = Place { view, model, others, at };
        place.is_free(lane)
            && place
                .follower(lane)
                .is_none_or(|(k, gap)| place.behind_own(k, gap) >= -self.options.safe_braking)
    }

    /// Gain of a change in MOBIL's sense, m/s²; `None` if it is not safe.
    fn gain(&self, view: &View, model: &Idm, at: Coordinates, lane: f64, others: &[Body]) -> Option<f64> {
        if !self.is_safe(view, model, at, lane, others) {
            return None;
        }
        let place = Place { view, model, others, at };
        let own = place.own(lane) - place.own(self.target);
        let new = place
            .follower(lane)
            .map_or(0.0, |(k, gap)| place.behind_own(k, gap) - place.without_own(k, lane));
        let old = place
            .follower(self.target)
            .map_or(0.0, |(k, gap)| place.without_own(k, self.target) - place.behind_own(k, gap));
        Some(own + self.options.politeness * (new + old))
    }
}

/// The car among others, for questions about lanes at offsets from its route.
struct Place<'a> {
    view: &'a View<'a>,
    model: &'a Idm,
    others: &'a [Body],
    at: Coordinates,
}

impl Place<'_> {
    fn half(&self) -> [f64; 2] {
        [self.view.area().half_length, self.view.area().half_width]
    }

    /// Own acceleration in a lane.
    fn own(&self, lane: f64) -> f64 {
        let own = Follower { along: self.at.along, across: lane, half: self.half() };
        let ahead = leader(self.view.route(), own, areas(self.others)).map(|(_, leader)| leader);
        self.model.acceleration(self.view.motion().speed(), ahead)
    }

    /// Whether no road user is beside the car in a lane.
    fn is_free(&self, lane: f64) -> bool {
        let route = self.view.route();
        let [half_length, half_width] = self.half();
        !self.others.iter().any(|other| {
            let c = route.locate(other.area.center, Localization::Nearest);
            (c.along - self.at.along).abs() < half_length + other.area.half_length + self.model.standing_gap
                && (c.across - lane).abs() < half_width + other.area.half_width
        })
    }

    /// The nearest vehicle behind in a lane, with its free distance to the car.
    fn follower(&self, lane: f64) -> Option<(usize, f64)> {
        let route = self.view.route();
        let [half_length, half_width] = self.half();
        let behind = self.others.iter().enumerate().filter_map(|(k, other)| {
            if distance(other.area.center, self.view.motion().position) > FOLLOWER_REACH {
                return None;
            }
            let c = route.locate(other.area.center, Localization::Nearest);
            let is_in_lane = (c.across - lane).abs() < half_width + other.area.half_width;
            let gap = self.at.along - c.along - half_length - other.area.half_length;
            (is_in_lane && c.along < self.at.along && speed_along(route, other, c.along) > 0.0)
                .then_some((k, gap))
        });
        behind.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Acceleration of a follower behind the car.
    fn behind_own(&self, follower: usize, gap: f64) -> f64 {
        let body = &self.others[follower];
        let leader = Leader { gap, speed: self.view.motion().speed() };
        self.model.acceleration(body.speed(), Some(leader))
    }

    /// Acceleration of a follower without the car, behind whoever is ahead in its lane.
    fn without_own(&self, follower: usize, lane: f64) -> f64 {
        let body = &self.others[follower];
        let route = self.view.route();
        let along = route.locate(body.area.center, Localization::Nearest).along;
        let path = Follower { along, across: lane, half: [body.area.half_length, body.area.half_width] };
        let ahead = areas(self.others).filter(|(k, ..)| *k != follower);
        self.model.acceleration(body.speed(), leader(route, path, ahead).map(|(_, leader)| leader))
    }
}

fn speed_along(route: &Route, body: &Body, along: f64) -> f64 {
    let heading = route.heading(along);
    dot(body.velocity, [heading.cos(), heading.sin()])
}

/// Offsets of the lanes that run beside the car's lane for a distance ahead.
fn parallel_lanes(view: &View, at: Coordinates, ahead: f64) -> Vec<f64> {
    let (map, lanes, route) = (view.map(), view.index().motor_lanes(), view.route());
    let position = view.motion().position;
    let direction = direction(route, at.along);
    let is_along = |segment: &sage_core::geometry::Segment| {
        dot([segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]], direction) > 0.0
    };
    let Some(near) = lanes.nearest(position, LANE_REACH, is_along) else { return Vec::new() };
    let feature = &map.features[lanes.segments()[near.segment].feature as usize];
    let Some(lane) = &feature.lane else { return Vec::new() };
    let own = nearest_point(map, feature, position);
    let mut offsets = Vec::new();
    for neighbor in lane.neighbors.iter().flatten() {
        let [first, last] = neighbor.own;
        if !(first..=last).contains(&own) || !map.has_points(neighbor.lane, neighbor.other) {
            continue;
        }
        let points = map.points_of(feature);
        if length(&points[own..=last.min(points.len() - 1)]) < ahead {
            continue;
        }
        let other = &map.features[neighbor.lane];
        let [x, y, _] = map.points_of(other)[nearest_point(map, other, position)];
        let offset = route.locate([x, y], Localization::Nearest).across;
        if (LANE_WIDTHS[0]..=LANE_WIDTHS[1]).contains(&(offset - at.across).abs())
            && runs_beside(view, at, offset, ahead)
        {
            offsets.push(offset);
        }
    }
    offsets
}

/// Whether a lane in the route's direction runs at an offset from it, here and for a distance ahead.
fn runs_beside(view: &View, at: Coordinates, offset: f64, ahead: f64) -> bool {
    let (lanes, route) = (view.index().motor_lanes(), view.route());
    [0.0, 0.5, 1.0].into_iter().all(|share| {
        let along = at.along + share * ahead;
        let p = route.point(Coordinates { along, across: offset });
        let direction = direction(route, along);
        let is_along = |segment: &sage_core::geometry::Segment| {
            let d = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
            dot(d, direction) > 0.9 * sage_core::geometry::norm(d)
        };
        lanes.nearest(p, 1.0, is_along).is_some()
    })
}

fn direction(route: &Route, along: f64) -> Point {
    let (sin, cos) = route.heading(along).sin_cos();
    [cos, sin]
}

fn nearest_point(map: &Map, feature: &MapFeature, p: Point) -> usize {
    let points = map.points_of(feature).iter().enumerate();
    points
        .min_by(|a, b| distance([a.1[0], a.1[1]], p).total_cmp(&distance([b.1[0], b.1[1]], p)))
        .map_or(0, |(k, _)| k)
}

fn length(points: &[[f64; 3]]) -> f64 {
    points.windows(2).map(|pair| distance([pair[0][0], pair[0][1]], [pair[1][0], pair[1][1]])).sum()
}
