//! Generators against the recorded ego or against drivers: the selected trajectories, and what drivers do.

mod metrics;
mod slots;

use std::{collections::HashMap, path::Path, sync::Arc, time::Instant};

use advsage::{ego::Ego, generators::Against, latest_start, prepared};
use sage_backbones::Backbone;
use sage_core::{
    generator::Attack,
    metric::{MeasuredTrajectory, Metric, MetricInfo},
    objective::{Context, ContextOptions, Feasibility as _, FurtherMeasures, MapFeasibility, Objective},
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    attack_test::{AttackPath, AttackTest},
    avoidable::{Avoidance, AvoidanceOptions},
    metrics::MeasuredAttack,
    policy::{EgoPolicy, StepTimes, Timed},
    unattacked::{Again, UnattackedDrive},
};

pub use metrics::{Choice, MeasuredPlan};
use metrics::{OF_PLAN, PlanAndDrive, attacked_metrics, plan_metrics, sample_metrics};
use slots::{OfAttack, Slot, Source};

use super::{
    ByPrior, Group, MeasuredScene, Measurement, SceneResult, cell, ego_samples::EgoSamples, infos, leaves_out,
};
use crate::{
    Error, Registries, Result, in_one_line,
    rows::{Cell, Key, Subject},
    study::{PlannedAgainst, Study},
};

/// What all attacks on one ego share that are measured with one prior.
struct Prepared<'a> {
    ctx: Arc<Context>,
    /// Whether a generator may query the driver: not where attacks are planned against the log.
    may_query: bool,
    /// `None` if trajectories are not measured.
    measured: Option<MeasuredScene<'a>>,
    avoidance: Option<Avoidance>,
    samples: Option<EgoSamples>,
}

/// Metrics for which a driver drives once more.
const OF_SECOND_DRIVE: [&str; 2] = ["step time", "same again"];

/// Which subjects a study measures.
struct Measures {
    drive: bool,
    trajectory: bool,
    attacked_drive: bool,
}

/// Metrics that need a search for evasive manoeuvres.
struct Searches {
    of_plans: bool,
    of_attacked_drives: bool,
}

/// Generators and drivers of a study.
pub struct Attacks {
    /// Drivers; empty for the recording.
    egos: Vec<Ego>,
    /// Times of their steps.
    times: Vec<Arc<StepTimes>>,
    groups: Vec<Group>,
    /// What is measured, in the order of the keys.
    slots: Vec<Slot>,
    keys: Vec<Key>,
    /// Number of the key of each slot.
    numbers: HashMap<Slot, usize>,
    drives: Vec<Metric<UnattackedDrive>>,
    attacked: Vec<Metric<PlanAndDrive>>,
    plans: Vec<Metric<MeasuredPlan>>,
    further: FurtherMeasures,
    /// What selects an attack.
    objective: Objective,
    /// Search for evasive manoeuvres from the ego's path and in attacked drives.
    search: AvoidanceOptions,
    searches: Searches,
    targets: Vec<f64>,
    /// Paths that attacks on drivers are planned against.
    planned_against: Vec<PlannedAgainst>,
    measures: Measures,
    /// Whether drives in unchanged scenes are repeated.
    repeats_drives: bool,
    seed: u64,
}

/// The same driver once more; a drive that fails is not the same.
fn again(policy: &dyn EgoPolicy, scene: &Arc<SimScene>, test: &AttackTest, seed: u64) -> Again {
    let times = Arc::<StepTimes>::default();
    let timed = Timed::new(policy, times.clone());
    let second = AttackTest::new(&timed, scene, seed);
    let is_same = second.is_ok_and(|second| second.unattacked().motions == test.unattacked().motions);
    Again { is_same, step_time: times.mean() }
}

