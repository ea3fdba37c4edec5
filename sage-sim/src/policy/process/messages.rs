//! What a planner is told: one line of JSON a message. `docs/your-own-planner.md` describes all fields.

use sage_core::{
    geometry::{Aabb, Point, norm, sub},
    motion::DT,
    scene::{LightState, Map, MapFeature},
};
use serde::{Serialize, Serializer, ser::SerializeSeq};

use crate::{
    body::{Body, BodyKind},
    policy::View,
    route::Route,
    vehicle::Vehicle,
};

/// Version of the protocol.
pub(super) const PROTOCOL: u64 = 1;
/// Numbers are rounded to a billionth: a planner that is the same as one of ours then drives the same to a micrometre.
const DIGITS: f64 = 1e9;

/// A rounded number.
struct Rounded(f64);

impl Serialize for Rounded {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_f64((self.0 * DIGITS).round() / DIGITS)
    }
}

fn rounded<const N: usize>(numbers: [f64; N]) -> [f64; N] {
    numbers.map(|number| (number * DIGITS).round() / DIGITS)
}

/// A message as a line.
fn line<T: Serialize>(name: &str, content: &T) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(1 << 13);
    bytes.extend_from_slice(b"{\"");
    bytes.extend_from_slice(name.as_bytes());
    bytes.extend_from_slice(b"\":");
    // Writing plain values into memory does not fail.
    let _ = serde_json::to_writer(&mut bytes, content);
    bytes.extend_from_slice(b"}\n");
    bytes
}

/// The first message to a program.
pub(super) fn hello() -> Vec<u8> {
    format!("{{\"hello\":{PROTOCOL},\"dt\":{DT}}}\n").into_bytes()
}

#[derive(Serialize)]
struct Reset<'a> {
    scene: &'a str,
    seed: u64,
    route: Line<'a>,
    ego: Car,
    map: Features<'a>,
    lights: Vec<Light<'a>>,
}

/// The car that is driven.
#[derive(Serialize)]
struct Car {
    length: Rounded,
    width: Rounded,
    front_axle: Rounded,
    rear_axle: Rounded,
    max_steering_angle: Rounded,
    max_acceleration: Rounded,
    max_deceleration: Rounded,
    rolling_deceleration: Rounded,
    max_speed: Rounded,
}

impl Car {
    fn of(view: &View) -> Self {
        let (car, area): (&Vehicle, _) = (view.car(), view.area());
        Self {
            length: Rounded(2.0 * area.half_length),
            width: Rounded(2.0 * area.half_width),
            front_axle: Rounded(car.front),
            rear_axle: Rounded(car.rear),
            max_steering_angle: Rounded(car.max_steering),
            max_acceleration: Rounded(car.full_throttle()),
            max_deceleration: Rounded(car.full_brake()),
            rolling_deceleration: Rounded(car.rolling_resistance()),
            max_speed: Rounded(car.max_speed),
        }
    }
}

/// A route as its corner points.
struct Line<'a>(&'a Route);

impl Serialize for Line<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.points().map(rounded))
    }
}

/// A light on the route.
#[derive(Serialize)]
struct Light<'a> {
    lane: &'a str,
    along: Rounded,
}

/// The features of a map that come near a route.
struct Features<'a> {
    map: &'a Map,
    route: &'a Route,
    radius: f64,
}

/// A feature of the map.
#[derive(Serialize)]
struct Feature<'a> {
    id: &'a str,
    #[serde(rename = "type")]
    kind: &'a str,
    points: Vec<[f64; 3]>,
    #[serde(flatten)]
    lane: Option<LaneLinks<'a>>,
}

/// What a lane adds to its points.
#[derive(Serialize)]
struct LaneLinks<'a> {
    speed_limit: Option<Rounded>,
    entries: Vec<&'a str>,
    exits: Vec<&'a str>,
    left: Vec<&'a str>,
    right: Vec<&'a str>,
}

impl Serialize for Features<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let corners: Vec<Point> = self.route.points().collect();
        let legs: Vec<Aabb> =
            corners.windows(2).map(|leg| Aabb::of(leg.iter().copied()).grown(self.radius)).collect();
        let mut seq = serializer.serialize_seq(None)?;
        for feature in self.map.features.iter().filter(|feature| self.is_near(feature, &legs)) {
            seq.serialize_element(&self.feature(feature))?;
        }
        seq.end()
    }
}

