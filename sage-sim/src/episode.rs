//! An episode: a drive from frame 0 to the ego's first contact or to the horizon, and what happened in it.
//!
//! Two episodes test an attack (`Attack` in closed loop): the policy first drives the unchanged scene, the
//! attack is planned against that drive, and the policy then drives again with the adversary on its plan.

use std::sync::Arc;

use sage_core::{
    geometry::{OrientedBox, Point, norm, sub},
    motion::{HORIZON, NOW, Trajectory},
    objective::{MIN_DEPTH, SideHit},
    scene::SceneIndex,
};

use crate::{
    Error,
    body::BodyKind,
    drive::{Drive, DriveContact, Recorder, Simulation},
    environment::ARRIVED,
    fault::{FaultClass, FaultRule, classify, is_slowed},
    policy::EgoPolicy,
    repeated::once_more_if_late,
    scene::SimScene,
    traffic::Plan,
    vehicle::SUBSTEP,
    world::World,
};

pub use crate::scene::LAST_FRAME;

/// Time for which both cars go on through a contact, to see how deep it becomes, seconds.
const THROUGH: f64 = 0.5;
/// Frames within which two contacts with the adversary are the same. Recorded boxes change from frame to frame,
/// those of a plan do not, so even a plan that repeats the recording touches a little earlier or later.
const SAME: usize = 5;
/// Scenes with a shorter logged drive have no completion, metres.
const SHORTEST_LOG: f64 = 5.0;

/// Why an episode ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The ego's first contact.
    Contact,
    /// Frame 90, or the last frame of a shorter recording.
    Horizon,
}

/// The first contact of the ego with a road user.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeContact {
    /// States and boxes when they meet.
    pub contact: DriveContact,
    /// Largest overlap of the boxes, metres. A replayed ego follows its path to the end; otherwise both go on
    /// with their velocities for 0.5 s.
    pub overlap: f64,
    /// Relative speed in the step of the contact, m/s.
    pub impact_speed: f64,
    /// Side of the ego that is hit.
    pub side_hit: SideHit,
    /// Class by nuPlan's rule, and with it who is at fault.
    pub class: FaultClass,
}

impl EpisodeContact {
    /// Whether the boxes overlap as much as in a believable attack.
    pub fn is_solid(&self) -> bool {
        self.overlap >= MIN_DEPTH
    }
}

/// A drive up to the first contact, and what happened in it. Times are frames; *now* is frame 10.
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::scene::SceneIndex;
/// use sage_data::procedural::{Kind, attacks, generate};
/// use sage_sim::{SimScene, episode::Episode, policy::policies, traffic::Plan};
///
/// let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
/// let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let replay = policies()?.build_default("replay")?;
///
/// // The recording has no contact. Some change of the adversary's speed or lane brings one about.
/// let unchanged = Episode::run(&simulated, None, &*replay, 0)?;
/// assert_eq!((unchanged.steps(), unchanged.contacts.len()), (90, 0));
/// let adversary = scene.adversary_index()?;
/// let hits = |plan: Plan| Episode::run(&simulated, Some(plan.into()), &*replay, 0);
/// let plans = attacks(&scene).into_iter().map(|(_, plan)| hits(Plan::of_adversary(&scene, &plan)?));
/// let episodes = plans.collect::<Result<Vec<_>, _>>()?;
/// let meets = |episode: &Episode| episode.first_contacts().any(|met| met.contact.other.track == adversary);
/// assert!(episodes.iter().any(meets));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    /// The drive up to its end.
    pub drive: Drive,
    /// Why it ends.
    pub end: End,
    /// First frame at which 95 % of the logged route are behind the ego.
    pub arrived: Option<usize>,
    /// Progress along the logged route by its length up to frame 90; `None` if that is below 5 m.
    pub completion: Option<f64>,
    /// First contact with each road user, in the order of time. A replayed ego also has those after the end,
    /// because contacts do not change its drive.
    pub contacts: Vec<EpisodeContact>,
    /// Whether the policy sets the poses of the car, so that a contact does not change them.
    pub is_posed: bool,
}

