//! The world of a drive: the car, the traffic around it, and what they touch.
//!
//! A step lasts 0.1 s, the interval of the frames, and has five substeps of the physics. Contacts come from
//! exact tests of the boxes after each substep; the response to a contact comes from rapier. A drive starts at
//! frame 0; after step `n` the traffic is at frame `n`.
//!
//! A trailer of the ego, or of an adversary that does not repeat its recording, is towed along; the ego does not meet its own.
//!
//! On maps with levels, road users more than 3 m above or below the car do not meet it. The car follows the
//! height of the nearest lane of its own level.

mod control;
mod moving;
mod nearby;
mod options;
mod towing;

use std::sync::Arc;

pub use control::Control;
pub use options::WorldOptions;
use sage_core::{
    Error as CoreError,
    geometry::OrientedBox,
    scene::{EdgesSinceStart, is_one_level},
};

use crate::{
    Error,
    body::{Body, BodyKind},
    lines::LineKind,
    scene::SimScene,
    traffic::{EgoBody, Plan, Traffic},
    vehicle::{Motion, SUBSTEPS, Tyres, Vehicle},
};

/// Depth of an overlap at the start that is taken as an error of the recorded boxes, metres.
const START_OVERLAP: f64 = 0.5;

/// First contact with a road user in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Index of the track.
    pub track: usize,
    /// Substep, 1 to 5.
    pub substep: usize,
    /// The car's box at that substep, before the contact pushes it.
    pub own: OrientedBox,
    /// The other's box at that substep.
    pub other: OrientedBox,
}

/// What the car touches in a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepEvents {
    /// Road users touched, each once, in the order of the substep, then of their tracks.
    pub contacts: Vec<Contact>,
    /// Whether it touches a solid yellow line at the end.
    pub on_yellow: bool,
    /// Whether it touches another solid line at the end.
    pub on_white: bool,
    /// Whether it touches a broken line at the end.
    pub on_broken: bool,
    /// Whether it touches a road edge at the end, or is on a sidewalk.
    pub on_edge: bool,
    /// The same, without the edges that it touches at the start and has not left yet.
    pub off_road: bool,
}

/// The adversary, if a policy drives it.
#[derive(Clone, Debug, PartialEq)]
struct Driven {
    body: Body,
    motion: Motion,
    tyres: Tyres,
}

/// Everything that changes in a world.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldState {
    /// Identifier of the scene.
    scene: Arc<str>,
    step: usize,
    /// Motion in the physics.
    physical: Motion,
    tyres: Tyres,
    /// Reported motion, now and one step ago.
    motion: Motion,
    before: Motion,
    level: f64,
    traffic: Traffic,
    driven: Option<Driven>,
    events: StepEvents,
    /// Edges that the car touches since the start.
    leaving: EdgesSinceStart,
}

/// A scene in motion. It owns what it needs; a clone continues on its own.
#[derive(Clone)]
pub struct World {
    scene: Arc<SimScene>,
    options: Arc<WorldOptions>,
    plan: Option<Arc<Plan>>,
    car: Vehicle,
    size: [f64; 2],
    state: WorldState,
}