impl<'a> Features<'a> {
    /// Whether a segment of a feature, or its only point, comes closer than the radius along both axes.
    fn is_near(&self, feature: &MapFeature, legs: &[Aabb]) -> bool {
        let points = self.map.points_of(feature);
        let meets = |part: &[[f64; 3]]| {
            let part = Aabb::of(part.iter().map(|[x, y, _]| [*x, *y]));
            legs.iter().any(|leg| leg.meets(&part))
        };
        meets(points) && (points.len() == 1 || points.windows(2).any(meets))
    }

    fn feature(&self, feature: &'a MapFeature) -> Feature<'a> {
        let ids = |lanes: &[usize]| -> Vec<&'a str> {
            lanes.iter().filter_map(|k| Some(&*self.map.features.get(*k)?.id)).collect()
        };
        let lane = feature.lane.as_ref().map(|lane| {
            let [left, right] = lane.neighbors.each_ref().map(|side| side.iter().map(|n| n.lane).collect());
            let [left, right]: [Vec<usize>; 2] = [left, right];
            LaneLinks {
                speed_limit: lane.speed_limit.map(Rounded),
                entries: ids(&lane.entries),
                exits: ids(&lane.exits),
                left: ids(&left),
                right: ids(&right),
            }
        });
        let points = self.map.points_of(feature).iter().map(|p| rounded(*p)).collect();
        Feature { id: &feature.id, kind: feature.kind.name(), points, lane }
    }
}

/// The message at the start of a drive. `radius` is the distance from the route within which the map is told, metres.
pub(super) fn reset(view: &View, seed: u64, radius: f64) -> Vec<u8> {
    let scene = view.scene().scene();
    let lights = view.route_lights();
    let lights = lights
        .stops()
        .iter()
        .map(|stop| Light { lane: &scene.lights[stop.light].lane, along: Rounded(stop.along) });
    line(
        "reset",
        &Reset {
            scene: &scene.id,
            seed,
            route: Line(view.route()),
            ego: Car::of(view),
            map: Features { map: view.map(), route: view.route(), radius },
            lights: lights.collect(),
        },
    )
}

#[derive(Serialize)]
struct Step<'a> {
    t: Rounded,
    ego: Ego,
    agents: Vec<Agent<'a>>,
    lights: Vec<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    observation: Option<&'a [f32]>,
}

#[derive(Serialize)]
struct Ego {
    position: [f64; 2],
    heading: Rounded,
    velocity: [f64; 2],
    yaw_rate: Rounded,
}

#[derive(Serialize)]
struct Agent<'a> {
    id: &'a str,
    #[serde(rename = "type")]
    kind: &'static str,
    size: [f64; 2],
    position: [f64; 2],
    heading: Rounded,
    velocity: [f64; 2],
}

fn kind(body: &Body) -> &'static str {
    match body.kind {
        BodyKind::Vehicle => "vehicle",
        BodyKind::Pedestrian => "pedestrian",
        BodyKind::Cyclist => "cyclist",
        BodyKind::Object => "object",
    }
}

fn light(state: LightState) -> &'static str {
    match state {
        LightState::Unknown => "unknown",
        LightState::Stop => "red",
        LightState::Caution => "yellow",
        LightState::Go => "green",
        LightState::FlashingStop => "flashing red",
    }
}

/// The message before a step, with the nearest `most` road users, and with the observation of a learning driver, if it is
/// asked for.
pub(super) fn step(view: &View, most: usize, observation: Option<&[f32]>) -> Vec<u8> {
    let (scene, motion) = (view.scene().scene(), view.motion());
    let distance = |body: &Body| norm(sub(body.area.center, motion.position));
    let mut near: Vec<(f64, &Body)> = view.others().map(|body| (distance(body), body)).collect();
    // The nearest first; of equals the first track.
    near.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let agents = near.into_iter().take(most).map(|(_, body)| Agent {
        id: &scene.tracks[body.track].id,
        kind: kind(body),
        size: rounded([2.0 * body.area.half_length, 2.0 * body.area.half_width]),
        position: rounded(body.area.center),
        heading: Rounded(body.heading),
        velocity: rounded(body.velocity),
    });
    line(
        "step",
        &Step {
            t: Rounded(view.step() as f64 * DT),
            ego: Ego {
                position: rounded(motion.position),
                heading: Rounded(motion.heading),
                velocity: rounded(motion.velocity),
                yaw_rate: Rounded(motion.yaw_rate),
            },
            agents: agents.collect(),
            lights: view.route_lights().stops().iter().map(|stop| light(view.light(stop.light))).collect(),
            observation,
        },
    )
}