/// An episode in progress.
pub(crate) struct Progress {
    simulation: Simulation,
    recorder: Recorder,
    arrived: Option<usize>,
    /// Number of new contacts in the last step.
    found: usize,
    scene: Arc<SimScene>,
}

impl Progress {
    /// A policy at frame 0, with an optional plan of the adversary.
    ///
    /// *Errors*: as [`Simulation::new`].
    pub(crate) fn start(
        scene: &Arc<SimScene>,
        plan: Option<Arc<Plan>>,
        policy: &dyn EgoPolicy,
        seed: u64,
    ) -> Result<Self, Error> {
        let simulation = Simulation::new(scene, &Arc::default(), plan, policy, seed)?;
        let recorder = Recorder::new(&simulation);
        Ok(Self { simulation, recorder, arrived: None, found: 0, scene: scene.clone() })
    }

    /// Drives on to a frame, or to the first contact if that is earlier.
    ///
    /// *Errors*: as [`Simulation::step`]; that of a planner holds the drive up to there.
    pub(crate) fn drive_to(&mut self, frame: usize) -> Result<(), Error> {
        self.drive_on(frame, &mut |_| ())
    }

    /// The same; `each` is told of the world after each step.
    fn drive_on(&mut self, frame: usize, each: &mut dyn FnMut(&World)) -> Result<(), Error> {
        let last = frame.min(self.last());
        let route = self.scene.window_length();
        while self.found == 0 && self.simulation.world().step_count() < last {
            if let Err(error) = self.simulation.step() {
                return Err(error.with_drive(self.recorder.drive().clone()));
            }
            each(self.simulation.world());
            self.found = self.recorder.record(&self.simulation);
            if route >= SHORTEST_LOG && self.recorder.drive().progress > ARRIVED * route {
                self.arrived = self.arrived.or(Some(self.simulation.world().step_count()));
            }
        }
        Ok(())
    }

    /// A copy that goes on with another plan. Plans of the adversary are its log up to *now*, so until then their drives
    /// are the same.
    ///
    /// *Errors*: as [`Simulation::try_clone`] and [`Simulation::replace_plan`].
    pub(crate) fn with_plan(&self, plan: Arc<Plan>) -> Result<Self, Error> {
        let mut simulation = self.simulation.try_clone()?;
        simulation.replace_plan(plan)?;
        let (recorder, scene) = (self.recorder.clone(), self.scene.clone());
        Ok(Self { simulation, recorder, scene, ..*self })
    }

    fn last(&self) -> usize {
        LAST_FRAME.min(self.scene.scene().frames - 1)
    }

    /// Drives to the end, and on to the last frame for the path of an adversary that reacts at frames 11 to 90: it brakes
    /// after a contact, which ends the episode. Beyond the recording, and where the driver fails after the end, it stays.
    ///
    /// *Errors*: as [`Progress::drive_to`].
    fn finish_on(self, adversary: usize) -> Result<(Episode, Trajectory), Error> {
        let mut path: Vec<Point> = Vec::with_capacity(HORIZON);
        let now = self.scene.scene().tracks[adversary].point(NOW);
        let episode = self.finish_with(true, &mut |world| {
            let body = world.bodies().iter().find(|body| body.track == adversary);
            let place = body.map_or_else(|| path.last().copied().unwrap_or(now), |body| body.area.center);
            path.extend((world.step_count() > NOW).then_some(place));
        })?;
        let end = path.last().copied().unwrap_or(now);
        path.resize(HORIZON, end);
        Ok((episode, Trajectory::new("path of the reacting adversary", path)?))
    }

    /// Drives to the end.
    ///
    /// *Errors*: as [`Progress::drive_to`].
    pub(crate) fn finish(self) -> Result<Episode, Error> {
        self.finish_with(false, &mut |_| ())
    }

