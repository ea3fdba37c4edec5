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
mod people;
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
mod view;

use std::{fmt, path::Path};

use sage_core::{
    geometry::Point,
    registry::Registry,
    scene::{SceneIndex, Track},
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
pub use view::{ControlledVehicle, View};

use crate::{Error, observation::ObservationKind, scene::SimScene, world::Control};

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
