//! Predictive driver: several ways to drive along the route are simulated against a forecast of the others, and the
//! one with the best score is driven.
//!
//! This is the planner of the nuPlan challenge (PDM-Closed) for maps that have centre lines and road edges in place of
//! lane polygons. Every step it follows three paths (the route, and a metre to each side) at five speeds, by car
//! following against a forecast at constant velocity; drives each with nuPlan's tracker for four seconds; scores
//! contacts at fault, edges, direction, progress, time to collision and comfort; and hands the first command of the
//! best one to the car. `docs/simulation.md` lists what differs from the published planner.

mod comfort;
mod others;
mod path;
mod proposals;
mod score;
mod surroundings;
pub(super) mod tracker;

use std::sync::Arc;

use sage_core::{
    geometry::{Aabb, Point, dot, norm, sub},
    motion::DT,
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use super::minded_lights::{Braking, RedLights};
use super::{Driver, EgoPolicy, Start, View};
use crate::{Error, route::Coordinates, traffic::DESIRED_SPEED, vehicle::Action, world::Control};
use others::Other;
use path::Path;
use proposals::{BRAKE, Outset, Proposal, STEPS, Shape};
use score::{Drive, Scored, Scorer};
use tracker::{Bicycle, Command, Driven, Reference, track};

/// Largest distance of a lane whose speed limit counts, metres, and least cosine of the angle to it (30°).
const LIMIT_REACH: f64 = 2.0;
const LIMIT_ALONG: f64 = 0.866_025_403_784_438_6;
/// Emergency braking: time to a contact at fault, seconds; speed up to which it is published, m/s; its range of
/// accelerations, m/s².
const EMERGENCY_STEPS: usize = 20;
const EMERGENCY_SPEED: f64 = 5.0;
const EMERGENCY_RANGE: [f64; 2] = [-4.05, 2.40];

/// Braking at red lights: the tracker looks a second ahead, and takes 10/11 of the difference of the speeds there. So it
/// brakes by 10/11 of the 3 m/s² of the proposals, and at the end by 10/11 of its speed a second.
const STOPPING: Braking = Braking { deceleration: 3.0 / 1.1, lag: 1.1 };

/// The policy `pdm`.
#[derive(Clone, Debug, Default)]
pub struct Pdm(PdmOptions);

/// Options of [`Pdm`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PdmOptions {
    /// Whether braking to a stop at 8 m/s² is proposed too, on each path. The published proposals brake by at most
    /// 3 m/s².
    pub brake: bool,
    /// Whether the emergency brake works at any speed, with 8 m/s². The published one works up to 5 m/s.
    pub any_speed: bool,
    /// Lateral acceleration in curves, m/s²: a lower target speed before and in them. `null`, as published, for no
    /// limit.
    pub curves: Option<f64>,
    /// Whether four traits of the published code are kept: every proposal starts with a step behind a standing leader,
    /// one that has a road user ahead may keep the length of a path's end, and those behind whose forecast passes
    /// through the car become its leaders, and the desired gap may be negative. Speeds may then fall below 0.
    pub as_published: bool,
    /// Whether it stops at red lights on its route, if the 3 m/s² of its car following suffice.
    pub red_lights: bool,
}

impl Default for PdmOptions {
    fn default() -> Self {
        Self { brake: false, any_speed: false, curves: Some(2.5), as_published: false, red_lights: true }
    }
}

impl Entry<dyn EgoPolicy> for Pdm {
    const NAME: &'static str = "pdm";
    const SUMMARY: &'static str = "predictive driver: simulates 15 ways to go on, drives the best-scored one";
    const SOURCE: &'static str = "PDM-Closed, Dauner et al. (2023), for maps without lane polygons";
    type Options = PdmOptions;

    fn build(options: PdmOptions) -> Result<Box<dyn EgoPolicy>, String> {
        if let Some(lateral) = options.curves.filter(|lateral| !(*lateral > 0.0)) {
            return Err(format!("`curves` is {lateral}; expected m/s² above 0, or null"));
        }
        Ok(Box::new(Self(options)))
    }
}

