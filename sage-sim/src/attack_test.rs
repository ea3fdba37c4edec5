//! The test of an attack on a driver: it drives the unchanged scene, the attack is planned against that drive, and it
//! drives again with the adversary on its plan.

use std::sync::Arc;

use sage_core::{
    generator::Attack,
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Convention, Encounter, release_reward},
    scene::Scene,
};

use crate::{
    Error,
    avoidable::{Avoidable, Avoidance, AvoidanceOptions},
    drive::{Drive, Simulation, drive},
    episode::{Episode, EpisodeContact, Progress, Verdict},
    fault::FaultRule,
    policy::EgoPolicy,
    red_lights::over_red,
    reference::{Reference, Watching},
    repeated::once_more_if_late,
    scene::SimScene,
    traffic::Plan,
    unattacked::{UnattackedDrive, until_contact},
    vehicle::Vehicle,
};

/// A driver in one scene, with its drive before the attack.
///
/// A driver that follows the recording, without an attack and under one:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::scene::SceneIndex;
/// use sage_data::procedural::{Kind, attacks, generate};
/// use sage_sim::{SimScene, attack_test::AttackTest, policy::policies};
///
/// let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
/// let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
/// let replay = policies()?.build_default("replay")?;
/// let test = AttackTest::new(&*replay, &simulated, 0)?;
/// assert!(test.unattacked().contacts.is_empty());
///
/// let outcomes = attacks(&scene).into_iter().map(|(_, plan)| test.attack(&plan, true));
/// let outcomes = outcomes.collect::<Result<Vec<_>, _>>()?;
/// // An attack works if the first contact is with the adversary, and not there without it.
/// let works = outcomes.iter().filter(|outcome| outcome.verdict.attack).collect::<Vec<_>>();
/// assert!(!works.is_empty() && works.iter().all(|outcome| outcome.meets_adversary()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct AttackTest<'p> {
    policy: &'p dyn EgoPolicy,
    scene: Arc<SimScene>,
    seed: u64,
    unattacked: Drive,
    car: Vehicle,
    references: &'p [Reference],
    fault: FaultRule,
}

impl<'p> AttackTest<'p> {
    /// Drives the unchanged scene, from frame 0 to the end of the recording.
    ///
    /// *Errors*: the policy cannot drive in this scene.
    pub fn new(policy: &'p dyn EgoPolicy, scene: &Arc<SimScene>, seed: u64) -> Result<Self, Error> {
        let (unattacked, car) = once_more_if_late(|| {
            let mut simulation = Simulation::new(scene, &Arc::default(), None, policy, seed)?;
            Ok((drive(&mut simulation)?, *simulation.world().car()))
        })?;
        Ok(Self {
            policy,
            scene: scene.clone(),
            seed,
            unattacked,
            car,
            references: &[],
            fault: FaultRule::Nuplan,
        })
    }

    /// The test with drivers that say whether a contact is preventable.
    #[must_use]
    pub fn with_references(mut self, references: &'p [Reference]) -> Self {
        self.references = references;
        self
    }

    /// The test with a rule of who is at fault in an attack.
    #[must_use]
    pub fn with_fault(mut self, rule: FaultRule) -> Self {
        self.fault = rule;
        self
    }

    /// The same test in the scene without some road users: ego, adversary and those that `stays` names by their number stay. The
    /// unattacked drive is made anew.
    ///
    /// *Errors*: the policy cannot drive there.
    pub fn among(&self, stays: impl Fn(usize) -> bool) -> Result<Self, Error> {
        let scene = self.scene.on_same_map(Arc::new(self.scene().among(stays)))?;
        let test = Self::new(self.policy, &scene, self.seed)?;
        Ok(test.with_references(self.references).with_fault(self.fault))
    }

