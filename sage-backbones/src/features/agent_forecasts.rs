//! Forecasts of all other agents from what is known *now*.
//!
//! A vehicle on a lane follows it under three acceleration profiles; at forks it takes the exit that turns
//! least. Any other moving agent drives straight on under the same profiles. A standing agent stays. A
//! network's forecast of the ego ([`EgoForecast`]) replaces the ego's modes.

use sage_core::{
    geometry::{Aabb, Point, distance, wrap_angle},
    motion::{DT, HORIZON, NOW, Trajectory},
    scene::{Map, Scene, SceneIndex, Track, TrackKind},
};

use super::{
    Frame,
    acceleration_profile::{ACCELERATION_PROFILES, AccelerationProfile},
};

/// Steps of 0.1 s from one forecast step to the next.
pub const STRIDE: usize = 4;
/// Number of forecast steps.
pub const FORECAST_STEPS: usize = HORIZON / STRIDE;
/// Maximum number of background agents, the nearest first.
const OTHERS: usize = 32;
/// An agent below this speed counts as standing, m/s.
const STANDING: f64 = 0.5;
/// Maximum distance of a vehicle from the middle of the lane that it follows, metres.
const BESIDE: f64 = 2.5;
/// Maximum angle between a vehicle and the lane that it follows, radians.
const ALIGNED: f64 = 0.5;
/// Maximum number of lane segments along one mode.
const MOST_SEGMENTS: usize = 4096;

/// One mode of an agent's forecast, target frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ForecastMode {
    /// Its probability.
    pub weight: f32,
    /// Half of its length and width, metres.
    pub half: [f32; 2],
    /// Whether the agent stands *now*. It then stays at its position.
    pub stands: bool,
    /// Centre and direction (cos, sin) at each forecast step.
    pub poses: [[f32; 4]; FORECAST_STEPS],
}

/// A forecast of the ego: modes with log-probabilities, the likeliest first.
#[derive(Clone, Debug)]
pub struct EgoForecast(Vec<(f32, Trajectory)>);

impl EgoForecast {
    /// A forecast from log-probabilities and trajectories, world frame.
    pub fn new(modes: Vec<(f32, Trajectory)>) -> Self {
        Self(modes)
    }

    /// Log-probability and trajectory of each mode.
    pub fn modes(&self) -> impl Iterator<Item = (f32, &Trajectory)> {
        self.0.iter().map(|(log_prob, trajectory)| (*log_prob, trajectory))
    }
}

/// Forecasts of the ego and of the background agents.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AgentForecasts {
    /// Modes of the ego, the likeliest first; empty if the ego is the target or not valid *now*.
    pub ego: Vec<ForecastMode>,
    /// Modes of the background agents that are valid *now*, the nearest agent first. A standing agent has one
    /// mode, a moving one three.
    pub others: Vec<ForecastMode>,
}

impl AgentForecasts {
    /// Forecasts for one target.
    pub(super) fn of(
        scene: &Scene,
        index: &SceneIndex,
        target: usize,
        frame: &Frame,
        forecast: Option<&EgoForecast>,
    ) -> Self {
        let is_other = |k: usize| k != target && scene.tracks[k].is_valid(NOW);
        let modes = |k: usize| lane_forecast(scene, index, &scene.tracks[k], frame);
        let gap = |k: &usize| distance(scene.tracks[*k].point(NOW), frame.origin());
        let mut others: Vec<usize> =
            (0..scene.tracks.len()).filter(|&k| k != scene.ego && is_other(k)).collect();
        others.sort_by(|a, b| gap(a).total_cmp(&gap(b)).then(a.cmp(b)));
        others.truncate(OTHERS);
        let ego = if is_other(scene.ego) { modes(scene.ego) } else { Vec::new() };
        Self {
            ego: forecast.and_then(|forecast| network_forecast(&ego, forecast, frame)).unwrap_or(ego),
            others: others.into_iter().flat_map(modes).collect(),
        }
    }

    /// The forecasts of the mirrored scene.
    pub(super) fn mirrored(&self) -> Self {
        let mut mirror = self.clone();
        for mode in mirror.ego.iter_mut().chain(&mut mirror.others) {
            for pose in &mut mode.poses {
                pose[1] = -pose[1];
                pose[3] = -pose[3];
            }
        }
        mirror
    }
}

/// The ego's modes from a network's forecast; `None` if the forecast is empty or the ego is not valid.
fn network_forecast(
    lane_forecast: &[ForecastMode],
    forecast: &EgoForecast,
    frame: &Frame,
) -> Option<Vec<ForecastMode>> {
    let known = lane_forecast.first()?;
    let (half, stands, [_, _, cos, sin]) = (known.half, known.stands, known.poses[0]);
    let total: f32 = forecast.modes().map(|(p, _)| p.exp()).sum();
    let mode = |(p, trajectory): (f32, &Trajectory)| {
        let point = |step: usize| frame.frame_from_world(trajectory.points()[step]).map(|x| x as f32);
        let (mut last, mut axis) = (point(0), [cos, sin]);
        let mut poses = [[0.0; 4]; FORECAST_STEPS];
        for (step, pose) in poses.iter_mut().enumerate() {
            let at = point((step + 1) * STRIDE - 1);
            let [dx, dy] = [at[0] - last[0], at[1] - last[1]];
            let length = dx.hypot(dy);
            // A standing agent keeps its direction.
            if length > 0.1 {
                axis = [dx / length, dy / length];
            }
            *pose = [at[0], at[1], axis[0], axis[1]];
            last = at;
        }
        ForecastMode { weight: p.exp() / total, half, stands, poses }
    };
    (total > 0.0 && total.is_finite()).then(|| forecast.modes().map(mode).collect())
}

