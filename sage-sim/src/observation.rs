//! The observation of a learning driver: 101 numbers in [0, 1].
//!
//! | numbers | content |
//! | --- | --- |
//! | 0–29 | distances to solid lines, 30 beams, counter-clockwise from the left, of 50 m |
//! | 30 | heading against the route |
//! | 31 | speed of 80 km/h |
//! | 32 | steering |
//! | 33, 34 | steering and throttle of an action |
//! | 35 | yaw rate |
//! | 36–47 | distances to all lines, 12 beams, counter-clockwise from the left, of 50 m |
//! | 48–52 | next checkpoint: forward and left of 50 m; three constants |
//! | 53–57 | checkpoint after it, likewise |
//! | 58 | distance across the route of 10 m, 1 on the right |
//! | 59–70 | the three nearest vehicles: position of 50 m, relative velocity of 80 km/h, forward and left |
//! | 71–100 | distances to road users, 30 beams, counter-clockwise from ahead, of 50 m |

mod described;

use std::{f64::consts::TAU, sync::LazyLock};

use sage_core::{
    geometry::{Point, cross, dot, sub, wrap_angle},
    motion::DT,
};
use serde::{Deserialize, Serialize};

use crate::{
    body::{Body, BodyKind},
    lines::LineKind,
    navigation::Navigation,
    observation::described::described,
    rays,
    route::{Coordinates, Localization, Route},
    route_lights::state,
    scene::SimScene,
    traffic::speed_limit,
    vehicle::{Action, Motion},
    world::World,
};

/// Length of an observation.
pub const LENGTH: usize = 101;
/// Where an observation other than MetaDrive's has the last steering and throttle, −1 to 1 scaled to 0 to 1.
pub const LAST_ACTION: [usize; 2] = [33, 34];
/// Reach of all detectors, metres.
const REACH: f64 = 50.0;
/// Distances of the points of the route that lie ahead, metres.
const AHEAD: [f64; 2] = [30.0, 50.0];
/// Beams of the side detector and of the lidar.
const BEAMS: usize = 30;
/// Beams of the lane-line detector.
const LINE_BEAMS: usize = 12;
/// Vehicles that are described one by one.
const NEAREST: usize = 3;
/// Speed that fills the scale, km/h.
const FULL_SPEED: f64 = 80.0;
/// Kilometres an hour in a metre a second.
const KMH: f64 = 3.6;

/// Which 101 numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObservationKind {
    /// The numbers say what they name: steering of the whole range, the action just taken, the signed yaw rate
    /// (1 rad/s fills the scale), and an absent neighbour is 50 m ahead at the own velocity.
    #[default]
    Corrected,
    /// As `Corrected`, but with what scripted policies see: the route goes on along the lanes beyond the end of the
    /// recording, by 200 m at most; the beams to solid lines meet road edges too; the constants make room for the
    /// route 30 and 50 m ahead, the speed limit, and the distance to the next red light on the route; and the three
    /// vehicles are the road user ahead on the route and the two others that come closest within 4 s.
    Continued,
    /// As in MetaDrive 0.3: steering divided by 60, the action before the last one, the absolute yaw rate,
    /// zeros for an absent neighbour.
    MetaDrive,
}

impl ObservationKind {
    /// The route that the numbers refer to.
    pub fn route(self, scene: &SimScene) -> &Route {
        match self {
            Self::Continued => scene.guide(),
            Self::Corrected | Self::MetaDrive => scene.route(),
        }
    }
}

/// The car from which a world is seen.
#[derive(Clone, Copy)]
pub struct Seat<'a> {
    /// The world.
    pub world: &'a World,
    /// Its motion.
    pub motion: &'a Motion,
    /// Its motion one step ago.
    pub before: &'a Motion,
    /// Its route.
    pub route: &'a Route,
    /// All other road users.
    pub others: &'a [Body],
    /// Height of the ground under it, metres.
    pub ground: f64,
}

impl<'a> Seat<'a> {
    /// The ego's, for a kind of observation.
    pub fn of_ego(world: &'a World, kind: ObservationKind) -> Self {
        Self {
            world,
            motion: world.motion(),
            before: world.motion_before(),
            route: kind.route(world.scene()),
            others: world.bodies(),
            ground: world.level(),
        }
    }

    fn is_level(&self, height: f64) -> bool {
        self.world.are_level(height, self.ground)
    }
}

