//! Who ran over red. [`crate::route_lights`] says which lights are on a route, and drivers which they mind.
//!
//! Red is [`LightState::Stop`](sage_core::scene::LightState::Stop), full or as an arrow, at the frame in question. Unknown,
//! yellow and flashing lights are not red.

use sage_core::{
    geometry::{OrientedBox, Point, norm, sub},
    motion::DT,
    scene::Scene,
};

use crate::{
    route::{Localization, Route},
    route_lights::{RouteLights, StopPlace, state},
    scene::SimScene,
    vehicle::Motion,
};

/// A car that is slower than this does not run over red, m/s.
pub(crate) const CREEPING: f64 = 0.5;
/// Farthest that a car beside its route still passes the stop point, metres: a lane to each side.
const BESIDE: f64 = 6.0;

/// Middle of the front bumper.
pub fn front(area: &OrientedBox) -> Point {
    let ([x, y], [cos, sin]) = (area.center, area.axis);
    [x + area.half_length * cos, y + area.half_length * sin]
}

/// Steps at which the ego ran over red. `motions` are those of a drive from frame 0 on. `None` if no stop point lies ahead of
/// the ego at the start, so that it cannot run over one.
pub fn over_red(scene: &SimScene, motions: &[Motion]) -> Option<Vec<usize>> {
    let [length, width] = scene.ego_size();
    let area = |motion: &Motion| OrientedBox::new(motion.position, motion.heading, length, width);
    let boxes: Vec<OrientedBox> = motions.iter().map(area).collect();
    crossed_red(scene.scene(), scene.lights(), scene.guide(), &boxes, 0)
}

/// Steps at which a car with these boxes, from frame `first` on, ran over red: its front bumper crossed a stop point on its
/// route at more than 0.5 m/s, and the light was red at the frame before. `None` without a stop point ahead at the start.
pub(crate) fn crossed_red(
    scene: &Scene,
    lights: &RouteLights,
    route: &Route,
    boxes: &[OrientedBox],
    first: usize,
) -> Option<Vec<usize>> {
    let place = |area: &OrientedBox| route.locate(front(area), Localization::Nearest);
    let mut before = place(boxes.first()?);
    let mut ahead: Vec<&StopPlace> = lights.stops().iter().filter(|stop| stop.along > before.along).collect();
    if ahead.is_empty() {
        return None;
    }
    let mut steps = Vec::new();
    for (step, pair) in boxes.windows(2).enumerate().map(|(k, pair)| (first + k + 1, pair)) {
        let now = place(&pair[1]);
        let way = norm(sub(pair[1].center, pair[0].center));
        // Where a route meets itself, the nearest point may jump to another part of it.
        let is_jump = now.along - before.along > 2.0 * way + 1.0;
        let is_passed = |stop: &&StopPlace| now.along >= stop.along;
        if !is_jump && now.across.abs() <= BESIDE && way > CREEPING * DT {
            let is_red = |stop: &&&StopPlace| state(scene, stop.light, step - 1).is_red();
            let crossed = ahead.iter().filter(|stop| is_passed(stop) && before.along < stop.along);
            steps.extend(crossed.filter(is_red).take(1).map(|_| step));
        }
        if !is_jump {
            ahead.retain(|stop| !is_passed(stop));
        }
        before = now;
    }
    Some(steps)
}
