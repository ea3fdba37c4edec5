//! Roll-outs: drives of a policy with all that a learned adversary is trained on: what the driver saw and did in each
//! step, and where everybody was.

mod criticality;

use std::sync::Arc;

use sage_core::{
    geometry::Point,
    motion::Pose,
    registry::Entry as _,
    scene::{Scene, SceneIndex},
};
use sage_sim::{
    Error, SimScene,
    body::BodyKind,
    environment::{Environment, EnvironmentOptions},
    observation::LENGTH,
    policy::{ControlledVehicle, EgoPolicy, IdmRelease, Start, View},
    traffic::{Plan, TrafficMode, TrafficOptions},
    vehicle::Action,
    world::{Control, WorldOptions},
};

pub use criticality::{DISTANCE_SCALE, Targets, targets};

/// Why a roll-out ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RolloutEnd {
    /// Contact with a vehicle, an object, a pedestrian or a cyclist.
    Contact,
    /// The car left the road.
    OffRoad,
    /// The car arrived, or drove backwards beyond the start.
    Arrived,
    /// Frame 90, or the last frame of a shorter recording.
    Horizon,
}

/// A recorded drive.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// What the driver saw before each step.
    pub observations: Vec<Box<[f32; LENGTH]>>,
    /// What it did in each step.
    pub actions: Vec<Action>,
    /// Poses of the vehicles by track, at frames 0 to the end; `None` where a vehicle is absent.
    pub poses: Vec<Vec<Option<Pose>>>,
    /// Tracks that the ego touches at the end.
    pub touched: Vec<usize>,
    /// Why it ends.
    pub end: RolloutEnd,
}

impl Rollout {
    /// Position of a track at each frame.
    pub fn path(&self, track: usize) -> impl Iterator<Item = Option<Point>> {
        self.poses[track].iter().map(|pose| pose.map(|pose| pose.position))
    }
}

/// Rules of roll-outs: as in the environment of reinforcement learning, but a contact ends them, and vehicles behind the
/// ego react to it.
pub fn rules() -> Arc<EnvironmentOptions> {
    let traffic = TrafficOptions { mode: TrafficMode::Reactive, ..TrafficOptions::default() };
    let world = Arc::new(WorldOptions { traffic, ..WorldOptions::default() });
    Arc::new(EnvironmentOptions { world, contact_ends: true, ..EnvironmentOptions::default() })
}

/// Drives a policy from frame 0 to the end of the roll-out, with an optional plan of the adversary.
///
/// *Errors*: as [`Environment::reset`], [`EgoPolicy::start`], and the driver's own.
pub fn roll_out(
    policy: &dyn EgoPolicy,
    scene: &Arc<SimScene>,
    plan: Option<Arc<Plan>>,
    rules: &Arc<EnvironmentOptions>,
    seed: u64,
) -> Result<Rollout, Error> {
    let mut environment = Environment::reset(scene.clone(), rules.clone(), plan, seed)?;
    let ego = scene.scene().ego;
    let mut driver = policy.start(&Start::new(scene, ego, policy.knows(), seed))?;
    let mut rollout = Rollout {
        observations: Vec::new(),
        actions: Vec::new(),
        poses: vec![Vec::new(); scene.scene().tracks.len()],
        touched: Vec::new(),
        end: RolloutEnd::Horizon,
    };
    rollout.note(&environment);
    while !environment.is_over() {
        let world = environment.world();
        let vehicle = ControlledVehicle {
            track: ego,
            routes: [scene.guide(), scene.route()],
            motion: *world.motion(),
            area: world.area(),
            ground: world.level(),
            others: world.bodies(),
        };
        let view = View::new(world, vehicle, policy.knows(), Some(environment.observed()));
        let control = driver.control(&view)?;
        let mut seen = Box::new([0.0; LENGTH]);
        environment.observe(&mut seen);
        let outcome = environment.step_with(control)?;
        rollout.observations.push(seen);
        rollout.actions.push(match control {
            Control::Drive(action) => action.limited(),
            Control::Pose { .. } | Control::Follow { .. } => Action::default(),
        });
        rollout.note(&environment);
        let events = environment.world().events();
        if !events.contacts.is_empty() {
            rollout.touched = events.contacts.iter().map(|contact| contact.track).collect();
            rollout.end = RolloutEnd::Contact;
            break;
        }
        if environment.is_over() && !outcome.truncated {
            rollout.end = if outcome.out_of_road { RolloutEnd::OffRoad } else { RolloutEnd::Arrived };
        }
    }
    Ok(rollout)
}

impl Rollout {
    /// Notes where the vehicles are.
    fn note(&mut self, environment: &Environment) {
        let world = environment.world();
        self.poses.iter_mut().for_each(|poses| poses.push(None));
        let mut set = |track: usize, pose: Pose| {
            if let Some(slot) = self.poses[track].last_mut() {
                *slot = Some(pose);
            }
        };
        let motion = world.motion();
        set(world.scene().scene().ego, Pose { position: motion.position, heading: motion.heading });
        for body in world.bodies().iter().filter(|body| body.kind == BodyKind::Vehicle) {
            set(body.track, Pose { position: body.area.center, heading: body.heading });
        }
    }
}

/// The driver of roll-outs: the car-following policy that is published with MetaDrive.
///
/// *Errors*: none.
pub fn rollout_driver() -> Result<Box<dyn EgoPolicy>, Error> {
    IdmRelease::build(sage_core::registry::NoOptions {}).map_err(Error::Value)
}

/// Length of a window of a skill, steps.
pub const WINDOW: usize = 10;
/// Windows before a contact start in this many last steps.
pub const BEFORE_CONTACT: usize = 20;

/// First steps of the windows of a roll-out: all of them, or those that start in the last 20 steps before its contact.
/// The last 10 steps of a drive that leaves the road are left out.
pub fn windows(rollout: &Rollout, before_contact: bool) -> std::ops::Range<usize> {
    let steps = rollout.actions.len();
    let left_out = if rollout.end == RolloutEnd::OffRoad { WINDOW } else { 0 };
    let end = (steps + 1).saturating_sub(WINDOW + left_out);
    match (before_contact, rollout.end) {
        (false, _) => 0..end,
        (true, RolloutEnd::Contact) => steps.saturating_sub(BEFORE_CONTACT).min(end)..end,
        (true, _) => 0..0,
    }
}

/// The scene with other vehicles in the ego's place, so that more cars are driven in it: those that are recorded at all
/// frames and go at least 10 m, in the order of their tracks.
pub fn seats(scene: &Scene, index: &Arc<SceneIndex>, most: usize) -> Vec<Arc<SimScene>> {
    const LEAST_WAY: f64 = 10.0;
    let last = scene.frames - 1;
    let is_driven = |track: &usize| {
        let log = &scene.tracks[*track];
        *track != scene.ego
            && BodyKind::of(log) == BodyKind::Vehicle
            && (0..=last).all(|frame| log.is_valid(frame))
            && sage_core::geometry::distance(log.point(0), log.point(last)) >= LEAST_WAY
    };
    let driven = (0..scene.tracks.len()).filter(is_driven);
    // A car that cannot be the ego, such as one that begins within another, leaves its place to the next.
    let seat = |track: usize| {
        let seen = scene.clone().with_roles(Some(&scene.tracks[track].id), None).ok()?;
        SimScene::new(Arc::new(seen), index.clone()).ok()
    };
    driven.filter_map(seat).take(most).collect()
}