impl Attacks {
    /// Checks metrics and drivers.
    ///
    /// *Errors*: a name that is not registered.
    pub fn new(
        study: &Study,
        registries: &Registries,
        egos: Vec<Ego>,
        groups: Vec<Group>,
        objective: Objective,
    ) -> Result<Self> {
        let listed = |subject| study.metrics.get(&subject).cloned().unwrap_or_default();
        let spec = Some(objective.spec());
        let mut names = listed(Subject::Trajectory);
        if study.avoidable.is_some() && study.measures(Subject::Trajectory) {
            // The search was asked for, so its metrics are shown.
            let of_search = registries.metrics.avoidable.all().iter().map(|m| m.info.name.to_string());
            let of_samples = sample_metrics().map(|m| m.info.name.to_string());
            let of_search = of_search.chain(of_samples);
            names.extend(of_search.filter(|name| !listed(Subject::Trajectory).contains(name)));
        }
        let is_built_in = |name: &&String| {
            let mut known = registries.metrics.trajectory.all().iter().map(|metric| &metric.info.name);
            known.any(|known| known == *name)
        };
        let of_parts: Vec<String> = names.iter().filter(|name| !is_built_in(name)).cloned().collect();
        let further = FurtherMeasures::listed(
            &registries.parts.rewards,
            &registries.parts.feasibilities,
            spec,
            &of_parts,
        )?;
        let plans = plan_metrics(registries, &further, study)?.by_names(&names)?;
        let drives = registries.metrics.drive.by_names(&listed(Subject::Drive))?;
        let mut attack_names = listed(Subject::AttackedDrive);
        if study.avoidable.is_some() {
            // The search was asked for, so its metrics are shown.
            let costly = registries.metrics.attack.all().iter().filter(|m| m.info.is_costly);
            let missing: Vec<String> = costly.map(|m| m.info.name.to_string()).collect();
            attack_names
                .extend(missing.into_iter().filter(|name| !listed(Subject::AttackedDrive).contains(name)));
        }
        let attacked = attacked_metrics(registries, &attack_names)?.by_names(&attack_names)?;
        let measures = Measures {
            drive: study.measures(Subject::Drive),
            trajectory: study.measures(Subject::Trajectory),
            attacked_drive: study.measures(Subject::AttackedDrive),
        };
        let is_costly = |infos: &[MetricInfo]| infos.iter().any(|info| info.is_costly);
        let searches = Searches {
            of_plans: is_costly(&infos(&plans)),
            of_attacked_drives: is_costly(&infos(&attacked)),
        };
        let mut all = Self {
            times: egos.iter().map(|_| Arc::default()).collect(),
            egos,
            groups,
            slots: Vec::new(),
            keys: Vec::new(),
            numbers: HashMap::new(),
            drives,
            attacked: if measures.attacked_drive { attacked } else { Vec::new() },
            plans,
            further,
            objective,
            search: study.avoidable.unwrap_or_default(),
            searches,
            targets: study.latest_start.clone(),
            planned_against: match &study.planned_against[..] {
                [] => vec![PlannedAgainst::Drive],
                given => given.to_vec(),
            },
            measures,
            repeats_drives: listed(Subject::Drive).iter().any(|name| OF_SECOND_DRIVE.contains(&&**name)),
            seed: study.seed,
        };
        all.slots = all.make_slots();
        all.keys = all.slots.iter().map(|slot| all.key(slot)).collect();
        all.numbers = all.slots.iter().enumerate().map(|(k, slot)| (*slot, k)).collect();
        Ok(all)
    }

    /// The paths that attacks on an ego are planned against; one without a name for the recorded ego.
    fn paths(&self, is_driver: bool) -> impl Iterator<Item = Option<PlannedAgainst>> + use<> {
        let of_driver = || self.planned_against.iter().copied().map(Some).collect();
        let paths = if is_driver { of_driver() } else { vec![None] };
        paths.into_iter()
    }

    /// Numbers of the keys of some slots.
    fn keys_of<'s>(&'s self, is_of: impl Fn(&Slot) -> bool + 's) -> impl Iterator<Item = usize> + 's {
        self.slots.iter().enumerate().filter(move |(_, slot)| is_of(slot)).map(|(key, _)| key)
    }

