//! A drive: a policy in a scene, from frame 0 on.

mod record;

use std::sync::Arc;

use sage_core::{
    geometry::{Point, sub},
    scene::Scene,
};

pub use record::{Drive, DriveContact, OffRoad};

use crate::{
    Error,
    body::{Body, BodyShape},
    observation::{Driving, ObservationKind, Observed},
    policy::{ControlledVehicle, Driver, EgoPolicy, Knowledge, Shown, Start, View},
    reacting::Reacting,
    route::{Localization, Route},
    scene::{LAST_FRAME, SimScene, guide},
    traffic::Plan,
    vehicle::{Action, SUBSTEP},
    world::{Contact, Control, World, WorldOptions},
};

/// Frames after an appearance within which a contact is due to it.
const APPEARANCE: usize = 3;

/// A simulation with its drivers.
pub struct Simulation {
    world: World,
    ego: InformedDriver,
    adversary: Option<(InformedDriver, [Route; 2])>,
    reacting: Option<Reacting>,
    driving: Driving,
    observation: ObservationKind,
    /// What the ego did in the last step.
    control: Option<Control>,
    /// What the ego's driver showed of the last step.
    shown: Option<Shown>,
}

/// A driver and what it may know.
pub struct InformedDriver {
    driver: Box<dyn Driver>,
    knowledge: Knowledge,
}

impl InformedDriver {
    /// The driver of a track.
    ///
    /// *Errors*: as [`EgoPolicy::start`].
    pub fn start(policy: &dyn EgoPolicy, scene: &SimScene, track: usize, seed: u64) -> Result<Self, Error> {
        let knowledge = policy.knows();
        Ok(Self { driver: policy.start(&Start::new(scene, track, knowledge, seed))?, knowledge })
    }

    /// The control of the ego in a world.
    ///
    /// *Errors*: as [`Driver::control`].
    pub fn control_ego(&mut self, world: &World, observed: Option<Observed>) -> Result<Control, Error> {
        self.driver.control(&View::of_ego(world, self.knowledge, observed))
    }

    fn end(&mut self, world: &World) -> Result<(), Error> {
        self.driver.end(&View::of_ego(world, self.knowledge, None))
    }

    fn try_clone(&self) -> Result<Self, Error> {
        Ok(Self { driver: self.driver.boxed_clone()?, knowledge: self.knowledge })
    }
}

impl Simulation {
    /// A policy in a scene, at frame 0.
    ///
    /// *Errors*: as [`World::new`] and [`EgoPolicy::start`].
    pub fn new(
        scene: &Arc<SimScene>,
        options: &Arc<WorldOptions>,
        plan: Option<Arc<Plan>>,
        policy: &dyn EgoPolicy,
        seed: u64,
    ) -> Result<Self, Error> {
        let reacting = plan.as_deref().and_then(|plan| Reacting::of(plan, scene.scene()));
        let world = World::new(scene.clone(), options.clone(), plan, seed)?;
        let track = scene.scene().ego;
        let ego = InformedDriver::start(policy, scene, track, seed)?;
        let observation = policy.observes();
        let driving =
            Driving::start(observation, observation.route(scene), Localization::Nearest, world.motion());
        Ok(Self { world, ego, adversary: None, reacting, driving, observation, control: None, shown: None })
    }

    /// Lets a policy drive the adversary, from now on. A reaction of its plan then does not happen.
    ///
    /// *Errors*: as [`World::drive_adversary`] and [`EgoPolicy::start`].
    pub fn with_adversary(mut self, policy: &dyn EgoPolicy, seed: u64) -> Result<Self, Error> {
        let scene = self.world.scene().clone();
        let track = scene.scene().adversary_index()?;
        self.world.drive_adversary()?;
        let log = &scene.scene().tracks[track];
        let routes = [guide(log, scene.index()), Route::of_track(log, 0, false)];
        let driver = InformedDriver::start(policy, &scene, track, seed)?;
        self.adversary = Some((driver, routes));
        self.reacting = None;
        Ok(self)
    }

    /// A copy, which continues on its own.
    ///
    /// *Errors*: as [`Driver::boxed_clone`].
    pub fn try_clone(&self) -> Result<Self, Error> {
        let adversary = match &self.adversary {
            Some((driver, routes)) => Some((driver.try_clone()?, routes.clone())),
            None => None,
        };
        Ok(Self {
            world: self.world.clone(),
            ego: self.ego.try_clone()?,
            adversary,
            reacting: self.reacting.clone(),
            shown: self.shown.clone(),
            ..*self
        })
    }