/// Modes of an agent along its lane, or straight on without a lane; the likeliest first.
fn lane_forecast(scene: &Scene, index: &SceneIndex, track: &Track, frame: &Frame) -> Vec<ForecastMode> {
    let (start, velocity) = (track.point(NOW), track.velocity[NOW]);
    let speed = velocity[0].hypot(velocity[1]).min(super::FASTEST);
    let stands = speed < STANDING;
    let follows = track.kind == TrackKind::Vehicle && !stands;
    let lane = follows.then(|| OnLane::at(scene, index, start, track.heading[NOW])).flatten();
    let heading = if stands { track.heading[NOW] } else { velocity[1].atan2(velocity[0]) };
    let (sin, cos) = heading.sin_cos();
    let half = [track.size[NOW][0], track.size[NOW][1]].map(|size| (0.5 * size) as f32);
    let mode = |profile: AccelerationProfile| {
        let mut lane = lane.clone();
        let (mut driven, mut poses) = (0.0, [[0.0; 4]; FORECAST_STEPS]);
        for (step, pose) in poses.iter_mut().enumerate() {
            let far = if stands { 0.0 } else { profile.distance(speed, ((step + 1) * STRIDE) as f64 * DT) };
            let (position, heading) = match &mut lane {
                Some(lane) => lane.drive(far - driven),
                None => ([start[0] + far * cos, start[1] + far * sin], heading),
            };
            driven = far;
            let (sin, cos) = (heading - frame.heading()).sin_cos();
            let [x, y] = frame.frame_from_world(position);
            *pose = [x as f32, y as f32, cos as f32, sin as f32];
        }
        ForecastMode { weight: profile.weight, half, stands, poses }
    };
    if stands {
        vec![mode(AccelerationProfile::CONSTANT_SPEED)]
    } else {
        ACCELERATION_PROFILES.map(mode).into()
    }
}

/// A position on a lane, which moves along this lane and the lanes that follow.
#[derive(Clone)]
struct OnLane<'m> {
    map: &'m Map,
    lane: usize,
    /// Segment of the lane and metres along it.
    segment: usize,
    along: f64,
    /// Metres left of the middle.
    offset: f64,
    /// Segments that may still be passed. Without this limit, a ring of lanes of length zero would not end.
    left: usize,
}

impl<'m> OnLane<'m> {
    /// The position on the nearest motor lane whose direction agrees with a vehicle's heading.
    fn at(scene: &'m Scene, index: &SceneIndex, position: Point, heading: f64) -> Option<Self> {
        let lanes = index.motor_lanes();
        let mut best: Option<(f64, usize, f64)> = None;
        for k in lanes.near(&Aabb::around(position, BESIDE)).flatten() {
            let segment = &lanes.segments()[k];
            let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
            if wrap_angle(dy.atan2(dx) - heading).abs() > ALIGNED {
                continue;
            }
            let share = segment.nearest_share(position);
            let gap = distance(position, segment.at(share));
            if gap <= BESIDE && best.is_none_or(|(least, ..)| gap < least) {
                best = Some((gap, k, share));
            }
        }
        let (_, k, share) = best?;
        let segment = &lanes.segments()[k];
        let lane = segment.feature as usize;
        let map = &*scene.map;
        let points = map.points_of(&map.features[lane]);
        let first = points
            .windows(2)
            .position(|w| [w[0][0], w[0][1]] == segment.a && [w[1][0], w[1][1]] == segment.b)?;
        let [dx, dy] = [segment.b[0] - segment.a[0], segment.b[1] - segment.a[1]];
        let length = dx.hypot(dy).max(1e-9);
        let offset = (dx * (position[1] - segment.a[1]) - dy * (position[0] - segment.a[0])) / length;
        Some(Self { map, lane, segment: first, along: share * length, offset, left: MOST_SEGMENTS })
    }

    /// Moves along the lanes by some metres; returns the new position and the lane's heading.
    fn drive(&mut self, metres: f64) -> (Point, f64) {
        self.along += metres;
        loop {
            let points = self.map.points_of(&self.map.features[self.lane]);
            let (a, b) = (points[self.segment], points[self.segment + 1]);
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            let length = (dx * dx + dy * dy).sqrt();
            if self.along > length && self.left > 0 {
                self.left -= 1;
                if self.segment + 2 < points.len() {
                    self.along -= length;
                    self.segment += 1;
                    continue;
                }
                if let Some(next) = self.straight_on([dx, dy]) {
                    self.along -= length;
                    (self.lane, self.segment) = (next, 0);
                    continue;
                }
            }
            let heading = dy.atan2(dx);
            let (cos, sin) = if length > 0.0 { (dx / length, dy / length) } else { (1.0, 0.0) };
            let position =
                [a[0] + self.along * cos - self.offset * sin, a[1] + self.along * sin + self.offset * cos];
            return (position, heading);
        }
    }

    /// The exit that turns least over its whole length.
    fn straight_on(&self, [dx, dy]: Point) -> Option<usize> {
        let links = self.map.features[self.lane].lane.as_deref()?;
        let heading = dy.atan2(dx);
        let turn = |lane: &usize| {
            let points = self.map.points_of(&self.map.features[*lane]);
            let [a, b] = [points[points.len() - 2], points[points.len() - 1]];
            wrap_angle((b[1] - a[1]).atan2(b[0] - a[0]) - heading).abs()
        };
        let known = |lane: &usize| {
            self.map.features.get(*lane).is_some_and(|f| f.kind.is_motor_lane() && f.points.len() > 1)
        };
        let exits = links.exits.iter().copied().filter(known);
        exits.min_by(|a, b| turn(a).total_cmp(&turn(b)))
    }
}
