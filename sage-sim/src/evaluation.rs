//! The published evaluation of a driver in closed loop: one episode per scene, which the first contact with a vehicle
//! ends; first the unchanged scene, then the scene with an attack against that very drive.

mod standing;

use std::sync::Arc;

use sage_core::{defect, generator::OperatingPoint, geometry::norm, motion::DT};
use serde::{Deserialize, Serialize};

use crate::{
    Error,
    attacker::Attacker,
    drive::{Drive, OffRoad, found},
    environment::{Environment, EnvironmentOptions, Outcome},
    fault::classify,
    observation::ObservationKind,
    policy::{ControlledVehicle, EgoPolicy, Start, View},
    scene::SimScene,
    traffic::Plan,
};
use standing::Standing;

/// Step whose completion is reported besides that at the end: the last recorded frame.
const LAST_RECORDED: usize = 90;

/// One episode of an evaluation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct EpisodeRow {
    /// Number of the scene.
    pub scene: usize,
    /// Why there is no episode: the policy failed, or the scene could not be attacked. It counts as a failure.
    pub failed: Option<String>,
    /// Whether its planner failed, a program: then nothing is known of the driver, and the episode counts in no rate.
    #[serde(skip)]
    pub is_without_result: bool,
    /// Steps of 0.1 s.
    pub steps: usize,
    /// Sum of the rewards.
    pub reward: f64,
    /// Sum of the costs.
    pub cost: f64,
    /// Share of the route at the end.
    pub completion: f64,
    /// Share of the route at frame 90, or at an earlier end.
    pub completion_recorded: f64,
    /// Contact with a vehicle in the last step.
    pub contact: bool,
    /// A contact for which nuPlan's rule gives the fault to the ego.
    pub at_fault: bool,
    /// Contact with the adversary.
    pub adversary: bool,
    /// Off the road in any step, usually the last one; `None` on a map without edges.
    pub off_road: Option<bool>,
    /// Arrival.
    pub arrived: bool,
    /// End by the limit of steps.
    pub time_limit: bool,
    /// Mean speed, m/s.
    pub speed: f64,
    /// Mean size of the jerk, m/s³, over the steps with two predecessors.
    pub jerk: f64,
    /// Whether it stood for 3 s before the end of its recorded route, though neither a road user nor a red light was within
    /// 15 m ahead.
    pub standing: bool,
}

/// Rules of the evaluation with some rules of training: a contact with a vehicle ends the episode, and a limit of steps
/// is told from other ends.
pub fn evaluation_rules(training: &EnvironmentOptions) -> Arc<EnvironmentOptions> {
    Arc::new(EnvironmentOptions {
        contact_ends: true,
        any_contact_ends: false,
        limit_terminates: false,
        ..training.clone()
    })
}

/// Drives one episode. Returns what happened and the drive.
///
/// *Errors*: as [`Environment::reset`], [`EgoPolicy::start`], and the driver's own.
pub fn drive_episode(
    policy: &dyn EgoPolicy,
    scene: &Arc<SimScene>,
    plan: Option<Arc<Plan>>,
    rules: &Arc<EnvironmentOptions>,
    seed: u64,
) -> Result<(EpisodeRow, Drive), Error> {
    let adversary = scene.scene().adversary;
    let own = rules.observation == policy.observes()
        || (rules.observation == ObservationKind::MetaDrive
            && policy.observes() == ObservationKind::Corrected);
    let rules = match own {
        true => rules.clone(),
        false => Arc::new(EnvironmentOptions { observation: policy.observes(), ..(**rules).clone() }),
    };
    let mut environment = Environment::reset(scene.clone(), rules, plan, seed)?;
    let track = scene.scene().ego;
    let knowledge = policy.knows();
    let mut driver = policy.start(&Start::new(scene, track, knowledge, seed))?;
    let start = *environment.world().motion();
    let off_road = OffRoad::start(scene.index().map());
    let mut drive = Drive { motions: vec![start], off_road, ..Drive::default() };
    let mut row = EpisodeRow::default();
    let mut standing = Standing::default();
    while !environment.is_over() {
        let control = {
            let world = environment.world();
            let vehicle = ControlledVehicle {
                track,
                routes: [scene.guide(), scene.route()],
                motion: *world.motion(),
                area: world.area(),
                ground: world.level(),
                others: world.bodies(),
            };
            driver.control(&View::new(world, vehicle, knowledge, Some(environment.observed())))?
        };
        let outcome = environment.step_with(control)?;
        drive.motions.push(*environment.world().motion());
        row.count(&outcome, environment.world().step_count());
        standing.count(environment.world(), scene.guide());
        if environment.options().goes_on {
            // What is not a number stays so.
            for completion in [&mut row.completion, &mut row.completion_recorded] {
                *completion = if *completion > 1.0 { 1.0 } else { *completion };
            }
        }
    }
    row.off_road = row.off_road.filter(|_| off_road.is_measured());
    row.off_road = row.off_road.map(|leaves| leaves && !scene.recording_leaves_road());
    row.standing = standing.is_long();
    let world = environment.world();
    for contact in &world.events().contacts {
        drive.contacts.extend(found(world, contact));
        row.adversary |= Some(contact.track) == adversary;
    }
    if row.contact {
        let classes = drive.contacts.iter().map(|contact| classify(contact, world.car(), scene.index()));
        row.at_fault = classes.into_iter().any(|class| class.is_at_fault() == Some(true));
    }
    row.motion_statistics(&drive);
    Ok((row, drive))
}

