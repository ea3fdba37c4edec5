//! Whether a driver stands without cause: before the end of its recorded route, though neither a road user nor a red light is close
//! ahead.

use crate::{
    body::Body,
    following::{Follower, areas, leader},
    route::{Localization, Route},
    route_lights::state,
    world::World,
};

/// Speed below which a car stands, m/s.
const STANDS: f64 = 0.5;
/// Steps of standing that count.
const LEAST_STEPS: usize = 30;
/// A road user or a red light this close ahead on the route is a cause, metres from the front of the car.
const CAUSE: f64 = 15.0;
/// Distance to the end of the recorded route at which the car has arrived, metres.
const ARRIVED: f64 = 5.0;

/// Counts the steps of a drive in which the car stands without cause.
#[derive(Debug, Default)]
pub(super) struct Standing {
    steps: usize,
    longest: usize,
}

impl Standing {
    /// Adds a step of the ego, which follows a route.
    pub(super) fn count(&mut self, world: &World, route: &Route) {
        let stands = world.motion().speed() < STANDS && !has_cause(world, route);
        self.steps = if stands { self.steps + 1 } else { 0 };
        self.longest = self.longest.max(self.steps);
    }

    /// Whether it stood without cause for 3 s.
    pub(super) fn is_long(&self) -> bool {
        self.longest >= LEAST_STEPS
    }
}

fn has_cause(world: &World, route: &Route) -> bool {
    let half = world.size().map(|size| 0.5 * size);
    let at = route.locate(world.motion().position, Localization::Nearest);
    let recorded = world.scene().route();
    if recorded.locate(world.motion().position, Localization::Nearest).along >= recorded.length() - ARRIVED {
        return true;
    }
    let level: Vec<Body> =
        world.bodies().iter().filter(|body| world.are_level(body.ground, world.level())).copied().collect();
    let follower = Follower { along: at.along, across: at.across, half };
    let front = at.along + half[0];
    let scene = world.scene();
    let lights = scene.lights();
    let is_red = |light| state(scene.scene(), light, world.step_count()).is_red();
    leader(route, follower, areas(&level)).is_some_and(|(_, leader)| leader.gap < CAUSE)
        || lights
            .stops()
            .iter()
            .any(|stop| stop.along > at.along && stop.along - front < CAUSE && is_red(stop.light))
}