    /// Drives to the end, and with `goes_on` further to the last frame, although that is not part of the episode. `each` is
    /// told of the world after each step.
    fn finish_with(mut self, goes_on: bool, each: &mut dyn FnMut(&World)) -> Result<Episode, Error> {
        self.drive_on(LAST_FRAME, each)?;
        let last = self.last();
        let Self { mut simulation, mut recorder, arrived, found, scene } = self;
        let route = scene.window_length();
        let drive = recorder.drive().clone();
        simulation.stop_adversary();
        let overlaps = if found == 0 {
            Vec::new()
        } else if simulation.is_posed() {
            replayed_overlaps(&mut simulation, &mut recorder, last, each)?
        } else {
            drive.contacts.iter().map(overlap_ahead).collect()
        };
        let is_posed = simulation.is_posed();
        while goes_on && simulation.world().step_count() < last && simulation.step().is_ok() {
            each(simulation.world());
        }
        simulation.end().map_err(|error| error.with_drive(drive.clone()))?;
        let car = simulation.world().car();
        let all = recorder.finish();
        let contact = |(contact, overlap): (&DriveContact, f64)| {
            // A posed ego is where it is at the frame, as in the scores of an attack.
            let at_frame = [all.area(contact), contact.other.area];
            let [own, other] = if is_posed { &at_frame } else { &contact.areas };
            EpisodeContact {
                overlap,
                impact_speed: norm(sub(contact.velocities[1], contact.velocities[0])),
                side_hit: SideHit::of(own, other),
                class: classify(contact, car, scene.index()),
                contact: contact.clone(),
            }
        };
        let mut contacts: Vec<EpisodeContact> = all.contacts.iter().zip(overlaps).map(contact).collect();
        // Of contacts at the same time, the adversary's is the first.
        let planned = simulation.world().plan().map(|plan| plan.track);
        contacts.sort_by_key(|c| (c.contact.step, c.contact.substep, Some(c.contact.other.track) != planned));
        Ok(Episode {
            end: if found == 0 { End::Horizon } else { End::Contact },
            arrived,
            completion: (route >= SHORTEST_LOG).then(|| drive.progress / route),
            contacts,
            is_posed,
            drive,
        })
    }
}

impl Episode {
    /// Drives a policy with an optional plan of the adversary.
    ///
    /// *Errors*: as [`Simulation::new`] and [`Simulation::step`].
    pub fn run(
        scene: &Arc<SimScene>,
        plan: Option<Arc<Plan>>,
        policy: &dyn EgoPolicy,
        seed: u64,
    ) -> Result<Self, Error> {
        once_more_if_late(|| Progress::start(scene, plan.clone(), policy, seed)?.finish())
    }

    /// The same with a plan of an adversary that reacts, and the path that it drives.
    ///
    /// *Errors*: as [`Episode::run`].
    pub(crate) fn run_on(
        scene: &Arc<SimScene>,
        plan: Arc<Plan>,
        policy: &dyn EgoPolicy,
        seed: u64,
    ) -> Result<(Self, Trajectory), Error> {
        let adversary = plan.track;
        Progress::start(scene, Some(plan), policy, seed)?.finish_on(adversary)
    }

    /// Number of steps, which is also the last frame.
    pub fn steps(&self) -> usize {
        self.drive.motions.len() - 1
    }

    /// The contacts that end the episode, those of the earliest substep; empty without contact.
    pub fn first_contacts(&self) -> impl Iterator<Item = &EpisodeContact> {
        let time = |c: &EpisodeContact| (c.contact.step, c.contact.substep);
        let first = self.contacts.first().map(time);
        self.contacts.iter().take_while(move |c| Some(time(c)) == first)
    }

