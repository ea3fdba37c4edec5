//! What SEAL learns from in one scene: roll-outs of a car-following driver, alone and against each candidate.

use std::sync::Arc;

use advsage::generators::{Against, BuiltGenerator};
use anyhow::{Context as _, Result};
use sage_baselines::{
    relative_paths,
    rollout::{
        Rollout, RolloutEnd, Targets, WINDOW, roll_out, rollout_driver, rules, seats, targets, windows,
    },
    seal::networks::{SkillWindows, relative_path, training::CriticalityExample},
};
use sage_core::{
    generator::{Attack, Proposal},
    geometry::distance,
    motion::{HORIZON, NOW},
    objective::{Context, ContextOptions},
    scene::SceneData,
};
use sage_sim::{SimScene, attack_test::AttackTest, policy::EgoPolicy, traffic::Plan};
use serde::Serialize;

const _: () =
    assert!(WINDOW == sage_baselines::seal::networks::WINDOW, "drives are cut as networks read them");

/// Other vehicles of an attacked roll-out from which the score learns too: those that come nearest to the ego.
const OTHERS: usize = 4;
/// Other cars that drive a scene in the ego's place, for more windows.
const SEATS: usize = 1;

/// Numbers of what was collected.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Counts {
    pub scenes: usize,
    /// Roll-outs without an attack, and how many of them ended in a contact.
    pub unattacked: usize,
    pub unattacked_contacts: usize,
    /// Roll-outs against a candidate, and how many of them ended in a contact.
    pub attacked: usize,
    pub attacked_contacts: usize,
    pub steps: usize,
    /// Windows of ordinary driving, and those that start in the last 20 steps before a contact.
    pub windows: usize,
    pub windows_before_contact: usize,
    /// Examples of the score: candidates, and other vehicles.
    pub candidates: usize,
    pub others: usize,
}

/// What was collected in some scenes.
#[derive(Default)]
pub(super) struct Collected {
    pub examples: Vec<CriticalityExample>,
    pub ordinary: SkillWindows,
    pub before_contact: SkillWindows,
    pub counts: Counts,
}

impl Collected {
    /// Adds what was collected in another scene.
    pub(super) fn add(&mut self, other: Self) {
        let scene = self.counts.scenes as u32;
        self.examples
            .extend(other.examples.into_iter().map(|example| CriticalityExample { scene, ..example }));
        append(&mut self.ordinary, other.ordinary);
        append(&mut self.before_contact, other.before_contact);
        let (all, new) = (&mut self.counts, other.counts);
        all.scenes += new.scenes;
        all.unattacked += new.unattacked;
        all.unattacked_contacts += new.unattacked_contacts;
        all.attacked += new.attacked;
        all.attacked_contacts += new.attacked_contacts;
        all.steps += new.steps;
        all.windows += new.windows;
        all.windows_before_contact += new.windows_before_contact;
        all.candidates += new.candidates;
        all.others += new.others;
    }
}

/// Appends windows; their roll-outs get the next numbers.
fn append(all: &mut SkillWindows, new: SkillWindows) {
    let next = all.groups.last().map_or(0, |last| last + 1);
    all.observations.extend(new.observations);
    all.actions.extend(new.actions);
    all.groups.extend(new.groups.into_iter().map(|group| next + group));
}

/// The driver of the roll-outs in a scene, and the candidates of the prior there.
pub(super) struct RolloutScene {
    pub scene: Arc<SimScene>,
    pub driver: Box<dyn EgoPolicy>,
    /// The scene with the driver's undisturbed drive as the ego's path.
    pub undisturbed: Context,
    /// The recorded scene.
    pub recorded: Context,
    pub attack: Attack,
    pub unattacked: Rollout,
    seed: u64,
}

impl RolloutScene {
    /// Drives a scene without an attack, and proposes candidates in it.
    ///
    /// *Errors*: the scene cannot be driven or attacked.
    pub(super) fn new(data: &SceneData, candidates: &BuiltGenerator, seed: u64) -> Result<Self> {
        let scene = SimScene::new(data.scene.clone(), data.index.clone())?;
        let driver = rollout_driver().map_err(anyhow::Error::msg)?;
        let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
        let attacks = candidates.attacks(&ctx, Against::Recording, seed)?;
        let attack = attacks.into_iter().next().context("the prior proposes nothing")?;
        let undisturbed = AttackTest::new(&*driver, &scene, seed)?.context()?;
        let unattacked = roll_out(&*driver, &scene, None, &rules(), seed)?;
        Ok(Self { scene, driver, undisturbed, recorded: ctx, attack, unattacked, seed })
    }

    /// The roll-out against a plan, and its scores.
    ///
    /// *Errors*: the scene cannot be driven.
    pub(super) fn against(&self, plan: Plan) -> Result<(Rollout, Targets)> {
        let adversary = plan.track;
        let rollout = self.driven(&*self.driver, plan)?;
        let ego = self.scene.scene().ego;
        let found = targets(&rollout, &self.unattacked, ego, adversary, true);
        Ok((rollout, found.context("the roll-outs have no common frame")?))
    }

