//! The rule-based autopilot behind the published figures. It knows everybody's recorded future and the plan of
//! the adversary; it is only blind to reactions.
//!
//! The published code resets its controllers' windows neither between episodes nor between forecast and
//! drive; here a drive starts with fresh windows and forecasts use copies.

use sage_core::{
    geometry::{OrientedBox, Point, distance, dot, norm, sub, wrap_angle},
    motion::DT,
    registry::{Entry, NoOptions},
    scene::{Track, TrackKind},
    statistics::quantile,
};

use super::{Driver, EgoPolicy, Knowledge, Start, View, pid::Pid};
use crate::{
    Error,
    route::{Coordinates, Localization, Route},
    vehicle::Action,
    world::Control,
};

const LATERAL_GAINS: [f64; 3] = [1.25, 0.75, 0.3];
const SPEED_GAINS: [f64; 3] = [5.0, 0.5, 1.0];
/// Acceleration of the published bicycle at full throttle, and at any brake, m/s².
const ACCELERATION: [f64; 2] = [0.5633837, -4.952399];
/// Steps of the forecast on a straight route, and at an intersection.
const FORECAST: [usize; 2] = [20, 40];
const INTERSECTION: f64 = 0.985;
/// Radius within which the speeds of others count, and their largest distance across the route, metres.
const PERCEPTION: [f64; 2] = [20.0, 2.4];
/// Steering angle at full steering, rad, and distances of the axles, metres, of the published bicycle, which
/// was fitted to another car.
const STEERING: f64 = 0.36848336;
const AXLES: [f64; 2] = [-0.090769015, 1.4178275];

/// The policy `expert-release`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ExpertRelease;

impl Entry<dyn EgoPolicy> for ExpertRelease {
    const NAME: &'static str = "expert-release";
    const SUMMARY: &'static str = "the published autopilot; knows everybody's future";
    const SOURCE: &'static str = "SAGE (ICLR 2026), code: rule-based expert";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(Self))
    }
}

impl EgoPolicy for ExpertRelease {
    fn knows(&self) -> Knowledge {
        Knowledge::Everything
    }

    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(ExpertReleaseDriver { lateral: Pid::new(LATERAL_GAINS), speed: Pid::new(SPEED_GAINS) }))
    }
}

#[derive(Clone)]
struct ExpertReleaseDriver {
    lateral: Pid,
    speed: Pid,
}

/// State of the forecast.
#[derive(Clone, Copy)]
struct Own {
    position: Point,
    heading: f64,
    speed: f64,
}

/// Another road user's box and speed at a step of the forecast.
#[derive(Clone, Copy)]
struct Other {
    area: OrientedBox,
    velocity: Point,
}