/// What an observation is of, besides the world.
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a> {
    /// The drive so far.
    pub driving: &'a Driving,
    /// Which numbers.
    pub kind: ObservationKind,
}

impl Observed<'_> {
    /// The numbers.
    pub fn numbers(self, world: &World) -> Box<[f32; LENGTH]> {
        let mut numbers = Box::new([0.0; LENGTH]);
        observe(&Seat::of_ego(world, self.kind), self.driving, self.kind, &mut numbers);
        numbers
    }
}

/// An observation that is computed when it is asked for.
pub struct LaterObservation {
    world: World,
    driving: Driving,
    kind: ObservationKind,
}

impl LaterObservation {
    /// The observation of a world.
    pub(crate) fn new(world: World, Observed { driving, kind }: Observed) -> Self {
        Self { world, driving: *driving, kind }
    }

    /// The numbers.
    pub fn numbers(&self) -> Box<[f32; LENGTH]> {
        Observed { driving: &self.driving, kind: self.kind }.numbers(&self.world)
    }
}

/// What each number of an observation is; a policy's file states them.
pub fn names(kind: ObservationKind) -> Vec<String> {
    let vehicle = ["forward", "left", "relative speed forward", "relative speed left"];
    let checkpoint = ["forward", "left", "0", "0.5", "0.5"];
    let route = if kind == ObservationKind::Continued { "the continued route" } else { "the route" };
    let line = if kind == ObservationKind::Continued { "solid line or edge" } else { "solid line" };
    let mut names: Vec<String> = (0..BEAMS).map(|k| format!("{line} at {}°", 90 + 12 * k)).collect();
    let own = [
        "heading against the route",
        "speed of 80 km/h",
        "steering",
        "last steering",
        "last throttle",
        "yaw rate",
    ];
    names.extend(own.map(|name| name.replace("the route", route)));
    names.extend((0..LINE_BEAMS).map(|k| format!("line at {}°", 90 + 30 * k)));
    let others = ["speed limit of 80 km/h", "next red light on the route of 50 m"];
    for (k, other) in (1..=2).zip(others) {
        let named = checkpoint.map(|what| format!("checkpoint {k}: {what}"));
        if kind == ObservationKind::Continued {
            let point = ["forward", "left"].map(|what| format!("route in {} m: {what}", AHEAD[k - 1]));
            names.extend(named.into_iter().take(2).chain(point).chain([other.to_owned()]));
        } else {
            names.extend(named);
        }
    }
    names.push(format!("across {route}"));
    if kind == ObservationKind::Continued {
        let ahead = ["gap", "left", "relative speed forward", "relative speed left"];
        names.extend(ahead.map(|what| format!("road user ahead on the route: {what}")));
        names.extend(
            (1..NEAREST).flat_map(|k| vehicle.map(|what| format!("road user {k} to come close: {what}"))),
        );
    } else {
        names.extend((1..=NEAREST).flat_map(|k| vehicle.map(|what| format!("vehicle {k}: {what}"))));
    }
    names.extend((0..BEAMS).map(|k| format!("road user at {}°", 12 * k)));
    names
}

/// Turns an observation into that of the mirror image of the same scene: left and right change places. The same car, seen with
/// its steering turned around, drives the mirror image. This takes no memory, and equals the drive in the mirrored scene
/// (tested). Exact but for [`ObservationKind::Corrected`] aside of the route: as in MetaDrive, a car 2 m to the right of it
/// keeps its checkpoints, one to the left does not.
pub fn mirror(numbers: &mut [f32; LENGTH]) {
    // A beam to the left of the axis becomes one to the right.
    let beams = |numbers: &mut [f32], own: usize| {
        let count = numbers.len();
        let before = numbers.to_vec();
        for (k, x) in numbers.iter_mut().enumerate() {
            *x = before[(2 * count + own - k) % count];
        }
    };
    // The first line beam points to the left, the first of the lidar ahead: see `lines` and `lidar`.
    beams(&mut numbers[..BEAMS], BEAMS / 2);
    beams(&mut numbers[36..36 + LINE_BEAMS], LINE_BEAMS / 2);
    beams(&mut numbers[71..], 0);
    let sideways = [30, 32, 33, 35, 49, 54, 58].into_iter();
    // Where an observation has them, the points of the route ahead; a constant of 0.5 stays what it is.
    let sideways = sideways.chain([51, 56]);
    let of_vehicles = (0..NEAREST).flat_map(|k| [60 + 4 * k, 62 + 4 * k]);
    sideways.chain(of_vehicles).for_each(|k| numbers[k] = 1.0 - numbers[k]);
}