    /// The test with another driver, scene and seed, of which the drive without the attack is known.
    pub(crate) fn varied<'v>(
        &self,
        policy: &'v dyn EgoPolicy,
        scene: &Arc<SimScene>,
        seed: u64,
        unattacked: Drive,
    ) -> AttackTest<'v>
    where
        'p: 'v,
    {
        AttackTest {
            policy,
            scene: scene.clone(),
            seed,
            unattacked,
            car: self.car,
            references: self.references,
            fault: self.fault,
        }
    }

    /// The driver.
    pub(crate) fn policy(&self) -> &dyn EgoPolicy {
        self.policy
    }

    /// Seed of random numbers.
    pub(crate) fn seed(&self) -> u64 {
        self.seed
    }

    /// The reference drivers, which have watched the drive up to *now*.
    ///
    /// *Errors*: the scene has no adversary.
    pub fn watching(&self) -> Result<Watching<'p>, Error> {
        Watching::new(self.references, &self.scene, &self.unattacked.controls, self.seed)
    }

    /// The scene in motion.
    pub(crate) fn simulated(&self) -> &Arc<SimScene> {
        &self.scene
    }

    /// Whether the driver repeats the recording.
    pub fn is_recording(&self) -> bool {
        self.policy.is_recording()
    }

    /// The unchanged scene.
    pub fn scene(&self) -> &Arc<Scene> {
        self.scene.scene()
    }

    /// The drive before the attack.
    pub fn unattacked(&self) -> &Drive {
        &self.unattacked
    }

    /// The driver's car.
    pub fn car(&self) -> &Vehicle {
        &self.car
    }

    /// What happened in the drive before the attack.
    pub fn unattacked_drive(&self) -> UnattackedDrive {
        UnattackedDrive::of(&self.unattacked, &self.scene, &self.car)
    }

    /// The scene as a generator sees it: with the drive before the attack in place of the ego's recording.
    pub fn scene_as_driven(&self) -> Arc<Scene> {
        scene_as_driven(&self.scene, Some(&self.unattacked).filter(|_| !self.is_recording()))
    }

    /// The context of [`AttackTest::scene_as_driven`].
    ///
    /// *Errors*: the scene cannot be attacked.
    pub fn context(&self) -> Result<Context, Error> {
        Ok(Context::new(&self.scene_as_driven(), self.scene.index(), &ContextOptions::default())?)
    }

    /// The drive up to *now*, which is the same for all attacks: it is driven once and copied, which gives the same bits
    /// (tested). `None` for a driver that cannot be copied there, such as a program; each of its drives begins at frame 0.
    pub(crate) fn until_now(&self) -> Option<Progress> {
        let adversary = self.scene.scene().adversary().ok()?;
        let log = Trajectory::new("log", vec![adversary.point(NOW); HORIZON]).ok()?;
        let plan = Arc::new(Plan::of_adversary(self.scene.scene(), &log).ok()?);
        let mut progress = Progress::start(&self.scene, Some(plan.clone()), self.policy, self.seed).ok()?;
        // A driver that cannot be copied says so at the first copy.
        progress.with_plan(plan).ok()?;
        progress.drive_to(NOW).ok()?;
        Some(progress)
    }

    /// The adversary's path in an attack: the plan, or what an adversary that reacts drives against this driver.
    ///
    /// *Errors*: as [`Episode::run`].
    pub fn path_of(&self, attack: &Attack) -> Result<AttackPath, Error> {
        AttackPath::driven(self.policy, &self.scene, attack, self.seed)
    }

    /// Drives again, against an attack; a drive of an adversary that reacts is not repeated.
    ///
    /// *Errors*: as [`Episode::run`].
    pub fn attack_along(&self, path: AttackPath, is_feasible: bool) -> Result<AttackOutcome, Error> {
        let AttackPath { trajectory, episode: Some(mut episode) } = path else {
            return self.attack(&path.trajectory, is_feasible);
        };
        let adversary = self.scene.scene().adversary_index()?;
        episode.apply_fault_rule(self.fault, self.scene.index());
        let verdict = episode.verdict(adversary, is_feasible, &self.unattacked);
        Ok(AttackOutcome { scene: self.scene.clone(), attack: trajectory, adversary, episode, verdict })
    }

    /// Drives again, against a plan.
    ///
    /// *Errors*: as [`Episode::run`].
    pub fn attack(&self, attack: &Trajectory, is_feasible: bool) -> Result<AttackOutcome, Error> {
        self.attack_from(None, attack, is_feasible)
    }

    /// The same, continued from [`AttackTest::until_now`] if that is given.
    ///
    /// *Errors*: as [`Episode::run`].
    pub(crate) fn attack_from(
        &self,
        until_now: Option<&Progress>,
        attack: &Trajectory,
        is_feasible: bool,
    ) -> Result<AttackOutcome, Error> {
        let scene = self.scene.scene();
        let adversary = scene.adversary_index()?;
        let plan = Arc::new(Plan::of_adversary(scene, attack)?);
        let mut episode = match until_now {
            Some(progress) => progress.with_plan(plan)?.finish()?,
            None => Episode::run(&self.scene, Some(plan), self.policy, self.seed)?,
        };
        episode.apply_fault_rule(self.fault, self.scene.index());
        let verdict = episode.verdict(adversary, is_feasible, &self.unattacked);
        Ok(AttackOutcome { scene: self.scene.clone(), attack: attack.clone(), adversary, episode, verdict })
    }
}