    /// Goes on with another plan.
    ///
    /// *Errors*: as [`World::new`].
    pub(crate) fn replace_plan(&mut self, plan: Arc<Plan>) -> Result<(), Error> {
        self.reacting = Reacting::of(&plan, self.world.scene().scene());
        self.world.replace_plan(plan)
    }

    /// Lets an adversary that reacts brake from now on.
    pub(crate) fn stop_adversary(&mut self) {
        self.reacting.iter_mut().for_each(Reacting::brake);
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Whether the last control set the car's pose: contacts then do not change the drive.
    pub fn is_posed(&self) -> bool {
        matches!(self.control, Some(Control::Pose { .. }))
    }

    /// Advances by one step.
    ///
    /// *Errors*: as [`Driver::control`] and [`World::step`].
    pub fn step(&mut self) -> Result<(), Error> {
        self.advance(None)
    }

    /// Ends the drive of the ego.
    ///
    /// *Errors*: as [`Driver::end`].
    pub(crate) fn end(&mut self) -> Result<(), Error> {
        self.ego.end(&self.world)
    }

    /// Advances by one step in which the ego does what another driver did. Its own driver sees what it would have seen, and
    /// what it does is dropped.
    ///
    /// *Errors*: as [`Simulation::step`].
    pub(crate) fn watch(&mut self, control: Control) -> Result<(), Error> {
        self.advance(Some(control))
    }

    fn advance(&mut self, in_place: Option<Control>) -> Result<(), Error> {
        let mut theirs = match &mut self.reacting {
            Some(reacting) => reacting.control(&mut self.world)?,
            None => None,
        };
        let world = &self.world;
        let observed = Observed { driving: &self.driving, kind: self.observation };
        let scene = world.scene();
        let own = self.ego.control_ego(world, Some(observed))?;
        let control = in_place.unwrap_or(own);
        self.shown = self.ego.driver.shown();
        if let (Some((driver, [route, log])), Some((motion, body))) =
            (&mut self.adversary, world.adversary_motion())
        {
            let track = scene.scene().adversary_index()?;
            let mut others: Vec<Body> =
                world.bodies().iter().filter(|body| body.track != track).copied().collect();
            others.push(world.ego_body());
            let (area, ground) = (body.area, body.ground);
            let vehicle = ControlledVehicle {
                track,
                routes: [route, log],
                motion: *motion,
                area,
                ground,
                others: &others,
            };
            theirs = Some(driver.driver.control(&View::new(world, vehicle, driver.knowledge, None))?);
        }
        self.world.step(control, theirs)?;
        self.control = Some(control);
        let action = match control {
            Control::Drive(action) => action.limited(),
            Control::Pose { .. } | Control::Follow { .. } => Action::default(),
        };
        let (route, motion) = (self.observation.route(self.world.scene()), self.world.motion());
        self.driving.advance(action, route, Localization::Nearest, motion);
        Ok(())
    }
}

impl Drive {
    /// The scene in which the ego's recording is this drive. Frames after its end are not valid. Heights are
    /// those of the log; on a map with levels the drive follows the lanes of its own.
    pub fn scene_as_driven(&self, simulated: &SimScene) -> Scene {
        let mut scene = Scene::clone(simulated.scene());
        let size = BodyShape::at_now(scene.ego()).size;
        let track = &mut scene.tracks[scene.ego];
        let (mut height, mut extent) = (track.position[0][2], track.size[0]);
        let (mut ground, has_levels) = (track.ground(0), simulated.has_levels());
        for frame in 0..track.valid.len() {
            if track.valid[frame] {
                (height, extent) = (track.position[frame][2], track.size[frame]);
            }
            track.valid[frame] = frame < self.motions.len();
            if let Some(motion) = self.motions.get(frame) {
                let [x, y] = motion.position;
                if has_levels {
                    ground = simulated.follow_level([x, y], ground);
                    height = ground + 0.5 * extent[2];
                }
                track.position[frame] = [x, y, height];
                track.heading[frame] = motion.heading;
                track.velocity[frame] = motion.velocity;
                let [length, width] = size.unwrap_or([extent[0], extent[1]]);
                track.size[frame] = [length, width, extent[2]];
            }
        }
        scene
    }
}

/// Records a drive step by step.
#[derive(Clone)]
pub struct Recorder {
    drive: Drive,
    /// Coordinate along the route at the start, metres.
    first: f64,
    /// Tracks whose contact is no news: known ones, and those in contact since the start.
    touched: Vec<bool>,
    at_start: Vec<bool>,
}

impl Recorder {
    /// Starts the record at the present state.
    pub fn new(simulation: &Simulation) -> Self {
        let (world, start) = (simulation.world(), *simulation.world().motion());
        let off_road = OffRoad::start(world.scene().index().map());
        let drive = Drive { motions: vec![start], off_road, ..Drive::default() };
        let mut touched = vec![false; world.scene().scene().tracks.len()];
        // What the car touches at the start counts only if they part and touch again.
        for contact in &world.events().contacts {
            touched[contact.track] = true;
        }
        Self { drive, first: along(simulation), at_start: touched.clone(), touched }
    }