/// What an observation needs besides the world.
#[derive(Clone, Copy, Debug)]
pub struct Driving {
    /// Actions of the last step and of the one before it.
    pub actions: [Action; 2],
    /// Place on the route.
    pub navigation: Navigation,
    /// Motion for which the navigation numbers are given.
    pub navigated: Motion,
    /// Number of steps since the start.
    pub step: usize,
    /// Whether the car is replayed: MetaDrive then gives a yaw rate of 0.
    pub is_replayed: bool,
}

impl Driving {
    /// At the start of a drive that is observed in some way.
    pub fn start(kind: ObservationKind, route: &Route, how: Localization, motion: &Motion) -> Self {
        let keeps_aside = kind != ObservationKind::Continued;
        let navigation = Navigation::start(route, how, motion.position, keeps_aside);
        let actions = [Action::default(); 2];
        Self { actions, navigation, navigated: *motion, step: 0, is_replayed: false }
    }

    /// After a step with an action, which led to a motion.
    pub fn advance(&mut self, action: Action, route: &Route, how: Localization, motion: &Motion) {
        self.actions = [action, self.actions[0]];
        self.navigated = *motion;
        self.navigation.update(route, how, motion.position);
        self.step += 1;
    }
}

/// Unit vectors of 12° and 30° beams.
static BEAM_TABLES: LazyLock<([Point; BEAMS], [Point; LINE_BEAMS])> = LazyLock::new(|| {
    let unit = |k: usize, n: usize| {
        let (sin, cos) = (k as f64 * TAU / n as f64).sin_cos();
        [cos, sin]
    };
    (std::array::from_fn(|k| unit(k, BEAMS)), std::array::from_fn(|k| unit(k, LINE_BEAMS)))
});

/// Writes the observation of a car.
pub fn observe(seat: &Seat, driving: &Driving, kind: ObservationKind, out: &mut [f32; LENGTH]) {
    let (sin, cos) = seat.motion.heading.sin_cos();
    let axis = [cos, sin];
    let mut write = |at: usize, value: f64| out[at] = (value as f32).clamp(0.0, 1.0);
    lines(seat, axis, kind, &mut write);
    own(seat, driving, kind, &mut write);
    navigation(seat.route, driving, kind, &mut write);
    if kind == ObservationKind::Continued {
        ahead(seat, driving, axis, &mut write);
    }
    described(seat, driving, axis, kind, &mut write);
    lidar(seat, axis, kind, &mut write);
}

fn turned(axis: Point, beam: Point) -> Point {
    [axis[0] * beam[0] - axis[1] * beam[1], axis[1] * beam[0] + axis[0] * beam[1]]
}

/// Beams to lines; the first points to the left.
fn lines(seat: &Seat, axis: Point, kind: ObservationKind, write: &mut impl FnMut(usize, f64)) {
    let (beams, line_beams) = &*BEAM_TABLES;
    let left = [-axis[1], axis[0]];
    let (world, from) = (seat.world, seat.motion.position);
    let lines = world.scene().lines(world.options().lines);
    let pieces = lines.pieces();
    let cast = |beam: Point, is_seen: fn(LineKind) -> bool| {
        let direction = turned(left, beam);
        let hit = |k: usize, nearest: f64| {
            let piece = &pieces[k];
            if !is_seen(piece.kind) || !seat.is_level(piece.height) {
                return None;
            }
            rays::to_box(from, direction, &piece.area).filter(|distance| *distance < nearest)
        };
        lines.grid().cast(from, direction, REACH, hit) / REACH
    };
    let is_solid: fn(LineKind) -> bool = match kind {
        ObservationKind::Continued => |kind| kind != LineKind::Broken,
        _ => |kind| matches!(kind, LineKind::SolidWhite | LineKind::SolidYellow),
    };
    for (k, beam) in beams.iter().enumerate() {
        write(k, cast(*beam, is_solid));
    }
    for (k, beam) in line_beams.iter().enumerate() {
        write(36 + k, cast(*beam, |kind| kind != LineKind::Edge));
    }
}

