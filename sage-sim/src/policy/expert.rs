//! Rule-based expert: keeps to its route at the speed of the traffic, and brakes as hard as it must.
//!
//! It forecasts the others at constant speed and yaw rate from now, and itself by the bicycle model along the
//! route under several accelerations. It takes the highest acceleration, up to the one that its speed
//! controller asks for, under which no box meets another within the forecast. Contacts from behind do not make
//! it brake. A red light on its route ([`crate::red_lights`]) is a barrier at the stop point. It uses no recording
//! and no plan.

use sage_core::{
    geometry::{Aabb, OrientedBox, distance, norm},
    motion::{DT, State},
    registry::Entry,
    statistics::quantile,
};
use serde::{Deserialize, Serialize};

use super::minded_lights::{Braking, RedLights, RedStop};
use super::{Driver, EgoPolicy, Start, View, forecast::Forecast, pid::Pid, steering};
use crate::{
    Error,
    body::{Body, BodyKind},
    route::{Coordinates, Localization, Route},
    traffic::speed_limit,
    vehicle::Action,
    world::Control,
};

/// Gains of the speed controller (of the published autopilot), and the command of full throttle.
const SPEED_GAINS: [f64; 3] = [5.0, 0.5, 1.0];
const FULL_COMMAND: f64 = 5.0;
/// Distance within which the speeds of others are taken, metres, and their largest distance across the route.
const PERCEPTION: [f64; 2] = [20.0, 2.4];
/// Range of the target speed from the traffic, m/s.
const TRAFFIC_SPEEDS: [f64; 2] = [5.0, 25.0];
/// Deceleration before curves, m/s².
const CURVE_BRAKING: f64 = 2.0;
/// Boxes farther apart than this cannot meet within the forecast, metres.
const FARTHEST: f64 = 120.0;
/// Distance by which a reach may be wrong without any effect, metres: far more than rounding.
const SLACK: f64 = 0.01;

/// Length and width of the barrier that stands for a red light, metres: a car cannot drive through within a step.
const BARRIER: [f64; 2] = [3.0, 3.0];

/// The policy `expert`.
#[derive(Clone, Debug, Default)]
pub struct Expert(ExpertOptions);

/// Options of [`Expert`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExpertOptions {
    /// Length of the forecast, s.
    pub forecast: f64,
    /// Accelerations that are tried, from the strongest braking to none, m/s².
    pub brakes: Vec<f64>,
    /// Speed on a free road without a limit, m/s.
    pub free_speed: f64,
    /// Lateral acceleration in curves, m/s².
    pub curves: f64,
    /// Space kept around the own box: ahead, and at each side, metres.
    pub margins: [f64; 2],
    /// Whether it stops at red lights on its route, if the strongest of `brakes` suffices.
    pub red_lights: bool,
}

impl Default for ExpertOptions {
    fn default() -> Self {
        Self {
            forecast: 4.0,
            brakes: vec![-8.0, -6.0, -4.5, -3.0, -2.0, -1.0],
            free_speed: 15.0,
            curves: 2.5,
            margins: [1.5, 0.2],
            red_lights: true,
        }
    }
}

impl Entry<dyn EgoPolicy> for Expert {
    const NAME: &'static str = "expert";
    const SUMMARY: &'static str =
        "rule-based driver: forecasts everybody from now, brakes as hard as it must";
    const SOURCE: &'static str = "this project, after the rule-based autopilot of CARLA";
    type Options = ExpertOptions;

    fn build(options: ExpertOptions) -> Result<Box<dyn EgoPolicy>, String> {
        if !(options.forecast > 0.0 && options.forecast <= 10.0) {
            return Err(format!("`forecast` is {}; expected seconds above 0, at most 10", options.forecast));
        }
        if options.brakes.is_empty() || options.brakes.iter().any(|a| !(*a < 0.0 && a.is_finite())) {
            return Err(format!("`brakes` is {:?}; expected numbers below 0, at least one", options.brakes));
        }
        let speeds = [("free_speed", options.free_speed), ("curves", options.curves)];
        if let Some((name, value)) =
            speeds.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite()))
        {
            return Err(format!("`{name}` is {value}; expected a number above 0"));
        }
        if options.margins.iter().any(|margin| !(*margin >= 0.0 && margin.is_finite())) {
            return Err(format!("`margins` is {:?}; expected metres, at least 0", options.margins));
        }
        Ok(Box::new(Self(options)))
    }
}

impl EgoPolicy for Expert {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        let options = self.0.clone();
        let strongest = options.brakes.iter().copied().fold(0.0, f64::min);
        let braking = Braking { deceleration: -strongest, lag: 2.0 * DT };
        let red_lights = options.red_lights.then(|| RedLights::new(braking));
        Ok(Box::new(ExpertDriver { options, speed: Pid::new(SPEED_GAINS), red_lights }))
    }
}

#[derive(Clone)]
struct ExpertDriver {
    options: ExpertOptions,
    speed: Pid,
    red_lights: Option<RedLights>,
}

