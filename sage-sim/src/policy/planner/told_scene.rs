//! What a planner is told at the start of a drive.

use std::sync::Arc;

use sage_core::{
    geometry::{Aabb, Point},
    scene::{Map, MapFeature},
};
use serde::{Serialize, Serializer, ser::SerializeSeq};

use super::{all_rounded, rounded};
use crate::{policy::View, route::Route, route_lights::RouteLights, scene::SimScene, vehicle::Vehicle};

/// What a planner is told at the start of a drive. It owns what it needs. Numbers are rounded to a billionth.
///
/// It serialises as the message `reset` of the protocol.
pub struct ToldScene {
    scene: Arc<SimScene>,
    route: Route,
    lights: Arc<RouteLights>,
    vehicle: ToldVehicle,
    seed: u64,
    radius: f64,
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
    /// What the planner of a car is told. `radius` is the distance from the route within which the map is told, metres.
    pub fn new(view: &View, seed: u64, radius: f64) -> Self {
        Self {
            scene: view.scene().clone(),
            route: view.route().clone(),
            lights: view.route_lights(),
            vehicle: ToldVehicle::of(view),
            seed,
            radius,
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
        Features { map: self.scene.index().map(), route: &self.route, radius: self.radius }
    }

    /// Lights on the route: lane, and where to stop along the route, metres.
    pub fn lights(&self) -> impl Iterator<Item = (&str, f64)> {
        let scene = self.scene.scene();
        self.lights.stops().iter().map(|stop| (&*scene.lights[stop.light].lane, rounded(stop.along)))
    }
}

impl Serialize for ToldScene {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let lights = self.lights().map(|(lane, along)| Light { lane, along });
        let reset = Reset {
            scene: self.id(),
            seed: self.seed,
            route: self.route().collect(),
            ego: self.vehicle,
            map: self.map(),
            lights: lights.collect(),
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
    lights: Vec<Light<'a>>,
}

/// A light on the route.
#[derive(Serialize)]
struct Light<'a> {
    lane: &'a str,
    along: f64,
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
    speed_limit: Option<f64>,
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
                speed_limit: lane.speed_limit.map(rounded),
                entries: ids(&lane.entries),
                exits: ids(&lane.exits),
                left: ids(&left),
                right: ids(&right),
            }
        });
        let points = self.map.points_of(feature).iter().map(|p| all_rounded(*p)).collect();
        Feature { id: &feature.id, kind: feature.kind.name(), points, lane }
    }
}