    /// Cells of one ego, by its number; the recorded one without a driver.
    fn of_ego(
        &self,
        data: &SceneData,
        number: usize,
        driver: Option<(&Ego, &Result<Arc<SimScene>, sage_sim::Error>)>,
        result: &mut SceneResult,
    ) {
        let timed = driver.map(|(ego, _)| Timed::new(&*ego.policy, self.times[number].clone()));
        let test = driver.zip(timed.as_ref()).map(
            |((_, simulated), policy)| -> Result<(AttackTest<'_>, SceneData)> {
                let simulated = simulated.as_ref().map_err(|error| Error::Value(error.to_string()))?;
                let test = AttackTest::new(policy, simulated, self.seed)?;
                let (name, index) = (data.name.clone(), data.index.clone());
                let recorded = SceneData { name, scene: test.scene_as_driven(), index };
                Ok((test, recorded))
            },
        );
        let test = match test.transpose() {
            Ok(test) => test,
            Err(error) => {
                let keys = self.keys_of(|slot| slot.ego() == number);
                result.cells.extend(keys.map(|key| Cell::failed(key, in_one_line(&error))));
                return;
            }
        };
        if let (Some((test, _)), Some(key)) = (&test, self.numbers.get(&Slot::Drive { ego: number })) {
            let mut drive = test.unattacked_drive();
            if self.repeats_drives
                && let Some((ego, Ok(simulated))) = driver
            {
                drive.again = Some(again(&*ego.policy, simulated, test, self.seed));
            }
            result.cells.push(cell(*key, &self.drives, &drive));
        }
        // Without an adversary there is nothing to attack with.
        if data.scene.adversary.is_none() {
            return;
        }
        let paths = self.paths(driver.is_some());
        let mut prepared: Vec<_> = paths.map(|path| (path, ByPrior(Vec::new()))).collect();
        for (k, group) in self.groups.iter().enumerate() {
            for (path, prepared) in &mut prepared {
                let may_query = !matches!(path, Some(PlannedAgainst::Log));
                let data = match (&test, &path) {
                    (Some((_, recorded)), Some(PlannedAgainst::Drive)) => recorded,
                    _ => data,
                };
                let prepared = prepared.get(group, |prior| self.prepare(data, prior, may_query));
                for generator in 0..group.built.len() {
                    let by = Source { ego: number, path: *path, group: k, generator };
                    self.of_source(by, prepared, test.as_ref().map(|(test, _)| test), result);
                }
            }
        }
    }

    fn prepare(&self, data: &SceneData, prior: &dyn Backbone, may_query: bool) -> Result<Prepared<'_>> {
        let ctx = Arc::new(prepared::recording(&data.scene, &data.index)?);
        let of_plan = |metric: &Metric<PlanAndDrive>| metric.info.name.starts_with(OF_PLAN);
        let is_shown = self.measures.trajectory || self.attacked.iter().any(of_plan);
        let is_measured = is_shown && self.targets.is_empty();
        let measured = is_measured.then(|| MeasuredScene::new(ctx.clone(), data, prior, &self.further));
        let is_searched = self.searches.of_plans || !self.targets.is_empty();
        let avoidance = is_searched.then(|| Avoidance::new(&ctx, self.search));
        let is_sampled = is_measured && self.searches.of_plans;
        let samples = is_sampled.then(|| EgoSamples::of(data, &ctx, prior)).transpose()?;
        let (measured, avoidance) = (measured.transpose()?, avoidance.transpose()?);
        Ok(Prepared { ctx, may_query, measured, avoidance, samples })
    }

    fn of_source(
        &self,
        by: Source,
        prepared: &Result<Prepared>,
        test: Option<&AttackTest>,
        result: &mut SceneResult,
    ) {
        let known = prepared.as_ref().map_err(|error| Error::Value(in_one_line(error)));
        match known.and_then(|prepared| self.of_generator(by, prepared, test)) {
            Ok(cells) => result.cells.extend(cells),
            Err(error) => {
                let reason = in_one_line(&error);
                let mut keys = self.keys_of(|slot| slot.source() == Some(by));
                let is_left_out = prepared.as_ref().is_err_and(leaves_out) || leaves_out(&error);
                if is_left_out {
                    let first = keys.next().map(|key| format!("{}: {reason}", self.keys[key].stream()));
                    result.left_out.extend(first);
                } else {
                    result.cells.extend(keys.map(|key| Cell::failed(key, &reason)));
                }
            }
        }
    }

    fn of_generator(&self, by: Source, prepared: &Prepared, test: Option<&AttackTest>) -> Result<Vec<Cell>> {
        let built = &self.groups[by.group].built[by.generator];
        let Prepared { ctx, may_query, measured, avoidance, samples } = prepared;
        let clock = Instant::now();
        let attacks = match test {
            Some(test) if *may_query => built.planned(ctx, Against::Driver(test), self.seed)?,
            Some(test) => built.planned(ctx, Against::Drive(test), self.seed)?,
            None => built.attacks(ctx, Against::Recording, self.seed)?,
        };
        let seconds = clock.elapsed().as_secs_f64() / attacks.len() as f64;
        let mut cells = Vec::new();
        for (number, (attack, point)) in attacks.into_iter().zip(&built.points).enumerate() {
            let key = |what| self.numbers.get(&Slot::Attack { by, point: number, what });
            attack.check(ctx.scene())?;
            let path = match test {
                Some(test) => test.path_of(&attack)?,
                None => AttackPath::of(attack.trajectory().clone()),
            };
            let attack = &attack.with_drive(path.trajectory.clone(), "the driver under test");
            let mut plan = None;
            if let Some(scene) = measured {
                plan = Some(Arc::new(scene.measured(attack, seconds)?));
            }
            if let (Some(trajectory), Some(key)) = (&plan, key(OfAttack::Plan)) {
                let avoidable = avoidance.as_ref().map(|avoidance| avoidance.of(&trajectory.candidate));
                let samples_hit = samples.as_ref().map(|samples| samples.share_hit(&trajectory.candidate));
                let plan = MeasuredPlan {
                    trajectory: Some(trajectory.clone()),
                    avoidable,
                    samples_hit,
                    choice: None,
                };
                cells.push(cell(*key, &self.plans, &plan));
            }
            if let Some(avoidance) = avoidance.as_ref().filter(|_| !self.targets.is_empty()) {
                let avoided =
                    latest_start::avoidable_candidates(attack, ctx, &self.objective, point.mu, avoidance);
                for (k, target) in self.targets.iter().enumerate() {
                    let Some(key) = key(OfAttack::AtTarget(k)) else { continue };
                    let time = latest_start::nearest_to(&avoided, *target).map(|one| one.time);
                    let choice = Some(Choice { target: *target, time });
                    cells.push(cell(*key, &self.plans, &MeasuredPlan { choice, ..MeasuredPlan::default() }));
                }
            }
            if let (Some(test), Some(key)) = (test, key(OfAttack::Drive)) {
                cells.push(self.attacked_cell(path, ctx, test, plan, *key)?);
            }
        }
        Ok(cells)
    }

    fn attacked_cell(
        &self,
        path: AttackPath,
        ctx: &Context,
        test: &AttackTest,
        plan: Option<Arc<MeasuredTrajectory>>,
        key: usize,
    ) -> Result<Cell> {
        let candidate = ctx.candidate(path.trajectory.clone());
        // As everywhere, the paper's rule says whether an attack counts, whatever the selection asks for.
        let is_feasible = MapFeasibility::default().is_feasible(&candidate, ctx);
        let outcome = test.attack_along(path, is_feasible)?;
        let is_searched = self.searches.of_attacked_drives;
        let avoidable = if is_searched { outcome.avoidable(self.search)? } else { None };
        let (over_red, reward_cut) = (outcome.over_red(), outcome.reward_cut(ctx));
        let measured = MeasuredAttack { outcome, avoidable, is_searched, over_red, reward_cut };
        Ok(cell(key, &self.attacked, &PlanAndDrive { attack: measured, plan }))
    }
}