    /// Classifies the contacts by a rule of fault.
    pub(crate) fn apply_fault_rule(&mut self, rule: FaultRule, index: &SceneIndex) {
        for contact in self.contacts.iter_mut().filter(|_| rule == FaultRule::Careful) {
            if contact.class.is_at_fault() == Some(true)
                && is_slowed(&contact.contact, &self.drive.motions, index)
            {
                contact.class = FaultClass::SlowedEgo;
            }
        }
    }

    /// Compares this episode, in which the adversary follows a plan, with the drive without the plan.
    pub fn verdict(&self, adversary: usize, is_feasible: bool, unattacked: &Drive) -> Verdict {
        let hit = self.first_contacts().find(|c| c.contact.other.track == adversary);
        let hit = hit.filter(|c| {
            let frame = c.contact.step;
            let is_same = |other: &DriveContact| other.other.track == adversary && other.step <= frame + SAME;
            let is_known = |other: &DriveContact| other.step <= frame || is_same(other);
            let is_own = frame > NOW && is_feasible && c.class != FaultClass::Appeared;
            is_own && !unattacked.contacts.iter().any(is_known)
        });
        let is_vehicle = |c: &EpisodeContact| c.contact.other.kind == BodyKind::Vehicle;
        Verdict {
            attack: hit.is_some(),
            at_fault: hit.is_some_and(|c| c.class.is_at_fault() == Some(true)),
            solid: hit.is_some_and(EpisodeContact::is_solid),
            any_vehicle: self.first_contacts().any(is_vehicle),
        }
    }
}

/// Whether an attack works on a driver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Verdict {
    /// The ego's first contact is with the adversary, at frame 11 or later and not just after it appeared; the plan is feasible; without the
    /// attack there is no contact by then, and none with the adversary in the next 0.5 s.
    pub attack: bool,
    /// An attack in whose contact nuPlan's rule gives the fault to the ego.
    pub at_fault: bool,
    /// An attack with an overlap of at least 0.5 m.
    pub solid: bool,
    /// The published flag: the ego's first contact is with any vehicle.
    pub any_vehicle: bool,
}

/// Drives a replayed ego on to a frame. Returns the largest overlap with each road user that it meets, at
/// the frames; between them where no frame shows any.
fn replayed_overlaps(
    simulation: &mut Simulation,
    recorder: &mut Recorder,
    last: usize,
    each: &mut dyn FnMut(&World),
) -> Result<Vec<f64>, Error> {
    let mut deepest: Vec<f64> = Vec::new();
    loop {
        let (world, contacts) = (simulation.world(), &recorder.drive().contacts);
        deepest.resize(contacts.len(), 0.0);
        let area = world.area();
        for (depth, contact) in deepest.iter_mut().zip(contacts) {
            let other = world.bodies().iter().find(|body| body.track == contact.other.track);
            *depth = other.map_or(*depth, |body| depth.max(body.area.overlap_depth(&area)));
        }
        if world.step_count() >= last {
            break;
        }
        simulation.step()?;
        each(simulation.world());
        recorder.record(simulation);
    }
    let contacts = &recorder.drive().contacts;
    let between = |(depth, contact): (f64, &DriveContact)| {
        if depth > 0.0 { depth } else { contact.areas[1].overlap_depth(&contact.areas[0]) }
    };
    Ok(deepest.into_iter().zip(contacts).map(between).collect())
}

/// Largest overlap if both go on with their velocities, metres.
fn overlap_ahead(contact: &DriveContact) -> f64 {
    let count = (THROUGH / SUBSTEP).round() as usize;
    let after = |area: &OrientedBox, velocity: &Point, time: f64| {
        let [x, y] = area.center;
        OrientedBox { center: [x + time * velocity[0], y + time * velocity[1]], ..*area }
    };
    let depth = |k: usize| {
        let time = k as f64 * SUBSTEP;
        let [own, other] = [0, 1].map(|k| after(&contact.areas[k], &contact.velocities[k], time));
        other.overlap_depth(&own)
    };
    (0..=count).map(depth).fold(0.0, f64::max)
}
