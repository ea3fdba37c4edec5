//! The road users that an observation describes one by one.

use sage_core::geometry::{OrientedBox, Point, cross, dot, sub};

use crate::{
    body::{Body, BodyKind},
    following::{Follower, leader},
    observation::{Driving, FULL_SPEED, KMH, NEAREST, ObservationKind, REACH, Seat},
    vehicle::SUBSTEP,
};

/// How far ahead an approach counts, seconds.
const HORIZON: f64 = 4.0;
/// A moment that is a second later counts as this much more distance, metres.
const LATER: f64 = 1.0;

/// Writes the numbers of three road users: by [`ObservationKind::Continued`] the one ahead on the route and the two others
/// that come closest if all keep their velocities, else the nearest vehicles.
pub(super) fn described(
    seat: &Seat,
    driving: &Driving,
    axis: Point,
    kind: ObservationKind,
    write: &mut impl FnMut(usize, f64),
) {
    let described = match kind {
        ObservationKind::Continued => by_importance(seat, driving, axis),
        _ => nearest(seat, kind).map(|body| body.map(|body| numbers(seat, axis, body))),
    };
    for (k, described) in described.into_iter().enumerate() {
        let numbers = match described {
            Some(numbers) => numbers.map(|x| 0.5 * (x + 1.0)),
            None if kind == ObservationKind::MetaDrive => [0.0; 4],
            None => [1.0, 0.5, 0.5, 0.5],
        };
        for (offset, value) in numbers.into_iter().enumerate() {
            write(59 + 4 * k + offset, value);
        }
    }
}

/// Position over the reach and relative velocity over the full speed, forward and left each.
fn numbers(seat: &Seat, axis: Point, body: &Body) -> [f64; 4] {
    let [forward, left] = local(axis, sub(body.area.center, seat.motion.position)).map(|x| x / REACH);
    let speed = local(axis, sub(body.velocity, seat.motion.velocity)).map(|v| v * KMH / FULL_SPEED);
    [forward, left, speed[0], speed[1]]
}

fn local(axis: Point, v: Point) -> [f64; 2] {
    [dot(v, axis), cross(axis, v)]
}

/// The first elements by a key that rises, in order; of equal ones the earlier.
fn least<'a, const N: usize>(bodies: impl Iterator<Item = (f64, &'a Body)>) -> [Option<(f64, &'a Body)>; N] {
    let mut found = [None; N];
    for body in bodies {
        let mut carried = Some(body);
        for slot in &mut found {
            let Some((key, _)) = carried else { break };
            if slot.is_none_or(|(other, _): (f64, &Body)| key < other) {
                std::mem::swap(slot, &mut carried);
            }
        }
    }
    found
}

/// The nearest vehicles, by the distance of their centres.
fn nearest<'a>(seat: &Seat<'a>, kind: ObservationKind) -> [Option<&'a Body>; NEAREST] {
    let position = seat.motion.position;
    let vehicles =
        seat.others.iter().filter(|body| body.kind == BodyKind::Vehicle && seat.is_level(body.ground));
    let seen = vehicles.filter(|body| {
        // MetaDrive detects neighbours in the last substep, before traffic is set to the frame.
        let area = match kind {
            ObservationKind::MetaDrive => body.coasted(-SUBSTEP),
            _ => body.area,
        };
        distance_to(&area, position) <= REACH
    });
    let keyed = seen.map(|body| {
        let d = sub(body.area.center, position);
        (dot(d, d), body)
    });
    least(keyed).map(|found| found.map(|(_, body)| body))
}

/// The road user ahead on the route, its gap in place of the distance forward, and the two others that come closest.
fn by_importance(seat: &Seat, driving: &Driving, axis: Point) -> [Option<[f64; 4]>; NEAREST] {
    let position = seat.motion.position;
    let bodies = seat.others;
    let is_near = |body: &Body| {
        let d = sub(body.area.center, position);
        dot(d, d) <= REACH * REACH && seat.is_level(body.ground)
    };
    let at = driving.navigation.at;
    let half = seat.world.size().map(|size| 0.5 * size);
    let ahead = bodies.iter().enumerate().filter(|(_, body)| is_near(body));
    // A car that lies behind in a straight line is not the next one on the route.
    let ahead = ahead.filter(|(_, body)| dot(sub(body.area.center, position), axis) > -half[0]);
    let ahead = ahead.map(|(k, body)| (k, &body.area, body.velocity));
    let follower = Follower { along: at.along, across: at.across, half };
    let leader = leader(seat.route, follower, ahead);
    let first = leader.map(|(k, leader)| {
        let [_, left, forward_speed, left_speed] = numbers(seat, axis, &bodies[k]);
        [leader.gap.clamp(-REACH, REACH) / REACH, left, forward_speed, left_speed]
    });
    let others = bodies
        .iter()
        .enumerate()
        .filter(|(k, body)| leader.is_none_or(|(led, _)| led != *k) && is_near(body));
    let closest = least(others.map(|(_, body)| (approach(seat, body), body)));
    let [second, third] = closest.map(|found| found.map(|(_, body)| numbers(seat, axis, body)));
    [first, second, third]
}

/// Least distance of the centres at constant velocities, later moments counting as farther.
fn approach(seat: &Seat, body: &Body) -> f64 {
    let d = sub(body.area.center, seat.motion.position);
    let v = sub(body.velocity, seat.motion.velocity);
    let speed = dot(v, v);
    let moment = if speed > 0.0 { (-dot(d, v) / speed).clamp(0.0, HORIZON) } else { 0.0 };
    let least = [d[0] + v[0] * moment, d[1] + v[1] * moment];
    dot(least, least).sqrt() + LATER * moment
}

/// Distance of a point to a box, metres; 0 inside.
fn distance_to(area: &OrientedBox, p: Point) -> f64 {
    let [x, y] = area.box_from_world(p);
    let out = [x.abs() - area.half_length, y.abs() - area.half_width].map(|d| d.max(0.0));
    dot(out, out).sqrt()
}