impl EpisodeRow {
    fn failure(number: usize, scene: &SimScene, error: &Error) -> Self {
        let off_road = scene.index().map().has_edges().then_some(false);
        let is_without_result = matches!(error, Error::Planner { .. });
        Self {
            scene: number,
            failed: Some(error.to_string()),
            is_without_result,
            off_road,
            ..Self::default()
        }
    }

    fn count(&mut self, outcome: &Outcome, step: usize) {
        self.steps = step;
        self.reward += outcome.reward;
        self.cost += outcome.cost;
        self.completion = outcome.completion;
        if step <= LAST_RECORDED {
            self.completion_recorded = outcome.completion;
        }
        self.contact = outcome.vehicle_contact;
        self.off_road = Some(self.off_road == Some(true) || outcome.out_of_road);
        self.arrived |= outcome.arrived;
        self.time_limit = outcome.truncated;
    }

    fn motion_statistics(&mut self, drive: &Drive) {
        let velocities: Vec<_> = drive.motions.iter().map(|motion| motion.velocity).collect();
        let mean = |sum: f64, count: usize| if count == 0 { 0.0 } else { sum / count as f64 };
        self.speed = mean(velocities[1..].iter().map(|v| norm(*v)).sum(), velocities.len() - 1);
        let jerk = |w: &[[f64; 2]]| norm([0, 1].map(|k| w[0][k] - 2.0 * w[1][k] + w[2][k])) / (DT * DT);
        self.jerk = mean(velocities.windows(3).map(jerk).sum(), velocities.len().saturating_sub(2));
    }
}

/// Drives one unchanged scene; a failed row and no drive if that is not possible.
pub fn drive_scene(
    policy: &dyn EgoPolicy,
    scene: &Arc<SimScene>,
    number: usize,
    rules: &Arc<EnvironmentOptions>,
    seed: u64,
) -> (EpisodeRow, Option<Drive>) {
    match caught(scene, || drive_episode(policy, scene, None, rules, seed)) {
        Ok((row, drive)) => (EpisodeRow { scene: number, ..row }, Some(drive)),
        Err(error) => (EpisodeRow::failure(number, scene, &error), None),
    }
}

/// The result of work on a scene; a panic within is an error of that scene.
fn caught<T>(scene: &SimScene, work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    defect::caught(work).unwrap_or_else(|defect| Err(scene.error(defect.to_string())))
}

/// Drives one scene against an attack at λ = 1 that is planned against the drive in the unchanged scene. What cannot be
/// attacked or driven is a failed row.
pub fn attack_episode(
    policy: &dyn EgoPolicy,
    scene: &Arc<SimScene>,
    number: usize,
    unchanged: Option<&Drive>,
    attacker: &dyn Attacker,
    rules: &Arc<EnvironmentOptions>,
    seed: u64,
) -> EpisodeRow {
    // A drive that is too short to be attacked: the recording is attacked instead.
    let drive = unchanged.filter(|drive| drive.motions.len() > SHORTEST_DRIVE);
    let attacked = || {
        let plan = attacker.plan(scene, drive, &OperatingPoint::at(1.0, 1.0), seed)?;
        drive_episode(policy, scene, Some(plan), rules, seed)
    };
    match caught(scene, attacked) {
        Ok((row, _)) => EpisodeRow { scene: number, ..row },
        Err(error) => EpisodeRow::failure(number, scene, &error),
    }
}

/// Steps of a drive below which an attack is planned against the recording instead: ten positions after *now*.
pub const SHORTEST_DRIVE: usize = 21;
