//! What a driver sees before a step.

use std::{cell::OnceCell, sync::Arc};

use sage_core::{
    geometry::OrientedBox,
    scene::{LightState, Map, Scene, SceneIndex, Track},
};

use super::Knowledge;
use crate::{
    Error,
    body::Body,
    observation::{LENGTH, LaterObservation, Observed},
    route::{Localization, Route},
    route_lights::{self, RouteLights},
    scene::SimScene,
    traffic::Plan,
    vehicle::{Motion, Vehicle},
    world::World,
};

/// Distance to the end of the recorded route at which it is over, metres.
const ROUTE_END: f64 = 5.0;

/// What a driver sees before a step.
pub struct View<'a> {
    world: &'a World,
    route: &'a Route,
    logged_route: &'a Route,
    motion: Motion,
    area: OrientedBox,
    ground: f64,
    others: &'a [Body],
    knowledge: Knowledge,
    track: usize,
    observed: Option<Observed<'a>>,
    observation: OnceCell<Box<[f32; LENGTH]>>,
}

/// The car that a view is of.
pub struct ControlledVehicle<'a> {
    /// Index of its track.
    pub track: usize,
    /// Its route, continued along the lanes, and its recorded route alone.
    pub routes: [&'a Route; 2],
    /// Its motion.
    pub motion: Motion,
    /// Its box.
    pub area: OrientedBox,
    /// Height of the ground under it, metres.
    pub ground: f64,
    /// All other road users.
    pub others: &'a [Body],
}

impl<'a> View<'a> {
    /// The view of the driver of a vehicle. `observed` is what its observation is of, if there is one.
    pub fn new(
        world: &'a World,
        vehicle: ControlledVehicle<'a>,
        knowledge: Knowledge,
        observed: Option<Observed<'a>>,
    ) -> Self {
        let ControlledVehicle { track, routes: [route, logged_route], motion, area, ground, others } =
            vehicle;
        let observation = OnceCell::new();
        Self {
            world,
            route,
            logged_route,
            motion,
            area,
            ground,
            others,
            knowledge,
            track,
            observed,
            observation,
        }
    }

    /// The view of the driver of the ego. `observed` is what its observation is of, if there is one.
    pub fn of_ego(world: &'a World, knowledge: Knowledge, observed: Option<Observed<'a>>) -> Self {
        let scene = world.scene();
        let vehicle = ControlledVehicle {
            track: scene.scene().ego,
            routes: [scene.guide(), scene.route()],
            motion: *world.motion(),
            area: world.area(),
            ground: world.level(),
            others: world.bodies(),
        };
        Self::new(world, vehicle, knowledge, observed)
    }

    /// Number of steps driven; equals the frame of what is seen.
    pub fn step(&self) -> usize {
        self.world.step_count()
    }

    /// Constants of the car.
    pub fn car(&self) -> &Vehicle {
        self.world.car()
    }

    /// Own motion.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Own box.
    pub fn area(&self) -> &OrientedBox {
        &self.area
    }

    /// The route to follow: the path that was recorded, without its times, continued along the lanes.
    pub fn route(&self) -> &Route {
        self.route
    }

    /// The recorded path alone, which ends where the recording ends.
    pub fn logged_route(&self) -> &Route {
        self.logged_route
    }

    /// The route of the published policies: the recorded one. They have no way on behind its end, where their
    /// episodes are over; here they take the continued one.
    pub(super) fn published_route(&self) -> &Route {
        let along = self.logged_route.locate(self.motion.position, Localization::Nearest).along;
        let is_over = along > self.logged_route.length() - ROUTE_END;
        if is_over { self.route } else { self.logged_route }
    }

    /// The other road users now, on the own level, in the order of their tracks.
    pub fn others(&self) -> impl Iterator<Item = &Body> {
        self.others.iter().filter(|body| self.is_level(body.ground))
    }

    /// Whether something at a height of the ground (metres) is on the own level.
    pub fn is_level(&self, height: f64) -> bool {
        self.world.are_level(height, self.ground)
    }

    /// The traffic lights on [`View::route`]. They do not change in a drive, so call it once.
    pub fn route_lights(&self) -> Arc<RouteLights> {
        let scene = self.scene();
        let is_ego = std::ptr::eq(self.route, scene.guide());
        if is_ego { scene.lights().clone() } else { Arc::new(RouteLights::new(scene.scene(), self.route)) }
    }

    /// State of a traffic light now, by its index in [`Scene::lights`].
    pub fn light(&self, light: usize) -> LightState {
        route_lights::state(self.world.scene().scene(), light, self.step())
    }

    /// The map.
    pub fn map(&self) -> &Map {
        self.world.scene().index().map()
    }

    /// Search structures of the map.
    pub fn index(&self) -> &SceneIndex {
        self.world.scene().index()
    }

    /// The scene, prepared for simulation: lines, speed limits.
    pub(crate) fn scene(&self) -> &Arc<SimScene> {
        self.world.scene()
    }

    /// The observation of a learning driver ([`crate::observation`]); computed on first use. `None` for a
    /// policy that drives the adversary.
    pub fn observation(&self) -> Option<&[f32; LENGTH]> {
        let observed = self.observed?;
        Some(self.observation.get_or_init(|| observed.numbers(self.world)))
    }

    /// The same, to be computed later or never: a copy of the world as it is now.
    pub fn later_observation(&self) -> Option<LaterObservation> {
        Some(LaterObservation::new(self.world.clone(), self.observed?))
    }

    /// Index of the own track in [`View::recording`].
    pub fn track(&self) -> usize {
        self.track
    }

    /// The own recording; `None` without [`Knowledge::OwnLog`].
    pub fn own_log(&self) -> Option<&Track> {
        (self.knowledge != Knowledge::None).then(|| &self.world.scene().scene().tracks[self.track])
    }

    /// The recording of everybody; `None` without [`Knowledge::Everything`].
    pub fn recording(&self) -> Option<&Scene> {
        (self.knowledge == Knowledge::Everything).then(|| &**self.world.scene().scene())
    }

    /// The plan of the adversary; `None` without [`Knowledge::Everything`], or if there is none.
    pub fn plan(&self) -> Option<&Plan> {
        (self.knowledge == Knowledge::Everything).then(|| self.world.plan()).flatten()
    }

    /// Error of a policy that cannot go on.
    pub fn error(&self, problem: String) -> Error {
        Error::Policy { scene: self.world.scene().scene().id.clone(), problem }
    }
}