impl Measurement for Attacks {
    fn write_logs_to(&self, folder: &Path) {
        self.egos.iter().for_each(|ego| ego.policy.write_logs_to(folder));
    }

    fn step_times(&self) -> Vec<(&str, &StepTimes)> {
        self.egos.iter().zip(&self.times).map(|(ego, times)| (&*ego.label, &**times)).collect()
    }

    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        let all = [
            ((Subject::Drive, infos(&self.drives)), self.measures.drive),
            ((Subject::Trajectory, infos(&self.plans)), self.measures.trajectory),
            ((Subject::AttackedDrive, infos(&self.attacked)), self.measures.attacked_drive),
        ];
        all.into_iter().filter(|(_, is_measured)| *is_measured).map(|(one, _)| one).collect()
    }

    fn attack(&self, key: usize, data: &SceneData) -> Result<Option<Attack>> {
        let Slot::Attack { by, point, what: OfAttack::Plan } = self.slots[key] else { return Ok(None) };
        if !self.egos.is_empty() {
            return Ok(None);
        }
        let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
        let built = &self.groups[by.group].built[by.generator];
        Ok(built.attacks(&ctx, Against::Recording, self.seed)?.into_iter().nth(point))
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let mut result = SceneResult::default();
        if self.egos.is_empty() {
            self.of_ego(data, 0, None, &mut result);
            return result;
        }
        let simulated = SimScene::new(data.scene.clone(), data.index.clone());
        for (number, ego) in self.egos.iter().enumerate() {
            self.of_ego(data, number, Some((ego, &simulated)), &mut result);
        }
        result
    }
}
