//! Driving policies: what drives the car under test, or the adversary.
//!
//! A policy sees a [`View`]: its own state, its route, the map, and the present boxes and velocities of the
//! others. Recordings and plans are a privilege that it must declare ([`EgoPolicy::privilege`]); tables print
//! it.

mod constant;
mod constant_speed;
mod expert;
mod expert_release;
mod forecast;
mod idm;
mod idm_release;
mod lane_change;
mod path;
mod pid;
mod replay;
mod steering;
mod tracking;

use std::{cell::OnceCell, fmt, sync::Arc};

use sage_core::{
    Error,
    geometry::OrientedBox,
    registry::Registry,
    scene::{Map, Scene, SceneIndex},
};

pub use constant::Constant;
pub use constant_speed::ConstantSpeed;
pub use expert::Expert;
pub use expert_release::ExpertRelease;
pub use idm::IdmPolicy;
pub use idm_release::IdmRelease;
pub use path::{DrivenPath, PathPolicy};
pub use replay::Replay;
pub use tracking::Tracking;

use crate::{
    body::Body,
    observation::LENGTH,
    route::Route,
    scene::SimScene,
    traffic::Plan,
    vehicle::{Motion, Vehicle},
    world::{Control, World},
};

/// All policies of this crate. Add a line here to make a new one known everywhere.
///
/// *Errors*: two have the same name.
pub fn policies() -> Result<Registry<dyn EgoPolicy>, Error> {
    Registry::new("policy")
        .with::<Replay>()?
        .with::<IdmPolicy>()?
        .with::<IdmRelease>()?
        .with::<Expert>()?
        .with::<ExpertRelease>()?
        .with::<Tracking>()?
        .with::<ConstantSpeed>()?
        .with::<Constant>()?
        .with::<PathPolicy>()
}

/// What a policy knows beyond its view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Privilege {
    /// Nothing.
    #[default]
    None,
    /// Its own recording.
    OwnLog,
    /// Recordings and plans of everybody.
    Everything,
}

impl fmt::Display for Privilege {
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
pub trait EgoPolicy: Send + Sync {
    /// What the policy knows beyond its view.
    fn privilege(&self) -> Privilege {
        Privilege::None
    }

    /// A driver for one drive. `track` is the track that it drives: the ego or the adversary.
    ///
    /// *Errors*: [`Error::Scene`] for a scene in which it cannot drive.
    fn start(&self, scene: &Arc<SimScene>, track: usize, seed: u64) -> Result<Box<dyn Driver>, Error>;
}

/// A policy in the middle of a drive.
pub trait Driver: Send {
    /// The control of the next step.
    ///
    /// *Errors*: [`Error::Scene`] if it cannot go on.
    fn control(&mut self, view: &View) -> Result<Control, Error>;

    /// A copy in the same state, so that a drive can be saved.
    fn boxed_clone(&self) -> Box<dyn Driver>;
}

/// What a driver sees before a step.
pub struct View<'a> {
    world: &'a World,
    route: &'a Route,
    motion: Motion,
    area: OrientedBox,
    others: &'a [Body],
    privilege: Privilege,
    track: usize,
    observe: &'a dyn Fn(&mut [f32]),
    observation: OnceCell<Box<[f32; LENGTH]>>,
}

/// The car that a view is of.
pub struct Seat<'a> {
    /// Index of its track.
    pub track: usize,
    /// Its route.
    pub route: &'a Route,
    /// Its motion.
    pub motion: Motion,
    /// Its box.
    pub area: OrientedBox,
    /// All other road users.
    pub others: &'a [Body],
}

impl<'a> View<'a> {
    /// The view of a driver in a seat. `observe` writes the observation on demand.
    pub fn new(
        world: &'a World,
        seat: Seat<'a>,
        privilege: Privilege,
        observe: &'a dyn Fn(&mut [f32]),
    ) -> Self {
        let Seat { track, route, motion, area, others } = seat;
        Self { world, route, motion, area, others, privilege, track, observe, observation: OnceCell::new() }
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

    /// The other road users now, on the own level, in the order of their tracks.
    pub fn others(&self) -> impl Iterator<Item = &Body> {
        self.others.iter().filter(|body| self.world.is_level(body.ground))
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
    pub(crate) fn scene(&self) -> &SimScene {
        self.world.scene()
    }

    /// The observation of a learning driver ([`crate::observation`]); computed on first use.
    pub fn observation(&self) -> &[f32; LENGTH] {
        self.observation.get_or_init(|| {
            let mut numbers = Box::new([0.0; LENGTH]);
            (self.observe)(&mut numbers[..]);
            numbers
        })
    }

    /// Index of the own track in [`View::recording`].
    pub fn track(&self) -> usize {
        self.track
    }

    /// The recording; `None` without [`Privilege::OwnLog`].
    pub fn recording(&self) -> Option<&Scene> {
        (self.privilege != Privilege::None).then(|| &**self.world.scene().scene())
    }

    /// The plan of the adversary; `None` without [`Privilege::Everything`], or if there is none.
    pub fn plan(&self) -> Option<&Plan> {
        (self.privilege == Privilege::Everything).then(|| self.world.plan()).flatten()
    }

    /// Error about the scene.
    pub fn error(&self, problem: String) -> Error {
        self.world.scene().error(problem)
    }
}
