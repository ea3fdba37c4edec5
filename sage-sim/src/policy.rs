//! Driving policies: what drives the car under test, or the adversary.
//!
//! A policy sees a [`View`]: its own state, its route, the map, and the present boxes and velocities of the
//! others and states of traffic lights. A policy that uses recordings or plans declares it ([`EgoPolicy::knows`]).

mod constant;
mod constant_speed;
mod expert;
mod expert_release;
mod forecast;
mod idm;
mod idm_release;
mod idm_sets;
mod lane_change;
mod learned;
mod minded_lights;
mod path;
mod pdm;
mod pid;
pub mod planner;
#[cfg(unix)]
mod process;
mod r157;
mod replay;
mod shown;
mod steering;
mod takeover;
mod timed;
mod tracking;

use std::{cell::OnceCell, fmt, path::Path, sync::Arc};

use sage_core::{
    geometry::{OrientedBox, Point},
    registry::Registry,
    scene::{LightState, Map, Scene, SceneIndex, Track},
};

pub use constant::Constant;
pub use constant_speed::ConstantSpeed;
pub use expert::Expert;
pub use expert_release::ExpertRelease;
pub use idm::IdmPolicy;
pub use idm_release::IdmRelease;
pub use learned::{LearnedPolicyOptions, Ppo, Td3};
pub use minded_lights::{Braking, RedLights, RedStop};
pub use path::{DrivenPath, PathPolicy};
pub use pdm::{Pdm, PdmOptions};
#[cfg(unix)]
pub use process::{Process, ProcessOptions, kill_programs};
pub use r157::{R157, R157Options, Reading};
pub use replay::Replay;
pub use shown::Shown;
pub use takeover::{Takeover, TakeoverOptions};
pub use timed::{StepTimes, Timed};
pub use tracking::Tracking;

use crate::{
    Error,
    body::Body,
    observation::{LENGTH, LaterObservation, ObservationKind, Observed},
    route::{Localization, Route},
    route_lights::{self, RouteLights},
    scene::SimScene,
    traffic::Plan,
    vehicle::{Motion, Vehicle},
    world::{Control, World},
};

/// All policies of this crate. Add a line here to make a new one known everywhere.
///
/// *Errors*: two have the same name.
pub fn policies() -> Result<Registry<dyn EgoPolicy>, sage_core::Error> {
    let registry = Registry::new("policy")
        .with::<Replay>()?
        .with::<IdmPolicy>()?
        .with::<IdmRelease>()?
        .with_preset::<IdmPolicy>(
            "idm-nuplan",
            "car following along the logged route, parameters of nuPlan's planner",
            "nuplan-devkit, IDM planner",
            &idm_sets::nuplan(),
        )?
        .with_preset::<IdmPolicy>(
            "idm-vmax",
            "car following along the logged route, parameters of V-Max",
            "V-Max, rule-based IDM",
            &idm_sets::vmax(),
        )?
        .with::<R157>()?
        .with::<Pdm>()?
        .with::<Expert>()?
        .with::<ExpertRelease>()?
        .with::<Ppo>()?
        .with::<Td3>()?
        .with::<Tracking>()?
        .with::<ConstantSpeed>()?
        .with::<Constant>()?
        .with::<Takeover>()?
        .with::<PathPolicy>()?;
    #[cfg(unix)]
    let registry = registry.with::<Process>()?;
    Ok(registry)
}

/// Distance to the end of the recorded route at which it is over, metres.
const ROUTE_END: f64 = 5.0;

/// What a policy knows beyond its view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Knowledge {
    /// Nothing.
    #[default]
    None,
    /// Its own recording.
    OwnLog,
    /// Recordings and plans of everybody.
    Everything,
}

impl fmt::Display for Knowledge {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::None => "nothing beyond now",
            Self::OwnLog => "own log",
            Self::Everything => "everybody's future",
        })
    }
}

