//! The environment of reinforcement learning: reset, step, observation, reward, cost, endings.
//!
//! The rules are MetaDrive's for recorded scenes: the reward is the progress along the logged route in metres,
//! replaced by +10 on arrival, −10 off the road, −1 in contact. Each oddity of MetaDrive is an option that is
//! off by default; [`EnvironmentOptions::metadrive`] turns all of them on.

mod options;
mod outcome;
pub mod reward;
mod rules;

use std::sync::Arc;

use sage_core::{
    geometry::{Point, distance},
    motion::Pose,
    scene::TrackKind,
};

pub use options::{EnvironmentOptions, Rewards};
pub use outcome::Outcome;
pub use reward::{DrivingReward, RewardSum, RewardedStep};
pub(crate) use rules::{ARRIVED, BACKWARDS};
pub use rules::{Situation, assess};

use crate::{
    Error,
    observation::{Driving, LENGTH, Observed, Seat, observe},
    reacting::Reacting,
    route::{Coordinates, Localization, Route},
    scene::SimScene,
    traffic::Plan,
    vehicle::{Action, SUBSTEP, SUBSTEPS},
    world::{Control, World},
};

/// A step that another simulator recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recorded {
    /// Action of the step.
    pub action: Action,
    /// Pose after the step.
    pub pose: Pose,
    /// Velocity after the step, m/s.
    pub velocity: Point,
    /// Contact with a vehicle in the step; `None` for the own test.
    pub vehicle_contact: Option<bool>,
}

/// An episode of driving in one scene. A clone continues on its own.
///
/// The first step in a `scene`:
///
/// ```
/// # use sage_core::scene::SceneIndex;
/// # use sage_data::procedural::{Kind, generate};
/// use std::sync::Arc;
///
/// use sage_sim::{
///     SimScene,
///     environment::{Environment, EnvironmentOptions},
///     observation::LENGTH,
///     vehicle::Action,
/// };
///
/// # let scene = Arc::new(generate(Kind::Straight, 1, 0).ok_or("no scene for this seed")?);
/// let scene = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let mut environment = Environment::reset(scene, Arc::new(EnvironmentOptions::training()), None, 0)?;
/// let mut observation = [0.0; LENGTH];
/// environment.observe(&mut observation);
/// assert!(observation.iter().all(|number| (0.0..=1.0).contains(number)));
///
/// // The reward of a step is the progress along the route in metres, 0.1 s of driving.
/// let outcome = environment.step(Action { steer: 0.0, throttle: 0.5 })?;
/// assert_eq!(outcome.reward, outcome.progress);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Environment {
    options: Arc<EnvironmentOptions>,
    world: World,
    driving: Driving,
    reacting: Option<Reacting>,
    at: Coordinates,
    had_arrived: bool,
    was_off_road: bool,
    is_over: bool,
}

impl Environment {
    /// Starts an episode.
    ///
    /// `seed` decides what the options leave open. `plan` replaces the log of one track, usually the
    /// adversary.
    ///
    /// *Errors*: as [`World::new`].
    pub fn reset(
        scene: Arc<SimScene>,
        options: Arc<EnvironmentOptions>,
        plan: Option<Arc<Plan>>,
        seed: u64,
    ) -> Result<Self, Error> {
        let reacting = plan.as_deref().and_then(|plan| Reacting::of(plan, scene.scene()));
        let world = World::new(scene, options.world.clone(), plan, seed)?;
        let how = options.localization();
        let at = options.route(world.scene()).locate(world.motion().position, how);
        let driving = Driving::start(
            options.observation,
            options.observation.route(world.scene()),
            how,
            world.motion(),
        );
        let (had_arrived, was_off_road, is_over) = (false, false, false);
        Ok(Self { options, world, driving, reacting, at, had_arrived, was_off_road, is_over })
    }

    /// Advances by one step of 0.1 s.
    ///
    /// *Errors*: [`Error::Call`] if the episode is over, or as [`World::step`].
    pub fn step(&mut self, action: Action) -> Result<Outcome, Error> {
        let action = if self.options.nan_is_zero { action.limited() } else { action };
        self.step_with(Control::Drive(action))
    }

    /// Advances by one step with any control.
    ///
    /// *Errors*: as [`Environment::step`].
    pub fn step_with(&mut self, control: Control) -> Result<Outcome, Error> {
        self.check_running()?;
        let (action, is_late) = match control {
            Control::Drive(action) => (action.limited(), false),
            Control::Pose { .. } | Control::Follow { .. } => {
                (Action::default(), self.options.late_navigation)
            }
        };
        self.step_world(control)?;
        Ok(self.finish(action, is_late, None))
    }

    /// Advances by one step that another simulator recorded.
    ///
    /// *Errors*: as [`Environment::step`].
    pub fn step_recorded(&mut self, recorded: &Recorded) -> Result<Outcome, Error> {
        self.check_running()?;
        self.step_world(Control::Pose { pose: recorded.pose, velocity: Some(recorded.velocity) })?;
        Ok(self.finish(recorded.action, false, recorded.vehicle_contact))
    }