    /// Records the step that was just driven. Returns the number of new contacts.
    pub fn record(&mut self, simulation: &Simulation) -> usize {
        let (drive, world) = (&mut self.drive, simulation.world());
        let mut contacts = world.events().contacts.clone();
        if simulation.is_posed() {
            // Poses say where the car is at the frames; a touch that only their interpolation shows is none.
            contacts.retain(|contact| touches_now(world, contact.track));
        }
        drive.motions.push(*world.motion());
        drive.shown.extend(simulation.shown.clone());
        drive.controls.extend(simulation.control);
        drive.progress = drive.progress.max(along(simulation) - self.first);
        let step = world.step_count();
        if world.events().off_road && drive.off_road == OffRoad::Never {
            drive.off_road = OffRoad::At(step);
        }
        for (track, is_start) in self.at_start.iter_mut().enumerate() {
            if *is_start && !contacts.iter().any(|contact| contact.track == track) {
                (*is_start, self.touched[track]) = (false, false);
            }
        }
        let mut new: Vec<&Contact> = contacts.iter().filter(|contact| !self.touched[contact.track]).collect();
        new.sort_by_key(|contact| (contact.substep, contact.track));
        let before = drive.contacts.len();
        for contact in &new {
            self.touched[contact.track] = true;
            drive.contacts.extend(found(world, contact));
        }
        drive.contacts.len() - before
    }

    /// The record so far.
    pub fn drive(&self) -> &Drive {
        &self.drive
    }

    /// The record.
    pub fn finish(self) -> Drive {
        self.drive
    }
}

/// Coordinate of the car along its recorded route, metres.
fn along(simulation: &Simulation) -> f64 {
    let world = simulation.world();
    world.scene().route().locate(world.motion().position, Localization::Nearest).along
}

/// Whether the car touches a road user at the present frame.
fn touches_now(world: &World, track: usize) -> bool {
    let mut bodies = world.bodies().iter();
    bodies.any(|body| body.track == track && body.touches(&body.area, &world.area()))
}

/// A contact of the last step with the states that belong to it.
pub(crate) fn found(world: &World, contact: &Contact) -> Option<DriveContact> {
    let is_it = |body: &&Body| body.track == contact.track;
    let [now, before] = [world.bodies(), world.bodies_before()].map(|bodies| bodies.iter().find(is_it));
    let (other, car) = (now.or(before)?, *world.motion_before());
    let elapsed = contact.substep as f64 * SUBSTEP;
    let travel = |from: Point, to: Point| sub(to, from).map(|d| d / elapsed);
    let areas = [contact.own, contact.other];
    let theirs = before.map_or(other.velocity, |body| travel(body.area.center, areas[1].center));
    let velocities = [travel(car.position, areas[0].center), theirs];
    let (step, substep) = (world.step_count(), contact.substep);
    let appeared = world.appearance_of(contact.track).is_some_and(|since| step <= since + APPEARANCE);
    Some(DriveContact { step, substep, car, other: *other, areas, velocities, appeared })
}

/// Drives a policy to the end of the log, at most to the last frame of an episode.
///
/// *Errors*: as [`Simulation::step`]; that of a planner holds the drive up to there.
pub fn drive(simulation: &mut Simulation) -> Result<Drive, Error> {
    let mut recorder = Recorder::new(simulation);
    let last = LAST_FRAME.min(simulation.world().scene().scene().frames - 1);
    while simulation.world().step_count() < last {
        if let Err(error) = simulation.step() {
            return Err(error.with_drive(recorder.finish()));
        }
        recorder.record(simulation);
    }
    match simulation.end() {
        Ok(()) => Ok(recorder.finish()),
        Err(error) => Err(error.with_drive(recorder.finish())),
    }
}
