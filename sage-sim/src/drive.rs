//! A drive: a policy in a scene, from frame 0 on.

use std::sync::Arc;

use sage_core::{Error, geometry::OrientedBox, scene::Scene};

use crate::{
    body::{Body, BodyKind, BodyShape},
    observation::{Driving, LENGTH, ObservationKind, observe},
    policy::{Driver, EgoPolicy, Privilege, Seat, Start, View},
    route::{Localization, Route},
    scene::{SimScene, guide},
    traffic::Plan,
    vehicle::{Action, Motion},
    world::{Control, World, WorldOptions},
};

/// A contact of the car with one road user: the first.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveContact {
    /// Step, 1 the first.
    pub step: usize,
    /// The car before that step: a contact changes its velocity.
    pub car: Motion,
    /// The other road user at that step.
    pub other: Body,
    /// Boxes of the car and of the other when they meet.
    pub areas: [OrientedBox; 2],
}

/// A simulation with its drivers. A clone continues on its own.
pub struct Simulation {
    world: World,
    ego: Seated,
    adversary: Option<(Seated, [Route; 2])>,
    driving: Driving,
    observation: ObservationKind,
}

/// A driver and what it may know.
struct Seated {
    driver: Box<dyn Driver>,
    privilege: Privilege,
}

impl Clone for Seated {
    fn clone(&self) -> Self {
        Self { driver: self.driver.boxed_clone(), privilege: self.privilege }
    }
}

impl Clone for Simulation {
    fn clone(&self) -> Self {
        Self { world: self.world.clone(), ego: self.ego.clone(), adversary: self.adversary.clone(), ..*self }
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
        let world = World::new(scene.clone(), options.clone(), plan, seed)?;
        let track = scene.scene().ego;
        let ego = Seated { driver: started(policy, scene, track, seed)?, privilege: policy.privilege() };
        let driving = Driving::start(scene.route(), Localization::Nearest, world.motion());
        Ok(Self { world, ego, adversary: None, driving, observation: ObservationKind::Corrected })
    }

    /// Lets a policy drive the adversary, from now on.
    ///
    /// *Errors*: as [`World::drive_adversary`] and [`EgoPolicy::start`].
    pub fn with_adversary(mut self, policy: &dyn EgoPolicy, seed: u64) -> Result<Self, Error> {
        let scene = self.world.scene().clone();
        let track = scene.scene().adversary_index()?;
        self.world.drive_adversary()?;
        let log = &scene.scene().tracks[track];
        let routes = [guide(log, scene.index()), Route::of_track(log, 0, false)];
        let seated = Seated { driver: started(policy, &scene, track, seed)?, privilege: policy.privilege() };
        self.adversary = Some((seated, routes));
        Ok(self)
    }

    /// Observations of another kind for the policy; [`ObservationKind::Corrected`] is the default.
    pub fn with_observation(mut self, kind: ObservationKind) -> Self {
        self.observation = kind;
        self
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Advances by one step.
    ///
    /// *Errors*: as [`Driver::control`] and [`World::step`].
    pub fn step(&mut self) -> Result<(), Error> {
        let world = &self.world;
        let (driving, kind) = (&self.driving, self.observation);
        let see = |out: &mut [f32; LENGTH]| observe(world, driving, kind, out);
        let scene = world.scene();
        let seat = Seat {
            track: scene.scene().ego,
            routes: [scene.guide(), scene.route()],
            motion: *world.motion(),
            area: world.area(),
            ground: world.level(),
            others: world.bodies(),
        };
        let control = self.ego.driver.control(&View::new(world, seat, self.ego.privilege, Some(&see)))?;
        let mut theirs = None;
        if let (Some((seated, [route, log])), Some((motion, body))) =
            (&mut self.adversary, world.adversary_motion())
        {
            let track = scene.scene().adversary_index()?;
            let mut others: Vec<Body> =
                world.bodies().iter().filter(|body| body.track != track).copied().collect();
            others.push(ego_body(world));
            let (area, ground) = (body.area, body.ground);
            let seat = Seat { track, routes: [route, log], motion: *motion, area, ground, others: &others };
            theirs = Some(seated.driver.control(&View::new(world, seat, seated.privilege, None))?);
        }
        self.world.step(control, theirs)?;
        let action = match control {
            Control::Drive(action) => action.limited(),
            Control::Pose { .. } => Action::default(),
        };
        let (route, motion) = (self.world.scene().route(), self.world.motion());
        self.driving.advance(action, route, Localization::Nearest, motion);
        Ok(())
    }
}

fn started(
    policy: &dyn EgoPolicy,
    scene: &SimScene,
    track: usize,
    seed: u64,
) -> Result<Box<dyn Driver>, Error> {
    policy.start(&Start::new(scene, track, policy.privilege(), seed))
}

/// The ego as a body for others.
fn ego_body(world: &World) -> Body {
    let (scene, motion) = (world.scene().scene(), world.motion());
    Body {
        track: scene.ego,
        kind: BodyKind::of(scene.ego()),
        class: None,
        area: world.area(),
        heading: motion.heading,
        velocity: motion.velocity,
        yaw_rate: motion.yaw_rate,
        ground: world.level(),
        is_falling: false,
    }
}

/// The record of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    /// Motion at each step, the start first.
    pub motions: Vec<Motion>,
    /// First contact with each road user, in the order of time. A contact that lasts from the start is none.
    pub contacts: Vec<DriveContact>,
    /// Progress along the route, metres, from the start to the farthest point.
    pub progress: f64,
    /// First step at which the car touches a road edge.
    pub off_road: Option<usize>,
}