    /// Advances the world, with an adversary that may react.
    fn step_world(&mut self, control: Control) -> Result<(), Error> {
        let theirs = match &mut self.reacting {
            Some(reacting) => reacting.control(&mut self.world)?,
            None => None,
        };
        self.world.step(control, theirs)?;
        if let Some(reacting) = self.reacting.as_mut().filter(|_| !self.world.events().contacts.is_empty()) {
            reacting.brake();
        }
        Ok(())
    }

    fn check_running(&self) -> Result<(), Error> {
        if self.is_over {
            let problem = "the episode is over; start another one".to_owned();
            return Err(Error::Call { scene: self.world.scene().scene().id.clone(), problem });
        }
        Ok(())
    }

    /// Assesses a step and brings the navigation up to date.
    fn finish(&mut self, action: Action, is_late: bool, contact: Option<bool>) -> Outcome {
        let (mut outcome, at) = self.assessed(contact);
        self.at = at;
        self.had_arrived |= outcome.arrived;
        self.was_off_road = outcome.out_of_road;
        let step = RewardedStep {
            outcome: &outcome,
            world: &self.world,
            action,
            action_before: self.driving.actions[0],
        };
        if let Some(reward) = self.options.reward.of(&step) {
            outcome.reward = reward;
        }
        let how = self.options.localization();
        // Under replay the navigation sees the pose that the physics reached from the frame before.
        let coasted = || self.world.motion_before().coasted((SUBSTEPS - 1) as f64 * SUBSTEP);
        let navigated = if is_late { coasted() } else { *self.world.motion() };
        self.driving.is_replayed = is_late;
        let route = self.options.observation.route(self.world.scene());
        self.driving.advance(action, route, how, &navigated);
        self.is_over = outcome.terminated || outcome.truncated;
        outcome
    }

    /// Writes the observation.
    pub fn observe(&self, out: &mut [f32; LENGTH]) {
        let kind = self.options.observation;
        observe(&Seat::of_ego(&self.world, kind), &self.driving, kind, out);
    }

    /// What the observation is of, besides the world.
    pub fn observed(&self) -> Observed<'_> {
        Observed { driving: &self.driving, kind: self.options.observation }
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The options.
    pub fn options(&self) -> &EnvironmentOptions {
        &self.options
    }

    /// The car's coordinates on the route.
    pub fn coordinates(&self) -> Coordinates {
        self.at
    }

    /// Whether the last step that the options allow is done.
    pub fn is_at_limit(&self) -> bool {
        self.options.is_last(self.world.step_count(), self.world.scene().scene().frames - 1)
    }

    /// Whether the episode is over.
    pub fn is_over(&self) -> bool {
        self.is_over
    }

    /// Assesses the last step, and gives the car's coordinates on the route.
    fn assessed(&self, contact: Option<bool>) -> (Outcome, Coordinates) {
        let world = &self.world;
        let scene = world.scene();
        let how = self.options.localization();
        let position = world.motion().position;
        let at = self.options.route(scene).locate(position, how);
        let touched = |kind: fn(&TrackKind) -> bool| {
            let tracks = &scene.scene().tracks;
            world.events().contacts.iter().any(|contact| kind(&tracks[contact.track].kind))
        };
        let events = world.events();
        let step = world.step_count();
        let situation = Situation {
            step,
            last_frame: scene.scene().frames - 1,
            along_before: self.at.along,
            at,
            route_length: scene.route().length(),
            vehicle_contact: contact.unwrap_or_else(|| touched(|kind| *kind == TrackKind::Vehicle)),
            human_contact: touched(|kind| matches!(kind, TrackKind::Pedestrian | TrackKind::Cyclist)),
            object_contact: touched(|kind| matches!(kind, TrackKind::Other(_))),
            had_arrived: self.had_arrived,
            was_off_road: self.was_off_road,
            on_yellow: events.on_yellow,
            on_edge: if self.options.start_edge_ends { events.on_edge } else { events.off_road },
        };
        let mut outcome = assess(&self.options, &situation);
        outcome.distance_to_log = distance(position, scene.logged_position(step));
        (outcome, at)
    }
}

impl EnvironmentOptions {
    /// Whether a step is the last one that the limit of steps and the length of the log allow.
    fn is_last(&self, step: usize, last_frame: usize) -> bool {
        step >= self.max_steps || (!self.outlast_log && step >= last_frame)
    }

    /// The route along which progress is measured.
    fn route<'a>(&self, scene: &'a SimScene) -> &'a Route {
        if self.goes_on { scene.guide() } else { scene.route() }
    }

    /// How positions are located on the route.
    pub fn localization(&self) -> Localization {
        if self.line_localization { Localization::MetaDrive } else { Localization::Nearest }
    }
}
