//! Drivers in one scene: each drives it unchanged, and then against the attacks of every generator.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    objective::{Context, ContextOptions, Objective},
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    avoidable::{Avoidable, AvoidanceOptions},
    comfort::is_comfortable,
    drive::{Drive, OffRoad, Simulation, drive},
    fault::{FaultClass, classify},
    red_lights::over_red,
    vehicle::Motion,
};

use super::closed_loop::{Driven, DriverUnderTest};
use crate::{ego::Ego, generators::BuiltGenerator};

/// Scenes with a shorter logged drive have no completion, metres.
const SHORTEST_LOG: f64 = 5.0;

/// A driver in one scene.
pub(crate) struct TestedDriver {
    pub(crate) scene: String,
    pub(crate) unattacked: Unattacked,
    /// For each generator and operating point, the attack on this driver; empty in scenes without an adversary.
    pub(crate) attacks: Vec<Attacked>,
    /// Why there are no attacks, if they failed; true if the scene is left out, because nothing can be measured in it.
    pub(crate) failed: Option<(bool, String)>,
}

/// A drive in the unchanged scene.
pub(crate) struct Unattacked {
    pub(crate) steps: usize,
    /// First contacts: step, track and class.
    pub(crate) contacts: Vec<(usize, String, FaultClass)>,
    /// When the car leaves the road.
    pub(crate) off_road: OffRoad,
    /// Progress by the progress of the log; `None` if that is too short.
    pub(crate) completion: Option<f64>,
    /// Whether it keeps nuPlan's bounds of comfort, up to its first contact.
    pub(crate) is_comfortable: Option<bool>,
    /// Steps at which it runs over red, up to its first contact; `None` without a light ahead on its route.
    pub(crate) over_red: Option<Vec<usize>>,
}

/// An attack on a driver.
pub(crate) struct Attacked {
    pub(crate) driven: Driven,
    /// Whether the driver had a way out; `None` if the attack does not work.
    pub(crate) avoidable: Option<Avoidable>,
    /// As in [`Unattacked`], in the attacked drive.
    pub(crate) over_red: Option<Vec<usize>>,
}

impl Unattacked {
    fn of(drive: &Drive, data: &SceneData, scene: &SimScene, simulation: &Simulation) -> Self {
        let (car, log) = (simulation.world().car(), scene.window_length());
        let contacts = drive.contacts.iter().map(|contact| {
            let track = data.scene.tracks[contact.other.track].id.clone();
            (contact.step, track, classify(contact, car, &data.index))
        });
        Self {
            steps: drive.motions.len() - 1,
            contacts: contacts.collect(),
            off_road: drive.off_road,
            completion: (log >= SHORTEST_LOG).then(|| drive.progress / log),
            is_comfortable: is_comfortable(until_contact(drive)),
            over_red: over_red(scene, until_contact(drive)),
        }
    }

    /// Whether the ego is at fault in its first contact. Later ones are consequences of the first.
    pub(crate) fn is_at_fault(&self) -> bool {
        let first = self.contacts.first().map(|(step, ..)| *step);
        let at_first = self.contacts.iter().filter(|(step, ..)| Some(*step) == first);
        at_first.into_iter().any(|(_, _, class)| class.is_at_fault() == Some(true))
    }

    /// Whether the car leaves the road before any contact; `None` on a map without edges.
    pub(crate) fn is_off_road(&self) -> Option<bool> {
        let first = self.contacts.first().map_or(usize::MAX, |(step, ..)| *step);
        let is_before = self.off_road.step().is_some_and(|step| step < first);
        self.off_road.is_measured().then_some(is_before)
    }
}

/// The motions before the first contact: what it does to the car is not the driver's.
pub(super) fn until_contact(drive: &Drive) -> &[Motion] {
    let end = drive.contacts.first().map_or(drive.motions.len(), |contact| contact.step);
    &drive.motions[..end.min(drive.motions.len())]
}

/// What attacks the drivers.
pub(crate) struct Attackers<'a> {
    pub(crate) generators: &'a [BuiltGenerator],
    /// Its feasibility rule decides whether an attack counts.
    pub(crate) objective: &'a Objective,
    pub(crate) search: AvoidanceOptions,
    pub(crate) seed: u64,
}

/// A driver in a scene, unchanged and under all attacks.
///
/// *Errors*: the driver cannot drive in the scene.
pub(crate) fn test(
    data: &SceneData,
    scene: &Arc<SimScene>,
    ego: &Ego,
    attackers: Option<&Attackers>,
    seed: u64,
) -> Result<TestedDriver> {
    let mut simulation = Simulation::new(scene, &Arc::default(), None, &*ego.policy, seed)?;
    let drive = drive(&mut simulation)?;
    let unattacked = Unattacked::of(&drive, data, scene, &simulation);
    let attackers = attackers.filter(|_| data.scene.adversary.is_some());
    let (attacks, failed) = match attackers.map(|attackers| attackers.attack(data, scene, ego, drive)) {
        None => (Vec::new(), None),
        Some(Ok(attacks)) => (attacks, None),
        Some(Err(error)) => {
            let is_left_out = matches!(error.downcast_ref(), Some(sage_core::Error::ContactNow { .. }));
            (Vec::new(), Some((is_left_out, format!("{error:#}"))))
        }
    };
    Ok(TestedDriver { scene: data.name.clone(), unattacked, attacks, failed })
}

impl Attackers<'_> {
    /// The attacks of all generators on the drive of a driver, and what it does against each.
    fn attack(
        &self,
        data: &SceneData,
        scene: &Arc<SimScene>,
        ego: &Ego,
        unattacked: Drive,
    ) -> Result<Vec<Attacked>> {
        data.scene.check_apart_now()?;
        let driver = DriverUnderTest::after(ego, scene, self.seed, unattacked);
        let recorded = driver.data(data);
        let ctx = Context::new(&recorded.scene, &recorded.index, &ContextOptions::default())?;
        let mut all = Vec::new();
        for built in self.generators {
            for attack in built.generator.attacks(&ctx, &built.points, self.seed)? {
                attack.check(&recorded.scene)?;
                let trajectory = attack.trajectory();
                let is_feasible =
                    self.objective.evaluate(&ctx.candidate(trajectory.clone()), &ctx).is_feasible();
                all.push(driver.attack_and_search(trajectory, is_feasible, &ctx, self.search)?);
            }
        }
        Ok(all)
    }
}