/// A driving policy.
///
/// Implementations are pure: the same scene, seed and views give the same controls.
///
/// A driver of your own, which brakes fully at every step, in a [`SimScene`]:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::scene::SceneIndex;
/// # use sage_data::procedural::{Kind, generate};
/// use sage_sim::{Error, SimScene, episode::Episode, vehicle::Action, world::Control};
/// use sage_sim::policy::{Driver, EgoPolicy, Start, View};
///
/// #[derive(Clone)]
/// struct Brakes;
/// impl EgoPolicy for Brakes {
///     fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
///         Ok(Box::new(self.clone()))
///     }
/// }
/// impl Driver for Brakes {
///     fn control(&mut self, _: &View) -> Result<Control, Error> {
///         Ok(Control::Drive(Action { steer: 0.0, throttle: -1.0 }))
///     }
///     fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
///         Ok(Box::new(self.clone()))
///     }
/// }
///
/// # let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
/// # let scene = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let episode = Episode::run(&scene, None, &Brakes, 0)?;
/// let speed = |frame: usize| episode.drive.motions[frame].speed();
/// assert!(speed(5) < speed(0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait EgoPolicy: Send + Sync {
    /// What the policy knows beyond its view.
    fn knows(&self) -> Knowledge {
        Knowledge::None
    }

    /// Whether it drives the recording itself, so that an attack on it is one on the recording.
    fn is_recording(&self) -> bool {
        false
    }

    /// Which observation it is made for.
    fn observes(&self) -> ObservationKind {
        ObservationKind::Corrected
    }

    /// Names the folder of a run, for policies that keep logs. Without it they keep temporary ones.
    fn write_logs_to(&self, _folder: &Path) {}

    /// The other ways of following its plans that it offers, each as a policy of its own.
    ///
    /// *Errors*: [`Error::Planner`] for a program that does not start.
    fn other_ways(&self) -> Result<Vec<OtherWay>, Error> {
        Ok(Vec::new())
    }

    /// A driver for one drive.
    ///
    /// *Errors*: [`Error::Policy`] for a scene in which it cannot drive, [`Error::Planner`] for a program that fails.
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error>;
}

/// The same policy with another way of following its plans.
pub struct OtherWay {
    /// Name of the way, as the policy calls it.
    pub name: String,
    /// The policy that follows by it.
    pub policy: Box<dyn EgoPolicy>,
}

/// What a policy gets at the start of a drive.
pub struct Start<'a> {
    scene: &'a SimScene,
    track: usize,
    knowledge: Knowledge,
    seed: u64,
}

impl<'a> Start<'a> {
    /// The start of a policy that drives a track: the ego or the adversary.
    pub fn new(scene: &'a SimScene, track: usize, knowledge: Knowledge, seed: u64) -> Self {
        Self { scene, track, knowledge, seed }
    }

    /// Identifier of the scene.
    pub fn scene_id(&self) -> &'a str {
        &self.scene.scene().id
    }

    /// Number of frames of the scene.
    pub fn frames(&self) -> usize {
        self.scene.scene().frames
    }

    /// Search structures of the map.
    pub fn index(&self) -> &'a SceneIndex {
        self.scene.index()
    }

    /// Position at the start, metres.
    fn first_position(&self) -> Point {
        self.scene.scene().tracks[self.track].point(0)
    }

    /// Seed of random numbers.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The recording of the driven track; `None` without [`Knowledge::OwnLog`].
    pub fn own_log(&self) -> Option<&'a Track> {
        let is_allowed = self.knowledge != Knowledge::None;
        is_allowed.then(|| self.scene.scene().tracks.get(self.track)).flatten()
    }

    /// Error of a policy that cannot drive in this scene.
    pub fn error(&self, problem: String) -> Error {
        Error::Policy { scene: self.scene.scene().id.clone(), problem }
    }
}

/// A policy in the middle of a drive.
pub trait Driver: Send {
    /// The control of the next step.
    ///
    /// *Errors*: [`Error::Policy`] if it cannot go on, [`Error::Planner`] for a program that fails.
    fn control(&mut self, view: &View) -> Result<Control, Error>;

    /// What it shows of the step whose control it just gave; `None` for nothing new.
    fn shown(&mut self) -> Option<Shown> {
        None
    }

    /// Told at the end of a drive that no step follows, before anybody relies on the drive.
    ///
    /// *Errors*: [`Error::Planner`] for a program whose answers do not belong to the steps, as it shows only now.
    fn end(&mut self, _view: &View) -> Result<(), Error> {
        Ok(())
    }

    /// A copy in the same state, so that a drive can be saved.
    ///
    /// *Errors*: [`Error::Clone`] if its state is not in this process.
    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error>;
}

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
    fn published_route(&self) -> &Route {
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