/// The adversary's path in an attack.
#[derive(Clone, Debug)]
pub struct AttackPath {
    /// Its positions at frames 11 to 90.
    pub trajectory: Trajectory,
    /// The driver's episode, if the adversary reacts: the path is that of this drive.
    episode: Option<Episode>,
}

impl AttackPath {
    /// The path of an attack on a policy. An adversary that reacts is driven against it.
    ///
    /// *Errors*: as [`Episode::run`].
    pub fn driven(
        policy: &dyn EgoPolicy,
        scene: &Arc<SimScene>,
        attack: &Attack,
        seed: u64,
    ) -> Result<Self, Error> {
        if attack.reaction.is_none() {
            return Ok(Self::of(attack.trajectory().clone()));
        }
        let plan = Arc::new(Plan::of_attack(scene.scene(), attack)?);
        let (episode, trajectory) = Episode::run_on(scene, plan, policy, seed)?;
        Ok(Self { trajectory, episode: Some(episode) })
    }

    /// The path of an adversary that follows a plan.
    pub fn of(trajectory: Trajectory) -> Self {
        Self { trajectory, episode: None }
    }
}

/// The scene with a drive in place of the ego's recording; without a drive the scene itself.
pub fn scene_as_driven(scene: &SimScene, drive: Option<&Drive>) -> Arc<Scene> {
    drive.map_or_else(|| scene.scene().clone(), |drive| Arc::new(drive.scene_as_driven(scene)))
}

/// What a driver does against an attack, up to its first contact.
pub struct AttackOutcome {
    scene: Arc<SimScene>,
    attack: Trajectory,
    adversary: usize,
    /// The attacked drive.
    pub episode: Episode,
    /// Whether the attack works.
    pub verdict: Verdict,
}

impl AttackOutcome {
    /// Identifier of a track of the scene.
    pub fn track(&self, number: usize) -> &str {
        &self.scene.scene().tracks[number].id
    }

    /// The first contact, if it is with the adversary.
    fn hit(&self) -> Option<&EpisodeContact> {
        self.episode.first_contacts().find(|contact| contact.contact.other.track == self.adversary)
    }

    /// Whether the first contact is with the adversary.
    pub fn meets_adversary(&self) -> bool {
        self.hit().is_some()
    }

