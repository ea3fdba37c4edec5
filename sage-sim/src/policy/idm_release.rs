//! The car-following policy of MetaDrive's recorded scenes, as published: km/h and metres in one formula, so
//! that it keeps 20 m and stops and goes. Its target is 40 km/h everywhere; it does not change lanes.

use sage_core::{
    geometry::{OrientedBox, distance, dot, wrap_angle},
    registry::{Entry, NoOptions},
};

use super::{Driver, EgoPolicy, Start, View};
use crate::{
    Error,
    route::{Localization, Route},
    vehicle::Action,
    world::Control,
};

/// Target speed, km/h.
const TARGET: f64 = 40.0;
/// Reach of the search for leaders, metres.
const REACH: f64 = 20.0;
/// Half the width of the lane around the route, and its extension at both ends, metres.
const LANE: f64 = 1.0;
/// Gains of the steering: error of the heading, its sum, its change.
const GAINS: [f64; 3] = [1.2, 0.1, 3.5];
/// Kilometres an hour in a metre a second.
const KMH: f64 = 3.6;

/// The policy `idm-release`.
#[derive(Clone, Copy, Debug, Default)]
pub struct IdmRelease;

impl Entry<dyn EgoPolicy> for IdmRelease {
    const NAME: &'static str = "idm-release";
    const SUMMARY: &'static str = "car following as published with MetaDrive: 40 km/h, 20 m, stop and go";
    const SOURCE: &'static str = "MetaDrive 0.3, trajectory IDM policy";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(Self))
    }
}

impl EgoPolicy for IdmRelease {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(IdmReleaseDriver { sum: 0.0, last: 0.0 }))
    }
}

#[derive(Clone, Copy)]
struct IdmReleaseDriver {
    sum: f64,
    last: f64,
}

impl Driver for IdmReleaseDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let (route, motion) = (view.published_route(), view.motion());
        let along = route.locate(motion.position, Localization::MetaDrive).along;
        let error = wrap_angle(route.heading(along + 1.0) - motion.heading);
        self.sum += error;
        let [p, i, d] = GAINS;
        let steer = p * error + i * self.sum + d * (error - self.last);
        self.last = error;
        let speed = motion.speed() * KMH;
        let mut throttle = 1.0 - (speed / TARGET).powi(10);
        if let Some((gap, velocity)) = leader(view, route, along) {
            let (sin, cos) = motion.heading.sin_cos();
            let d = [motion.velocity[0] - velocity[0], motion.velocity[1] - velocity[1]];
            let closing = dot(d, [cos, sin]) * KMH;
            let desired = 10.0 + 1.5 * speed + speed * closing / (2.0 * 5f64.sqrt());
            throttle -= (desired / gap.max(0.01)).powi(2);
        }
        Ok(Control::Drive(Action { steer, throttle }.limited()))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}

/// Distance of the centres along the route, and velocity, of the nearest road user ahead.
fn leader(view: &View, route: &Route, along: f64) -> Option<(f64, [f64; 2])> {
    let near = view.others().filter(|other| distance(other.area.center, view.motion().position) <= REACH);
    let in_lane = near.filter(|other| is_in_lane(route, &other.area));
    let ahead = in_lane.filter_map(|other| {
        let gap = route.locate(other.area.center, Localization::MetaDrive).along - along;
        (gap > 0.0 && gap < REACH).then_some((gap, other.velocity))
    });
    ahead.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Whether a corner of a box lies in the strip around the route.
fn is_in_lane(route: &Route, area: &OrientedBox) -> bool {
    area.corners().iter().any(|corner| {
        let c = route.locate(*corner, Localization::Nearest);
        c.across.abs() <= LANE && (-LANE..=route.length() + LANE).contains(&c.along)
    })
}
