//! Reference drivers: whether a contact of the driver under test is *preventable*, by a driver that does not know the plan.
//!
//! A reference watches the drive of the driver under test up to *now*: it sees what that one sees, and what it would do is
//! dropped. At *now* it takes the car over, and drives to the end of the recording. It *prevents* the contact if it has none
//! with the adversary and none at its own fault with anybody, and stays on the road. References are asked in their order,
//! up to the first that prevents the contact.

use std::{cell::OnceCell, sync::Arc};

use sage_core::motion::{HORIZON, NOW, Trajectory};
use serde::{Deserialize, Serialize};

use crate::{
    Error,
    drive::{Recorder, Simulation},
    fault::classify,
    policy::EgoPolicy,
    scene::{LAST_FRAME, SimScene},
    traffic::Plan,
    vehicle::Motion,
    world::Control,
};

/// Names of the default references, in the order in which they are asked.
pub const DEFAULT: [&str; 4] = ["r157", "idm", "pdm", "expert"];

/// The same for a pedestrian or cyclist as the adversary: the first sees who is about to cross, and costs little.
pub const DEFAULT_OF_PEOPLE: [&str; 4] = ["expert", "r157", "idm", "pdm"];

/// A reference driver.
///
/// Whether a careful and competent driver prevents what the recorded ego does not:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::scene::SceneIndex;
/// use sage_data::procedural::{Kind, attacks, generate};
/// use sage_sim::{SimScene, attack_test::AttackTest, policy::policies, reference::Reference};
///
/// let scene = Arc::new(generate(Kind::Straight, 1, 0).ok_or("no scene for this seed")?);
/// let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let (replay, r157) = (policies()?.build_default("replay")?, policies()?.build_default("r157")?);
/// let references = [Reference { name: "r157".to_owned(), policy: r157 }];
/// let test = AttackTest::new(&*replay, &simulated, 0)?.with_references(&references);
///
/// // It watches up to *now*, and then takes over; of the plan it knows nothing.
/// let (_, plan) = attacks(&scene).remove(0);
/// let prevention = test.watching()?.prevention(&plan)?;
/// assert_eq!(prevention.answers.len(), 1);
/// assert_eq!(prevention.by(), Some("r157").filter(|_| prevention.answers[0].prevents == Some(true)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Reference {
    /// Its name, as rows show it.
    pub name: String,
    /// The driver.
    pub policy: Box<dyn EgoPolicy>,
}

/// What a reference does in place of the driver under test.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Its name.
    pub reference: String,
    /// Whether it prevents the contact; `None` if it cannot drive here, which counts as no.
    pub prevents: Option<bool>,
}

/// How a contact is prevented, or not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prevention {
    /// The references that were asked; only the last can have prevented the contact.
    pub answers: Vec<Answer>,
    /// The motions of the last one at *now* and each frame after it.
    pub motions: Vec<Motion>,
}

impl Prevention {
    /// The reference that prevents the contact.
    pub fn by(&self) -> Option<&str> {
        self.answers.last().filter(|answer| answer.prevents == Some(true)).map(|answer| &*answer.reference)
    }
}

/// References in the order in which they are asked: the given one, or [`DEFAULT_OF_PEOPLE`] in place of [`DEFAULT`].
fn in_order(references: &[Reference], is_person: bool) -> Vec<&Reference> {
    let place =
        |order: [&str; 4], reference: &Reference| order.iter().position(|name| *name == reference.name);
    let places: Option<Vec<usize>> = references.iter().map(|reference| place(DEFAULT, reference)).collect();
    let is_default = places.is_some_and(|places| places.is_sorted());
    let mut ordered: Vec<&Reference> = references.iter().collect();
    if is_person && is_default {
        ordered.sort_by_key(|reference| place(DEFAULT_OF_PEOPLE, reference));
    }
    ordered
}