/// Numbers of the car itself.
fn own(seat: &Seat, driving: &Driving, kind: ObservationKind, write: &mut impl FnMut(usize, f64)) {
    let Seat { motion, route, .. } = *seat;
    let along = match kind {
        ObservationKind::MetaDrive => route.locate(motion.position, Localization::MetaDrive).along,
        _ => route.locate(motion.position, Localization::Nearest).along,
    };
    let direction = route.direction_metadrive(along);
    let (sin, cos) = motion.heading.sin_cos();
    // Sine of the heading against the route.
    let sine = cross(direction, [cos, sin]);
    write(30, 0.5 - 0.5 * sine);
    write(31, (motion.speed() * KMH + 1.0) / (FULL_SPEED + 1.0));
    let scaled = |x: f64| 0.5 * (x + 1.0);
    let [last, before] = driving.actions;
    let yaw_rate = wrap_angle(motion.heading - seat.before.heading) / DT;
    match kind {
        ObservationKind::Corrected | ObservationKind::Continued => {
            write(32, scaled(last.steer));
            write(33, scaled(last.steer));
            write(34, scaled(last.throttle));
            write(35, scaled(yaw_rate));
        }
        ObservationKind::MetaDrive => {
            write(32, scaled(last.steer / 60.0));
            write(33, scaled(before.steer));
            write(34, scaled(before.throttle));
            write(35, if driving.is_replayed { 0.0 } else { yaw_rate.abs() });
        }
    }
}

fn navigation(route: &Route, driving: &Driving, kind: ObservationKind, write: &mut impl FnMut(usize, f64)) {
    let numbers = driving.navigation.numbers(route, &driving.navigated);
    for (k, [forward, left]) in numbers.into_iter().enumerate() {
        for (offset, value) in [forward, left, 0.0, 0.5, 0.5].into_iter().enumerate() {
            write(48 + 5 * k + offset, value);
        }
    }
    let is_unknown = kind == ObservationKind::MetaDrive && driving.step == 0;
    let across = if is_unknown { 0.0 } else { driving.navigation.at.across };
    write(58, 0.5 * (across / 20.0 + 1.0));
}

/// What lies ahead on the route: two of its points, the speed limit, the next red light. In place of constants.
fn ahead(seat: &Seat, driving: &Driving, axis: Point, write: &mut impl FnMut(usize, f64)) {
    let (world, position) = (seat.world, seat.motion.position);
    let along = driving.navigation.at.along;
    for (at, distance) in [(50, AHEAD[0]), (55, AHEAD[1])] {
        let point = seat.route.point(Coordinates { along: along + distance, across: 0.0 });
        let d = sub(point, position);
        for (k, x) in [dot(d, axis), cross(axis, d)].into_iter().enumerate() {
            write(at + k, 0.5 * (x / REACH + 1.0));
        }
    }
    let scene = world.scene();
    write(52, speed_limit(scene, position).map_or(1.0, |limit| limit * KMH / FULL_SPEED));
    let lights = scene.lights();
    let is_red = |light| state(scene.scene(), light, world.step_count()).is_red();
    let mut stops = lights.stops().iter().filter(|stop| stop.along > along && is_red(stop.light));
    write(57, stops.next().map_or(1.0, |stop| (stop.along - along) / REACH));
}

/// Beams to road users; the first points ahead.
fn lidar(seat: &Seat, axis: Point, kind: ObservationKind, write: &mut impl FnMut(usize, f64)) {
    let from = seat.motion.position;
    let (beams, _) = &*BEAM_TABLES;
    let directions: [Point; BEAMS] = std::array::from_fn(|k| turned(axis, beams[k]));
    let mut nearest = [REACH; BEAMS];
    for body in seat.others {
        let radius = body.area.radius();
        let d = sub(body.area.center, from);
        if dot(d, d) > (REACH + radius) * (REACH + radius) || !seat.is_level(body.ground) {
            continue;
        }
        if kind == ObservationKind::MetaDrive && (body.kind == BodyKind::Object || body.is_falling) {
            continue;
        }
        for (direction, nearest) in directions.iter().zip(&mut nearest) {
            if cross(*direction, d).abs() > radius || dot(*direction, d) < -radius {
                continue;
            }
            let hit = match body.disc() {
                Some(radius) => rays::to_disc(from, *direction, body.area.center, radius),
                None => rays::to_box(from, *direction, &body.area),
            };
            *nearest = nearest.min(hit.unwrap_or(REACH));
        }
    }
    for (k, distance) in nearest.into_iter().enumerate() {
        write(71 + k, distance / REACH);
    }
}
