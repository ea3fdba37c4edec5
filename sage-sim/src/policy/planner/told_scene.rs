//! What a planner is told at the start of a drive.

use std::sync::Arc;

use sage_core::{geometry::Point, scene::TrafficLight};
use serde::{Serialize, Serializer};

use super::{RADIUS, all_rounded, rounded, told_map::Features};
use crate::{
    policy::View, route::Route, route_lanes::route_lanes, route_lights::RouteLights, scene::SimScene,
    vehicle::Vehicle,
};

/// What a planner is told at the start of a drive. It owns what it needs. Numbers are rounded to a billionth.
///
/// It serialises as the message `reset` of the protocol.
pub struct ToldScene {
    scene: Arc<SimScene>,
    route: Route,
    lights: Arc<RouteLights>,
    vehicle: ToldVehicle,
    recorded_length: f64,
    seed: u64,
    asks: Asks,
}

/// What a planner asks for beyond what all are told.
#[derive(Clone, Debug, PartialEq)]
pub struct Asks {
    /// Distance from the route within which the map is told, metres.
    pub radius: f64,
    /// Whether it is told where its recording ends.
    pub goal: bool,
    /// How the planner is to follow its plans, of the ways that it offers.
    pub follow: Option<String>,
}

impl Default for Asks {
    fn default() -> Self {
        Self { radius: RADIUS, goal: false, follow: None }
    }
}

/// The car that is driven.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ToldVehicle {
    /// Length, metres.
    pub length: f64,
    /// Width, metres.
    pub width: f64,
    /// Distance from the centre to the front axle, metres.
    pub front_axle: f64,
    /// Distance from the centre to the rear axle, metres.
    pub rear_axle: f64,
    /// Largest angle of the front wheels, rad.
    pub max_steering_angle: f64,
    /// At full throttle, m/s².
    pub max_acceleration: f64,
    /// At full brake while the tyres grip, m/s².
    pub max_deceleration: f64,
    /// Without throttle or brake, m/s².
    pub rolling_deceleration: f64,
    /// Speed at which the engine gives no more force, m/s.
    pub max_speed: f64,
}

impl ToldVehicle {
    fn of(view: &View) -> Self {
        let (car, area): (&Vehicle, _) = (view.car(), view.area());
        Self {
            length: rounded(2.0 * area.half_length),
            width: rounded(2.0 * area.half_width),
            front_axle: rounded(car.front),
            rear_axle: rounded(car.rear),
            max_steering_angle: rounded(car.max_steering),
            max_acceleration: rounded(car.full_throttle()),
            max_deceleration: rounded(car.full_brake()),
            rolling_deceleration: rounded(car.rolling_resistance()),
            max_speed: rounded(car.max_speed),
        }
    }
}

impl ToldScene {
    /// What the planner of a car is told.
    pub fn new(view: &View, seed: u64, asks: Asks) -> Self {
        Self {
            scene: view.scene().clone(),
            route: view.route().clone(),
            lights: view.route_lights(),
            vehicle: ToldVehicle::of(view),
            recorded_length: view.logged_route().length(),
            seed,
            asks,
        }
    }

    /// Identifier of the scene.
    pub fn id(&self) -> &str {
        &self.scene.scene().id
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<SimScene> {
        &self.scene
    }

    /// Seed of random numbers.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Corner points of the route to follow.
    pub fn route(&self) -> impl Iterator<Item = Point> {
        self.route.points().map(all_rounded)
    }

    /// The car that is driven.
    pub fn vehicle(&self) -> &ToldVehicle {
        &self.vehicle
    }

    /// The features of the map near the route, which serialise as those of the protocol.
    pub fn map(&self) -> impl Serialize {
        Features { index: self.scene.index(), route: &self.route, radius: self.asks.radius }
    }

    /// Lights on the route.
    pub fn lights(&self) -> Vec<ToldLight<'_>> {
        let lights = &self.scene.scene().lights;
        let stops = self.lights.stops().iter();
        stops.map(|stop| ToldLight::of(&lights[stop.light], Some(rounded(stop.along)))).collect()
    }

    /// The other lights of the scene.
    pub fn other_lights(&self) -> Vec<ToldLight<'_>> {
        let scene = self.scene.scene();
        self.lights.elsewhere(scene).map(|k| ToldLight::of(&scene.lights[k], None)).collect()
    }

    /// Identifiers of the lanes that the route follows, in their order.
    pub fn route_lanes(&self) -> Vec<&str> {
        let index = self.scene.index();
        let lanes = route_lanes(&self.route, index).into_iter();
        lanes.filter_map(|k| Some(&*index.map().features.get(k)?.id)).collect()
    }

    /// Where the recording ends: distance along the route, metres; `None` if the planner did not ask.
    pub fn goal(&self) -> Option<f64> {
        self.asks.goal.then_some(rounded(self.recorded_length))
    }

    /// How the planner is to follow its plans; `None` if it offers no ways.
    pub fn follow(&self) -> Option<&str> {
        self.asks.follow.as_deref()
    }
}

impl Serialize for ToldScene {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let reset = Reset {
            scene: self.id(),
            seed: self.seed,
            route: self.route().collect(),
            ego: self.vehicle,
            map: self.map(),
            lights: self.lights(),
            other_lights: self.other_lights(),
            route_lanes: self.route_lanes(),
            goal: self.goal(),
            follow: self.follow(),
        };
        reset.serialize(serializer)
    }
}

#[derive(Serialize)]
struct Reset<'a, M: Serialize> {
    scene: &'a str,
    seed: u64,
    route: Vec<Point>,
    ego: ToldVehicle,
    map: M,
    lights: Vec<ToldLight<'a>>,
    other_lights: Vec<ToldLight<'a>>,
    route_lanes: Vec<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    goal: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    follow: Option<&'a str>,
}

/// A light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ToldLight<'a> {
    /// The lane that it controls.
    pub lane: &'a str,
    /// Where to stop along the route, metres, if it is on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub along: Option<f64>,
    /// Where the cars of its lane stop, metres; `None` if that is not recorded.
    pub point: Option<Point>,
}

impl<'a> ToldLight<'a> {
    fn of(light: &'a TrafficLight, along: Option<f64>) -> Self {
        Self { lane: &light.lane, along, point: light.stop_point.map(|[x, y, _]| all_rounded([x, y])) }
    }
}