/// References that have watched the driver of a test up to *now*.
pub struct Watching<'r> {
    references: Vec<Watched<'r>>,
    scene: Arc<SimScene>,
    /// What the car did up to *now*, and until then the plan, which is the log.
    controls: Vec<Control>,
    log: Arc<Plan>,
    seed: u64,
    adversary: usize,
}

/// A reference with its simulation at *now*, once it is asked; none if it cannot drive here, or not be copied.
struct Watched<'r> {
    reference: &'r Reference,
    at_now: OnceCell<Option<Simulation>>,
}

impl<'r> Watching<'r> {
    /// References that watch a drive in a scene, given by what the car did in each step, once they are asked. One that cannot drive here, or not be
    /// copied, answers `None`.
    ///
    /// *Errors*: the scene has no adversary.
    pub(crate) fn new(
        references: &'r [Reference],
        scene: &Arc<SimScene>,
        controls: &[Control],
        seed: u64,
    ) -> Result<Self, Error> {
        let adversary = scene.scene().adversary_index()?;
        let log = Trajectory::new("log", vec![scene.scene().tracks[adversary].point(NOW); HORIZON])?;
        let log = Arc::new(Plan::of_adversary(scene.scene(), &log)?);
        let controls = controls.iter().take(NOW).copied().collect();
        let is_person = scene.scene().adversary()?.kind.is_person();
        let references = in_order(references, is_person);
        let watched = |reference| Watched { reference, at_now: OnceCell::new() };
        let references = references.into_iter().map(watched).collect();
        Ok(Self { references, scene: scene.clone(), controls, log, seed, adversary })
    }

    /// Lets a reference watch the drive up to *now*.
    ///
    /// *Errors*: it cannot drive here, or not be copied.
    fn watch(&self, reference: &Reference) -> Result<Simulation, Error> {
        let (plan, policy) = (Some(self.log.clone()), &*reference.policy);
        let mut simulation = Simulation::new(&self.scene, &Arc::default(), plan, policy, self.seed)?;
        for control in &self.controls {
            simulation.watch(*control)?;
        }
        simulation.try_clone()?;
        Ok(simulation)
    }

    /// Asks the references for a plan, up to the first that prevents the contact.
    ///
    /// *Errors*: the plan is none for this scene.
    pub fn prevention(&self, plan: &Trajectory) -> Result<Prevention, Error> {
        let mut prevention = Prevention::default();
        for Watched { reference, at_now } in &self.references {
            let driven = match at_now.get_or_init(|| self.watch(reference).ok()) {
                Some(simulation) => {
                    let plan = Arc::new(Plan::of_adversary(simulation.world().scene().scene(), plan)?);
                    self.drive(simulation, plan).ok()
                }
                None => None,
            };
            let prevents = driven.as_ref().map(|(prevents, _)| *prevents);
            prevention.motions = driven.map_or(Vec::new(), |(_, motions)| motions);
            prevention.answers.push(Answer { reference: reference.name.clone(), prevents });
            if prevents == Some(true) {
                break;
            }
        }
        Ok(prevention)
    }

    /// Whether a reference prevents the contact, and its motions from *now* on.
    fn drive(&self, at_now: &Simulation, plan: Arc<Plan>) -> Result<(bool, Vec<Motion>), Error> {
        let mut simulation = at_now.try_clone()?;
        simulation.replace_plan(plan)?;
        let mut recorder = Recorder::new(&simulation);
        let last = LAST_FRAME.min(simulation.world().scene().scene().frames - 1);
        while simulation.world().step_count() < last {
            simulation.step()?;
            let new = recorder.record(&simulation);
            let (world, drive) = (simulation.world(), recorder.drive());
            let fails = |contact: &crate::drive::DriveContact| {
                contact.other.track == self.adversary
                    || classify(contact, world.car(), world.scene().index()).is_at_fault() == Some(true)
            };
            let contacts = &drive.contacts[drive.contacts.len() - new..];
            if drive.off_road.step().is_some() || contacts.iter().any(fails) {
                return Ok((false, recorder.finish().motions));
            }
        }
        Ok((true, recorder.finish().motions))
    }
}