    /// The paper's reward: 10 (1 − t/80) at a contact with the adversary, else closeness. The horizon stays 80
    /// steps, although the episode ends at the contact.
    pub fn reward(&self) -> f64 {
        let hit = self.hit();
        let path = self.episode.drive.motions.iter().skip(NOW + 1);
        let distances = path.zip(self.attack.points()).map(|(motion, p)| {
            let [x, y] = motion.position;
            (x - p[0]).hypot(y - p[1])
        });
        let contact = hit.map(|c| c.contact.step.saturating_sub(NOW)).filter(|step| *step > 0);
        let least_distance = distances.fold(f64::INFINITY, f64::min);
        Encounter { contact, least_distance, steps: HORIZON }.reward(Convention::Paper)
    }

    /// The published reward, and whether the plan's box meets the ego's. The ego's path is cut at the end of the episode,
    /// so a contact scores little. `ctx` is that of the attack.
    pub fn reward_cut(&self, ctx: &Context) -> (f64, bool) {
        let motions = self.episode.drive.motions.iter().skip(NOW + 1);
        let path: Vec<_> = motions.map(|motion| motion.position).collect();
        release_reward(self.attack.points(), ctx.size(), &path, ctx.ego_size())
    }

    /// Frames at which the driver runs over red; `None` without a light ahead on its route.
    pub fn over_red(&self) -> Option<Vec<usize>> {
        over_red(&self.scene, until_contact(&self.episode.drive))
    }

    /// The search for an evasive manoeuvre in the attacked drive; `None` if the attack does not work.
    ///
    /// *Errors*: as [`Avoidance::new`].
    pub fn avoidable(&self, search: AvoidanceOptions) -> Result<Option<Avoidable>, Error> {
        let Some(contact) = self.episode.contacts.first().filter(|_| self.verdict.attack) else {
            return Ok(None);
        };
        let attacked: Arc<Scene> = self.episode.drive.scene_as_driven(&self.scene).into();
        let ctx = Context::new(&attacked, self.scene.index(), &ContextOptions::default())?;
        let step = contact.contact.step.checked_sub(NOW);
        Ok(Some(Avoidance::new(&ctx, search)?.of_contact(&ctx.candidate(self.attack.clone()), step)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::policies;
    use sage_core::scene::SceneIndex;
    use sage_data::procedural::{Kind, generate};

    #[test]
    fn a_drive_continued_from_now_has_the_bits_of_a_whole_one() {
        let kinds = [Kind::FourWay, Kind::Merge, Kind::Straight];
        let mut contacts = 0;
        for (seed, kind) in (0..6).zip(kinds.into_iter().cycle()) {
            let Some(scene) = generate(kind, seed, 0) else { continue };
            let index = SceneIndex::new(scene.map.clone());
            let simulated = SimScene::new(Arc::new(scene), index).unwrap();
            for name in ["replay", "idm", "expert", "pdm", "r157", "td3"] {
                let policy = policies().unwrap().build_default(name).unwrap();
                let test = AttackTest::new(&*policy, &simulated, seed).unwrap();
                let until_now = test.until_now().unwrap();
                let track = simulated.scene().adversary().unwrap();
                let [x, y] = track.point(NOW);
                for meets in [20, 30, 45] {
                    // Straight to where the recorded ego is after some steps.
                    let [to_x, to_y] = simulated.scene().ego().point(NOW + meets);
                    let at = |step: usize| {
                        let share = step as f64 / meets as f64;
                        [x + share * (to_x - x), y + share * (to_y - y)]
                    };
                    let plan = Trajectory::new("straight", (1..=HORIZON).map(at).collect()).unwrap();
                    let whole = test.attack(&plan, true).unwrap();
                    let continued = test.attack_from(Some(&until_now), &plan, true).unwrap();
                    assert_eq!(continued.episode, whole.episode, "{kind:?} {seed}, {name}, {meets}");
                    assert_eq!(continued.verdict, whole.verdict);
                    contacts += usize::from(!whole.episode.contacts.is_empty());
                }
            }
        }
        assert!(contacts > 10, "the drives have contacts: {contacts}");
    }
}