impl World {
    /// A world at frame 0: the car with its logged pose and velocity.
    ///
    /// `seed` decides what the options leave open: strength of the car and classes of the traffic. `plan`
    /// replaces the log of one track.
    ///
    /// *Errors*: [`Error::Scene`] if the car starts inside another road user; [`CoreError::Length`] and
    /// [`CoreError::NotFinite`] for a plan that is shorter or longer than the scene, or not finite;
    /// [`CoreError::Options`] for a strength outside [0, 1].
    pub fn new(
        scene: Arc<SimScene>,
        options: Arc<WorldOptions>,
        plan: Option<Arc<Plan>>,
        seed: u64,
    ) -> Result<Self, Error> {
        let mut rng = sage_core::seed::Rng::new(seed, &scene.scene().id, "world");
        let strength = options.strength.unwrap_or_else(|| rng.uniform(0.0, 1.0));
        if !(0.0..=1.0).contains(&strength) {
            let problem = format!("`strength` is {strength}; expected a number from 0 to 1");
            return Err(CoreError::Options { kind: "simulation", name: "world", problem }.into());
        }
        if let Some(plan) = &plan {
            plan.check(scene.scene())?;
        }
        let cycle = rng.uniform(0.0, 100.0) as u64;
        let car = Vehicle::of_strength(strength);
        let size = if options.traffic.class_sizes { car.size } else { scene.ego_size() };
        let log = scene.log();
        let motion = Motion {
            position: log.point(0),
            heading: log.heading[0],
            velocity: log.velocity[0],
            yaw_rate: 0.0,
        };
        let level = log.position[0][2] - 0.5 * log.size[0][2];
        let area = OrientedBox::new(motion.position, motion.heading, size[0], size[1]);
        let traffic = Traffic::start(&scene, &options.traffic, plan.as_deref(), &area, cycle);
        let state = WorldState {
            scene: scene.scene().id.as_str().into(),
            step: 0,
            physical: motion,
            tyres: Tyres::default(),
            motion,
            before: motion,
            level,
            traffic,
            driven: None,
            events: StepEvents::default(),
            leaving: EdgesSinceStart::default(),
        };
        let mut world = Self { scene, options, plan, car, size, state };
        let deep = world.bodies().iter().find(|body| {
            world.may_meet(body)
                && body.touches(&body.area, &area)
                && body.area.overlap_depth(&area) > START_OVERLAP
        });
        if let Some(body) = deep {
            let track = &world.scene.scene().tracks[body.track].id;
            let problem = format!(
                "the ego starts {:.1} m inside track `{track}` at frame 0; the option `skip_close` leaves such cars out",
                body.area.overlap_depth(&area)
            );
            return Err(world.scene.error(problem));
        }
        world.state.events.contacts = world.contacts_at(&area);
        world.touch_lines();
        Ok(world)
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<SimScene> {
        &self.scene
    }

    /// The options.
    pub fn options(&self) -> &WorldOptions {
        &self.options
    }

    /// The plan in place of a track's log.
    pub fn plan(&self) -> Option<&Plan> {
        self.plan.as_deref()
    }

    /// Goes on with another plan.
    ///
    /// *Errors*: as [`World::new`] for a plan.
    pub(crate) fn replace_plan(&mut self, plan: Arc<Plan>) -> Result<(), Error> {
        plan.check(self.scene.scene())?;
        self.plan = Some(plan);
        Ok(())
    }

    /// The car's constants.
    pub fn car(&self) -> &Vehicle {
        &self.car
    }

    /// Length and width of the car's box, metres.
    pub fn size(&self) -> [f64; 2] {
        self.size
    }

    /// Number of steps since the start; equals the frame of the traffic.
    pub fn step_count(&self) -> usize {
        self.state.step
    }

    /// The car's reported motion.
    pub fn motion(&self) -> &Motion {
        &self.state.motion
    }

    /// The car's reported motion one step ago; at the start, the motion of the start.
    pub fn motion_before(&self) -> &Motion {
        &self.state.before
    }

    /// The car's box at its reported pose.
    pub fn area(&self) -> OrientedBox {
        self.area_at(&self.state.motion)
    }

    /// The car as others see it.
    pub(crate) fn ego_body(&self) -> Body {
        let (scene, motion) = (self.scene.scene(), self.motion());
        Body {
            track: scene.ego,
            kind: BodyKind::of(scene.ego()),
            class: None,
            area: self.area(),
            heading: motion.heading,
            velocity: motion.velocity,
            yaw_rate: motion.yaw_rate,
            ground: self.level(),
            is_falling: false,
        }
    }

    /// The other road users.
    pub fn bodies(&self) -> &[Body] {
        self.state.traffic.bodies()
    }

    /// The other road users one step ago.
    pub fn bodies_before(&self) -> &[Body] {
        self.state.traffic.bodies_before()
    }

    /// Frame at which a road user that was absent at frame 0 came into being, if it is there by its recording or plan.
    pub(crate) fn appearance_of(&self, track: usize) -> Option<usize> {
        self.state.traffic.appearance_of(track)
    }

    /// Height of the ground under the car, metres.
    pub fn level(&self) -> f64 {
        self.state.level
    }

    /// What the car touched in the last step.
    pub fn events(&self) -> &StepEvents {
        &self.state.events
    }

    /// Everything that changes, to be restored later.
    pub fn state(&self) -> &WorldState {
        &self.state
    }

    /// Continues from a state of a world of the same scene.
    ///
    /// *Errors*: [`Error::Call`] if the state is of another scene.
    pub fn restore(&mut self, state: &WorldState) -> Result<(), Error> {
        if state.scene != self.state.scene || state.traffic.track_count() != self.state.traffic.track_count()
        {
            let problem = "the saved state belongs to another scene".to_owned();
            return Err(Error::Call { scene: self.scene.scene().id.clone(), problem });
        }
        self.state.clone_from(state);
        Ok(())
    }

    /// Lets a policy drive the adversary from now on; each step then needs its control.
    ///
    /// *Errors*: [`Error::Scene`] if there is no adversary now; a parked one is absent with
    /// [`crate::traffic::TrafficOptions::parked`] off.
    pub fn drive_adversary(&mut self) -> Result<(), Error> {
        let track = self.scene.scene().adversary_index()?;
        let Some(body) = self.state.traffic.take_over(track) else {
            return Err(self.scene.error("the adversary is absent, so no policy can drive it".to_owned()));
        };
        let motion = Motion {
            position: body.area.center,
            heading: body.heading,
            velocity: body.velocity,
            yaw_rate: body.yaw_rate,
        };
        self.state.driven = Some(Driven { body, motion, tyres: Tyres::default() });
        Ok(())
    }

    /// Motion and body of the adversary, if a policy drives it.
    pub fn adversary_motion(&self) -> Option<(&Motion, &Body)> {
        self.state.driven.as_ref().map(|driven| (&driven.motion, &driven.body))
    }

    /// Advances by one step. `adversary` is needed after [`World::drive_adversary`], and ignored otherwise.
    ///
    /// *Errors*: [`Error::Policy`] if a control is missing or not finite; the world is then as before. Also if
    /// the car's motion becomes too large.
    pub fn step(&mut self, control: Control, adversary: Option<Control>) -> Result<(), Error> {
        let theirs = adversary.filter(|_| self.state.driven.is_some());
        if theirs.is_none() && self.state.driven.is_some() {
            let problem = "a policy drives the adversary, but gave no control".to_owned();
            return Err(Error::Policy { scene: self.scene.scene().id.clone(), problem });
        }
        if let Some(problem) = [Some(control), theirs].iter().flatten().find_map(Control::problem) {
            let problem = format!("step {}: {problem}", self.state.step + 1);
            return Err(Error::Policy { scene: self.scene.scene().id.clone(), problem });
        }
        self.state.step += 1;
        self.state.before = self.state.motion;
        self.state.events.contacts.clear();
        if self.options.traffic.dynamic {
            // MetaDrive sets the others to the frame after the car has moved among them.
            self.move_ego(control);
            self.advance_traffic();
            self.move_adversary(theirs);
            self.tow_of_adversary();
        } else {
            self.advance_traffic();
            self.move_adversary(theirs);
            self.tow_of_adversary();
            self.move_ego(control);
        }
        self.tow_of_ego();
        let adversary = self.state.driven.as_ref().map(|driven| driven.motion);
        let motions = [Some(self.state.physical), adversary];
        if motions.iter().flatten().any(|motion| !motion.is_finite()) {
            let step = self.state.step;
            return Err(self.scene.error(format!("step {step}: the motion of a car is not finite")));
        }
        self.state.level = self.scene.follow_level(self.state.physical.position, self.state.level);
        self.touch_lines();
        Ok(())
    }

    fn advance_traffic(&mut self) {
        let (ego, frame) = (&self.state.physical, self.state.step);
        let ego = EgoBody { area: self.area_at(ego), velocity: ego.velocity };
        self.state.traffic.advance(&self.scene, &self.options.traffic, self.plan.as_deref(), &ego, frame);
    }

    fn move_ego(&mut self, control: Control) {
        match control {
            Control::Drive(action) => self.drive(action),
            Control::Pose { pose, velocity } => self.place(pose, velocity),
            Control::Follow { pose, velocity } => self.place(pose, Some(velocity)),
        }
    }

    fn area_at(&self, motion: &Motion) -> OrientedBox {
        OrientedBox::new(motion.position, motion.heading, self.size[0], self.size[1])
    }

    /// Contacts at the current frame.
    fn contacts_at(&self, car: &OrientedBox) -> Vec<Contact> {
        let touched =
            self.bodies().iter().filter(|body| self.may_meet(body) && body.touches(&body.area, car));
        touched
            .map(|body| Contact { track: body.track, substep: SUBSTEPS, own: *car, other: body.area })
            .collect()
    }

    /// Whether something at a height of the ground (metres) is on the car's level.
    pub fn is_level(&self, height: f64) -> bool {
        self.are_level(height, self.state.level)
    }

    /// Whether two heights of the ground (metres) are on one level.
    pub(crate) fn are_level(&self, a: f64, b: f64) -> bool {
        !self.has_levels() || is_one_level(a, b)
    }

    fn has_levels(&self) -> bool {
        !self.options.flat && self.scene.has_levels()
    }

    /// Whether a road user is on the car's level and not its own trailer.
    fn may_meet(&self, body: &Body) -> bool {
        let [own, _] = self.scene.hitches();
        self.is_level(body.ground) && own.is_none_or(|hitch| hitch.trailer != body.track)
    }

    /// Lines and edges under the car at the end of the step. MetaDrive tests lines at the physical pose and
    /// edges at the reported one.
    fn touch_lines(&mut self) {
        let lines = self.scene.lines(self.options.lines);
        let (mut yellow, mut white, mut broken) = (false, false, false);
        lines.touching(&self.area_at(&self.state.physical), |piece| {
            if self.is_level(piece.height) {
                match piece.kind {
                    LineKind::SolidYellow => yellow = true,
                    LineKind::SolidWhite => white = true,
                    LineKind::Broken => broken = true,
                    LineKind::Edge => {}
                }
            }
        });
        let mut edges = Vec::new();
        lines.touching(&self.area(), |piece| {
            if piece.kind == LineKind::Edge && self.is_level(piece.height) {
                edges.push(piece.feature);
            }
        });
        edges.extend(self.sidewalks_under());
        let off_road = self.leave_edges(&edges);
        let on_edge = !edges.is_empty();
        let (on_yellow, on_white, on_broken) = (yellow, white, broken);
        let contacts = std::mem::take(&mut self.state.events.contacts);
        self.state.events = StepEvents { contacts, on_yellow, on_white, on_broken, on_edge, off_road };
    }

    /// Features of the sidewalks that the car is on.
    fn sidewalks_under(&self) -> impl Iterator<Item = u32> {
        let (sidewalks, area) = (self.scene.index().sidewalks(), self.area());
        let near = if sidewalks.is_empty() { Vec::new() } else { sidewalks.near(&area.aabb()) };
        near.into_iter()
            .filter(move |k| self.is_level(sidewalks.height(*k)) && sidewalks.meets(*k, &area))
            .map(|k| sidewalks.feature(k))
    }

    /// Follows the edges that the car touches since the start. Returns whether it touches another one.
    fn leave_edges(&mut self, edges: &[u32]) -> bool {
        if self.state.step == 0 {
            self.state.leaving = EdgesSinceStart::new(edges);
            return false;
        }
        let map = self.scene.index().map();
        self.state.leaving.follow(edges, map).is_some()
    }
}