impl EgoPolicy for Pdm {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        let options = self.0.clone();
        let red_lights = options.red_lights.then(|| RedLights::new(STOPPING));
        let (ignored, steering) = (Vec::new(), 0.0);
        Ok(Box::new(PdmDriver { options, paths: None, ignored, steering, speed: None, red_lights }))
    }
}

#[derive(Clone)]
struct PdmDriver {
    options: PdmOptions,
    /// Made at the first step.
    paths: Option<Arc<[Path; 3]>>,
    /// Tracks that the car touched: they are never looked at again.
    ignored: Vec<usize>,
    /// Angle of the front wheels, rad.
    steering: f64,
    /// Speed at the step before, m/s.
    speed: Option<f64>,
    red_lights: Option<RedLights>,
}

/// What the driver looks at in a step.
struct Seen<'a> {
    others: &'a [Other],
    /// Stop point of the red light ahead.
    stop: Option<Point>,
}

impl Driver for PdmDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let curves = self.options.curves;
        let paths = self.paths.get_or_insert_with(|| Arc::new(Path::all(view.route(), curves))).clone();
        for body in view.others().filter(|body| body.touches(&body.area, view.area())) {
            if !self.ignored.contains(&body.track) {
                self.ignored.push(body.track);
            }
        }
        let car = view.car();
        let bicycle = Bicycle { wheelbase: car.front + car.rear, max_steering: car.max_steering };
        let others = others::in_view(view, &self.ignored);
        let start = self.state(view);
        let red = self.red_lights.as_mut().and_then(|lights| lights.stop(view));
        let stop = red.map(|stop| view.route().point(Coordinates { along: stop.along, across: 0.0 }));
        let plan = self.plan(view, &paths, Seen { others: &others, stop }, &bicycle, &start);
        let after = start.after(&bicycle, &plan);
        (self.steering, self.speed) = (after.steering, Some(start.speed));
        Ok(Control::Drive(Action {
            steer: after.steering / car.max_steering,
            throttle: car.throttle_for(plan.acceleration),
        }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl PdmDriver {
    /// The state of the car. Its acceleration is that of the last step.
    fn state(&self, view: &View) -> Driven {
        let (motion, rear) = (view.motion(), view.car().rear);
        let (sin, cos) = motion.heading.sin_cos();
        let [x, y] = view.area().center;
        let speed = motion.body_velocity()[0].max(0.0);
        Driven {
            axle: [x - rear * cos, y - rear * sin],
            heading: motion.heading,
            speed,
            acceleration: self.speed.map_or(0.0, |before| (speed - before) / DT),
            steering: self.steering,
        }
    }

    /// The first command of the best proposal, or of the emergency brake.
    fn plan(
        &self,
        view: &View,
        paths: &[Path; 3],
        Seen { others, stop }: Seen,
        bicycle: &Bicycle,
        start: &Driven,
    ) -> Command {
        let half = [view.area().half_length, view.area().half_width];
        let shape = Shape { half, rear: view.car().rear };
        let outset = Outset {
            axle: start.axle,
            speed: start.speed,
            limit: speed_limit(view),
            shape,
            others,
            stop,
            as_published: self.options.as_published,
        };
        let mut proposals = proposals::proposals(paths, &outset);
        if self.options.brake {
            proposals.extend(proposals::stops(paths, &outset));
        }
        let references: Vec<Vec<Reference>> =
            proposals.iter().map(|proposal| proposal.references(&paths[proposal.path])).collect();
        let command = |k: usize, state: &Driven, step: usize| {
            let tracked = track(bicycle, state, &references[k], step);
            let acceleration = if proposals[k].brakes { -BRAKE } else { tracked.acceleration };
            Command { acceleration, ..tracked }
        };
        let driven = |k: usize| {
            let (mut states, mut areas) = (Vec::with_capacity(STEPS + 1), Vec::with_capacity(STEPS + 1));
            let mut state = *start;
            for step in 0..=STEPS {
                let axis = state.axis();
                states.push(state);
                areas.push(shape.area(state.axle, axis));
                if step < STEPS {
                    state = state.after_along(bicycle, &command(k, &state, step), axis);
                }
            }
            Drive::new(states, areas)
        };
        let drives: Vec<Drive> = (0..proposals.len()).map(driven).collect();
        let scores = Scorer { view, shape, others, center: &paths[0] }.scores(&drives);
        let best = best(&proposals, &scores);
        let first = command(best, start, 0);
        let is_due = scores[best].at_fault.is_some_and(|step| step <= EMERGENCY_STEPS);
        if is_due && self.options.any_speed {
            return Command { acceleration: first.acceleration.min(-BRAKE), ..first };
        }
        if is_due && start.speed <= EMERGENCY_SPEED && !proposals[best].brakes {
            return emergency(bicycle, start);
        }
        first
    }
}

/// The proposal with the best score, the first of equals. If all are 0, it is a stop on the centre path if there is
/// one.
fn best(proposals: &[Proposal], scores: &[Scored]) -> usize {
    let mut best = proposals.iter().position(|proposal| proposal.brakes).unwrap_or(0);
    let mut value = 0.0;
    for (k, score) in scores.iter().enumerate() {
        if score.value > value {
            (best, value) = (k, score.value);
        }
    }
    best
}

/// The published emergency brake: straight on at a constant speed, which the tracker approaches.
fn emergency(bicycle: &Bicycle, state: &Driven) -> Command {
    let [low, high] = EMERGENCY_RANGE;
    let speed = if state.speed > 0.2 {
        1.1 * (state.speed + (-10.0 * state.speed).clamp(low, high))
    } else {
        (-4.0 * state.speed - state.acceleration).clamp(low, high)
    };
    let straight = Reference { position: state.axle, heading: state.heading, speed, curvature: 0.0 };
    track(bicycle, state, &[straight], 0)
}

/// The largest limit of the lanes at the car and along its heading, m/s.
fn speed_limit(view: &View) -> f64 {
    let (index, own) = (view.index(), view.area());
    let lanes = index.motor_lanes();
    let around = Aabb::around(own.center, LIMIT_REACH);
    let limits = lanes.near(&around).flatten().filter_map(|k| {
        let segment = &lanes.segments()[k];
        let limit = index.map().features[segment.feature as usize].lane.as_ref()?.speed_limit?;
        let direction: Point = sub(segment.b, segment.a);
        let away = norm(sub(own.center, segment.at(segment.nearest_share(own.center))));
        let is_own = away <= LIMIT_REACH && dot(direction, own.axis) >= LIMIT_ALONG * norm(direction);
        (is_own && limit > 0.0).then_some(limit)
    });
    limits.reduce(f64::max).unwrap_or(DESIRED_SPEED)
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn the_emergency_brake_is_the_published_one() {
        let bicycle = Bicycle { wheelbase: 3.089, max_steering: 1.0 };
        for (speed, acceleration) in [(5.0, -3.5955), (1.0, -3.9591)] {
            let state = Driven { axle: [0.0; 2], heading: 0.3, speed, acceleration: 0.0, steering: 0.0 };
            let command = emergency(&bicycle, &state);
            assert_relative_eq!(command.acceleration, acceleration, epsilon = 1e-3);
            assert_relative_eq!(command.rate, 0.0, epsilon = 1e-12);
        }
    }

    #[test]
    fn the_first_of_equal_scores_wins() {
        let line: Vec<Point> = (0..60).map(|k| [f64::from(k), 0.0]).collect();
        let paths = Path::all(&crate::route::Route::new(&line), None);
        let shape = Shape { half: [2.3, 1.0], rear: 1.4 };
        let others = [];
        let outset = Outset {
            axle: [0.0; 2],
            speed: 5.0,
            limit: 10.0,
            shape,
            others: &others,
            stop: None,
            as_published: false,
        };
        let mut all = proposals::proposals(&paths, &outset);
        assert_eq!(all.len(), 15);
        let scores = |values: &[f64]| -> Vec<Scored> {
            values.iter().map(|value| Scored { value: *value, at_fault: None }).collect()
        };
        let mut values = vec![0.0; 15];
        assert_eq!(best(&all, &scores(&values)), 0);
        (values[3], values[7]) = (0.5, 0.5);
        assert_eq!(best(&all, &scores(&values)), 3);
        all.extend(proposals::stops(&paths, &outset));
        // Without a way to go on, it stops on the centre path.
        assert_eq!(best(&all, &scores(&[0.0; 18])), 15);
    }
}