    /// The roll-out of any driver against a plan.
    ///
    /// *Errors*: the scene cannot be driven.
    pub(super) fn driven(&self, driver: &dyn EgoPolicy, plan: Plan) -> Result<Rollout> {
        Ok(roll_out(driver, &self.scene, Some(Arc::new(plan)), &rules(), self.seed)?)
    }

    /// The plan of a candidate.
    ///
    /// *Errors*: the scene has no adversary.
    pub(super) fn plan(&self, candidate: &Proposal) -> Result<Plan> {
        Ok(Plan::of_adversary(self.scene.scene(), &candidate.trajectory)?)
    }

    /// The ego's undisturbed path seen from the adversary on a candidate.
    pub(super) fn sequence(&self, candidate: &Proposal) -> Vec<[f32; 3]> {
        let ctx = &self.undisturbed;
        let points = candidate.trajectory.points();
        relative_paths(ctx.scene(), ctx.adversary(), points, &ctx.egos()[..1]).swap_remove(0)
    }
}

/// Collects in one scene.
///
/// *Errors*: the scene cannot be driven or attacked.
pub(super) fn collect(data: &SceneData, candidates: &BuiltGenerator, seed: u64) -> Result<Collected> {
    let rollouts = RolloutScene::new(data, candidates, seed)?;
    let mut collected =
        Collected { counts: Counts { scenes: 1, ..Counts::default() }, ..Collected::default() };
    collected.note_unattacked(&rollouts.unattacked);
    for seat in seats(&data.scene, &data.index, SEATS) {
        collected.note_unattacked(&roll_out(&*rollouts.driver, &seat, None, &rules(), seed)?);
    }
    for candidate in &rollouts.attack.candidates {
        let plan = rollouts.plan(candidate)?;
        let adversary = plan.track;
        let (rollout, found) = rollouts.against(plan)?;
        collected.learn(rollouts.sequence(candidate), found, false);
        let others = nearest_others(&rollout, data.scene.ego, adversary);
        for track in others {
            let Some(found) = targets(&rollout, &rollouts.unattacked, data.scene.ego, track, false) else {
                continue;
            };
            let sequence = relative_path(&undisturbed_path(&rollouts.undisturbed), &rollout.poses[track]);
            collected.learn(sequence, found, true);
            collected.counts.others += 1;
        }
        collected.counts.candidates += 1;
        collected.counts.attacked += 1;
        collected.counts.attacked_contacts += usize::from(rollout.end == RolloutEnd::Contact);
        collected.counts.steps += rollout.actions.len();
        collected.counts.windows_before_contact += take(&mut collected.before_contact, &rollout, true);
    }
    Ok(collected)
}

impl Collected {
    /// Adds an example of the score.
    fn learn(&mut self, sequence: Vec<[f32; 3]>, found: Targets, is_auxiliary: bool) {
        let targets = [found.collision as f32, found.difference as f32];
        self.examples.push(CriticalityExample { scene: 0, sequence, targets, is_auxiliary });
    }

    fn note_unattacked(&mut self, rollout: &Rollout) {
        self.counts.unattacked += 1;
        self.counts.unattacked_contacts += usize::from(rollout.end == RolloutEnd::Contact);
        self.counts.steps += rollout.actions.len();
        self.counts.windows += take(&mut self.ordinary, rollout, false);
        self.counts.windows_before_contact += take(&mut self.before_contact, rollout, true);
    }
}

/// Takes the windows of a roll-out; returns their number.
fn take(all: &mut SkillWindows, rollout: &Rollout, before_contact: bool) -> usize {
    let starts = windows(rollout, before_contact);
    let group = all.groups.last().map_or(0, |last| last + 1);
    for start in starts.clone() {
        for step in start..start + WINDOW {
            let action = rollout.actions[step];
            all.observations.extend(rollout.observations[step].iter());
            all.actions.extend([action.steer as f32, action.throttle as f32]);
        }
        all.groups.push(group);
    }
    starts.len()
}

/// The other vehicles that come nearest to the ego in a roll-out, the nearest first.
fn nearest_others(rollout: &Rollout, ego: usize, adversary: usize) -> Vec<usize> {
    let tracks = (0..rollout.poses.len()).filter(|track| ![ego, adversary].contains(track));
    let nearest = |track: usize| {
        let gaps = rollout.path(ego).zip(rollout.path(track)).filter_map(|(a, b)| Some(distance(a?, b?)));
        Some((gaps.min_by(f64::total_cmp)?, track))
    };
    let mut all: Vec<(f64, usize)> = tracks.filter_map(nearest).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.truncate(OTHERS);
    all.into_iter().map(|(_, track)| track).collect()
}

/// The ego's undisturbed path at frames 0 to 90.
fn undisturbed_path(ctx: &Context) -> Vec<Option<[f64; 2]>> {
    let ego = ctx.scene().ego();
    (0..=NOW + HORIZON).map(|frame| ego.is_valid(frame).then(|| ego.point(frame))).collect()
}