impl Driver for ExpertDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let (route, motion, car) = (view.route(), view.motion(), view.car());
        let at = route.locate(motion.position, Localization::Nearest);
        let speed = motion.body_velocity()[0].max(0.0);
        let target = self.target_speed(view, route, at.along);
        let command = self.speed.output(target - speed) / FULL_COMMAND;
        let wanted =
            if command > 0.0 { command.min(1.0) * car.full_throttle() } else { command.max(-1.0) * 3.0 };
        let stop = self.red_lights.as_mut().and_then(|lights| lights.stop(view));
        let acceleration = self.safe_acceleration(view, wanted, stop);
        Ok(Control::Drive(Action {
            steer: steering::along(car, motion, route, at.along, 0.0),
            throttle: car.throttle_for(acceleration),
        }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl ExpertDriver {
    /// Speed of the traffic around, the limit of the lane, or the speed of a free road; less in sharp turns.
    fn target_speed(&self, view: &View, route: &Route, along: f64) -> f64 {
        let [reach, aside] = PERCEPTION;
        let near = view.others().filter(|other| {
            other.kind == BodyKind::Vehicle
                && other.speed() > 0.5
                && distance(other.area.center, view.motion().position) <= reach
                && route.locate(other.area.center, Localization::Nearest).across.abs() < aside
        });
        let speeds: Vec<f64> = near.map(Body::speed).collect();
        let limit = speed_limit(view.scene(), view.motion().position).unwrap_or(self.options.free_speed);
        let target = match quantile(&speeds, 0.75) {
            Some(traffic) => traffic.clamp(TRAFFIC_SPEEDS[0], TRAFFIC_SPEEDS[1]).min(limit),
            None => limit,
        };
        target.min(steering::curve_speed(route, along, self.options.curves, CURVE_BRAKING))
    }

    /// The highest acceleration up to `wanted` under which no contact is forecast, nor one with a barrier at the red
    /// light; the strongest braking if there is none.
    fn safe_acceleration(&self, view: &View, wanted: f64, red: Option<RedStop>) -> f64 {
        let steps = (self.options.forecast / DT).round() as usize;
        let position = view.motion().position;
        let within_reach = Aabb::around(position, self.reach(view, wanted));
        let near = view.others().filter(|other| distance(other.area.center, position) < FARTHEST);
        let forecasts = near.map(|other| Forecast::of(other, steps));
        let light = red.map(|stop| Forecast::standing(barrier(view.route(), stop), steps));
        // Others that the car cannot reach under any of the accelerations do not matter.
        let others: Vec<Forecast> =
            forecasts.chain(light).filter(|other| other.bounds.meets(&within_reach)).collect();
        if others.is_empty() {
            return wanted;
        }
        let mut brakes: Vec<f64> = self.options.brakes.iter().copied().filter(|a| *a < wanted).collect();
        brakes.sort_by(f64::total_cmp);
        brakes.extend((wanted > 0.0).then_some(0.0));
        brakes.push(wanted);
        let mut safe = brakes.iter().rev().copied();
        safe.find(|a| !self.meets(view, &others, *a, steps)).unwrap_or(brakes[0])
    }

    /// Distance from the car's position within which its box stays in the forecast, with margins, metres.
    fn reach(&self, view: &View, wanted: f64) -> f64 {
        // One step more than the forecast leaves room for rounding.
        let time = self.options.forecast + DT;
        let speed = view.motion().body_velocity()[0].max(0.0);
        let [ahead, aside] = self.options.margins;
        let area = view.area();
        let around = area.half_length + ahead + area.half_width + aside;
        speed * time + 0.5 * wanted.max(0.0) * time * time + around + SLACK
    }

    /// Whether the own box, with margins, meets another within the forecast, other than from behind.
    fn meets(&self, view: &View, others: &[Forecast], acceleration: f64, steps: usize) -> bool {
        let (route, car) = (view.route(), view.car());
        let bicycle = steering::bicycle(car);
        let motion = view.motion();
        let mut state = State {
            position: motion.position,
            heading: motion.heading,
            speed: motion.body_velocity()[0].max(0.0),
        };
        let [ahead, aside] = self.options.margins;
        let half = [view.area().half_length, view.area().half_width];
        let (mut sin, mut cos) = state.heading.sin_cos();
        let mut leg = 0;
        for step in 1..=steps {
            let place = route.locate_near(state.position, &mut leg).along;
            let ahead_on_route = place + steering::look_ahead(norm([state.speed, 0.0]));
            let target = route.point_near(Coordinates { along: ahead_on_route, across: 0.0 }, leg);
            let steer = steering::from_pose(car, state.position, [cos, sin], target) * car.max_steering;
            state = bicycle.step(&state, steer, acceleration, DT);
            // The margin ahead shrinks with the speed, so that the car can close up and stop.
            let front = ahead * (state.speed / 5.0).min(1.0);
            (sin, cos) = state.heading.sin_cos();
            let [x, y] = state.position;
            let center = [x + 0.5 * front * cos, y + 0.5 * front * sin];
            let own = OrientedBox {
                center,
                axis: [cos, sin],
                half_length: half[0] + 0.5 * front,
                half_width: half[1] + aside,
            };
            let bounds = own.aabb();
            for other in others {
                // Bounds first: the boxes of a forecast that is never near are not worked out.
                if !other.bounds.meets(&bounds) {
                    continue;
                }
                let other = other.at(step);
                if own.center_distance(other) > own.radius() + other.radius() || !own.intersects(other) {
                    continue;
                }
                let [x, y] = own.box_from_world(other.center);
                let is_behind = x < -0.4 * 2.0 * half[0] && y.abs() < half[1] + other.half_width;
                if !is_behind {
                    return true;
                }
            }
        }
        false
    }
}

/// A barrier across the route that begins at the stop point.
fn barrier(route: &Route, stop: RedStop) -> OrientedBox {
    let [length, width] = BARRIER;
    let center = route.point(Coordinates { along: stop.along + 0.5 * length, across: 0.0 });
    OrientedBox::new(center, route.heading(stop.along), length, width)
}