impl Drive {
    /// The scene in which the ego's recording is this drive. Frames after its end are not valid. Heights are
    /// those of the log.
    pub fn recorded(&self, scene: &Scene) -> Scene {
        let mut scene = scene.clone();
        let size = BodyShape::at_now(scene.ego()).size;
        let track = &mut scene.tracks[scene.ego];
        let (mut height, mut extent) = (track.position[0][2], track.size[0]);
        for frame in 0..track.valid.len() {
            if track.valid[frame] {
                (height, extent) = (track.position[frame][2], track.size[frame]);
            }
            track.valid[frame] = frame < self.motions.len();
            if let Some(motion) = self.motions.get(frame) {
                let [x, y] = motion.position;
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

/// When a drive ends, besides the end of the log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Until {
    /// Nothing else.
    #[default]
    EndOfLog,
    /// The first contact with any road user.
    Contact,
}

/// Drives a policy to the end of the log.
///
/// *Errors*: as [`Simulation::new`] and [`Simulation::step`].
pub fn drive(simulation: &mut Simulation, until: Until) -> Result<Drive, Error> {
    let scene = simulation.world().scene().clone();
    let route = scene.route();
    let along = |motion: &Motion| route.locate(motion.position, Localization::Nearest).along;
    let start = *simulation.world().motion();
    let first = along(&start);
    let mut drive = Drive { motions: vec![start], contacts: Vec::new(), progress: 0.0, off_road: None };
    let mut touched = vec![false; scene.scene().tracks.len()];
    // What the car touches at the start counts only if they part and touch again.
    for contact in &simulation.world().facts().contacts {
        touched[contact.track] = true;
    }
    let mut at_start = touched.clone();
    while simulation.world().step_count() + 1 < scene.scene().frames {
        simulation.step()?;
        let world = simulation.world();
        let motion = *world.motion();
        drive.motions.push(motion);
        drive.progress = drive.progress.max(along(&motion) - first);
        let step = world.step_count();
        if world.facts().on_edge {
            drive.off_road = drive.off_road.or(Some(step));
        }
        for (track, is_start) in at_start.iter_mut().enumerate() {
            if *is_start && !world.facts().contacts.iter().any(|contact| contact.track == track) {
                (*is_start, touched[track]) = (false, false);
            }
        }
        let mut new: Vec<_> =
            world.facts().contacts.iter().filter(|contact| !touched[contact.track]).collect();
        new.sort_by_key(|contact| (contact.substep, contact.track));
        for contact in new {
            touched[contact.track] = true;
            let is_it = |body: &&Body| body.track == contact.track;
            let found =
                world.bodies().iter().find(is_it).or_else(|| world.bodies_before().iter().find(is_it));
            if let Some(other) = found {
                let (car, areas) = (*world.motion_before(), [contact.own, contact.other]);
                drive.contacts.push(DriveContact { step, car, other: *other, areas });
            }
        }
        if until == Until::Contact && !drive.contacts.is_empty() {
            break;
        }
    }
    Ok(drive)
}