impl Driver for ExpertReleaseDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let (route, motion) = (view.published_route(), view.motion());
        let own = Own { position: motion.position, heading: motion.heading, speed: motion.speed() };
        let along = route.locate(own.position, Localization::MetaDrive).along;
        let is_turn = turns(route, along);
        let steps = FORECAST[usize::from(is_turn)];
        let futures = futures(view, steps)?;
        let traffic = traffic_speed(view, route, &futures);
        let desired = traffic.unwrap_or(15.0);
        let predicted = self.forecast(route, own, desired, steps);
        let size = [2.0 * view.area().half_length, 2.0 * view.area().half_width];
        let contact = first_contact(&predicted, &futures, size);
        let target = match contact {
            None if is_turn && traffic.is_none() => desired.min(5.0),
            None => desired,
            Some(contact) => contact.target(own, &futures, size, traffic),
        };
        let steer = lateral(&mut self.lateral, route, own);
        let command = self.speed.output(target - own.speed);
        let throttle = (command / 5.0).clamp(-1.0, 1.0);
        Ok(Control::Drive(Action { steer, throttle }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl ExpertReleaseDriver {
    /// Own states after 1, 2, … steps at the desired speed. The forecast never brakes.
    fn forecast(&self, route: &Route, start: Own, desired: f64, steps: usize) -> Vec<Own> {
        let (mut steer, mut speed) = (self.lateral, self.speed);
        let mut own = start;
        let states = (0..steps).map(|_| {
            let angle = lateral(&mut steer, route, own) * STEERING;
            let throttle = (speed.output(desired - own.speed) / 5.0).clamp(0.0, 1.0);
            own = moved(own, angle, ACCELERATION[0] * throttle);
            own
        });
        states.collect()
    }
}

/// One step of the published bicycle.
fn moved(own: Own, angle: f64, acceleration: f64) -> Own {
    let [front, rear] = AXLES;
    let slip = (rear / (front + rear) * angle.tan()).atan();
    let course = own.heading + slip;
    let [x, y] = own.position;
    Own {
        position: [x + own.speed * course.cos() * DT, y + own.speed * course.sin() * DT],
        heading: wrap_angle(own.heading + own.speed / rear * slip.sin() * DT),
        speed: (own.speed + acceleration * DT).max(0.0),
    }
}

/// Steering towards a point ahead on the route.
fn lateral(pid: &mut Pid, route: &Route, own: Own) -> f64 {
    let along = route.locate(own.position, Localization::MetaDrive).along;
    let ahead = (0.3 * own.speed).clamp(2.0, 15.0);
    let d = sub(route.point(Coordinates { along: along + ahead, across: 0.0 }), own.position);
    pid.output(wrap_angle(d[1].atan2(d[0]) - own.heading)).clamp(-1.0, 1.0)
}

/// Whether the route turns by more than about 10° within 4 m.
fn turns(route: &Route, along: f64) -> bool {
    let at = |ahead: f64| route.point(Coordinates { along: along + ahead, across: 0.0 });
    let unit = |a: Point, b: Point| {
        let d = sub(b, a);
        let length = norm(d).max(1e-9);
        [d[0] / length, d[1] / length]
    };
    dot(unit(at(0.0), at(2.0)), unit(at(2.0), at(4.0))) < INTERSECTION
}

/// Recorded or planned futures of all vehicles and cyclists, from the current frame on.
fn futures(view: &View, steps: usize) -> Result<Vec<Vec<Other>>, Error> {
    let recording =
        view.recording().ok_or_else(|| view.error("expert-release needs the recording".to_owned()))?;
    let now = view.step();
    let mut futures = Vec::new();
    for (k, track) in recording.tracks.iter().enumerate() {
        if k == view.track() || !matches!(track.kind, TrackKind::Vehicle | TrackKind::Cyclist) {
            continue;
        }
        let source = view.plan().filter(|plan| plan.track == k).map_or(track, |plan| &plan.motion);
        if !source.is_valid(now) {
            continue;
        }
        let mut last = state(source, now);
        let states = (0..=steps).map(|step| {
            if source.is_valid(now + step) {
                last = state(source, now + step);
            }
            last
        });
        futures.push(states.collect());
    }
    Ok(futures)
}

fn state(track: &Track, frame: usize) -> Other {
    Other { area: track.oriented_box(frame), velocity: track.velocity[frame] }
}

/// Third quartile of the speeds of the traffic on the route near by.
fn traffic_speed(view: &View, route: &Route, futures: &[Vec<Other>]) -> Option<f64> {
    let [reach, aside] = PERCEPTION;
    let near = futures.iter().map(|states| &states[0]).filter(|other| {
        distance(other.area.center, view.motion().position) <= reach
            && route.locate(other.area.center, Localization::MetaDrive).across.abs() < aside
    });
    let speeds: Vec<f64> = near.map(|other| norm(other.velocity)).filter(|speed| *speed > 0.0).collect();
    quantile(&speeds, 0.75).map(|speed| speed.clamp(5.0, 25.0))
}

/// The first predicted contact.
struct Contact {
    own: Own,
    other: usize,
    area: OrientedBox,
    velocity: Point,
}

fn first_contact(predicted: &[Own], futures: &[Vec<Other>], size: [f64; 2]) -> Option<Contact> {
    // The published code compares the own state after `step + 1` steps with the others' after `step`.
    for (step, &own) in predicted.iter().enumerate() {
        let area = OrientedBox::new(own.position, own.heading, size[0], size[1]);
        for (other, states) in futures.iter().enumerate() {
            let Other { area: theirs, velocity } = states[step];
            let near = size[0] + 2.0 * theirs.half_length + 5.0;
            if distance(theirs.center, own.position) <= near && area.intersects(&theirs) {
                return Some(Contact { own, other, area: theirs, velocity });
            }
        }
    }
    None
}

impl Contact {
    /// Target speed in view of the contact.
    fn target(&self, now: Own, futures: &[Vec<Other>], size: [f64; 2], traffic: Option<f64>) -> f64 {
        let own = OrientedBox::new(self.own.position, self.own.heading, size[0], size[1]);
        let [x, y] = own.box_from_world(self.area.center);
        let limit = 0.6 * size[1] + self.area.half_width;
        let is_rear = x < -0.4 * size[0] && y.abs() < limit;
        let relative = dot(self.velocity, own.axis) - self.own.speed;
        if !(is_rear && relative > 0.5) {
            return 0.0;
        }
        let rear = norm(futures[self.other][0].velocity);
        if !is_clear_ahead(now, futures, size) {
            return rear + 1.0;
        }
        let target = if rear > now.speed { (rear + 2.0).max(15.0) } else { (now.speed + 1.0).max(10.0) };
        traffic.map_or(target, |speed| target.max(0.5 * (target + speed)))
    }
}

/// Whether a straight drive at +1 m/s² meets nobody within ±15° of the heading for 2 s.
fn is_clear_ahead(now: Own, futures: &[Vec<Other>], size: [f64; 2]) -> bool {
    let (mut own, direction) = (now, [now.heading.cos(), now.heading.sin()]);
    for step in 0..20 {
        own = moved(own, 0.0, 1.0);
        let area = OrientedBox::new(own.position, own.heading, size[0], size[1]);
        for states in futures {
            let theirs = &states[step.min(states.len() - 1)].area;
            let d = sub(theirs.center, own.position);
            let is_near = norm(d) <= 2.0 * size[0] + 2.0 * theirs.half_length;
            let is_ahead = dot(d, direction) >= norm(d) * 15f64.to_radians().cos();
            if is_near && is_ahead && area.intersects(theirs) {
                return false;
            }
        }
    }
    true
}
