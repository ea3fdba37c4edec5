//! Generators against the recorded ego or against drivers: the selected trajectories, and what drivers do.

mod metrics;

use std::{path::Path, sync::Arc, time::Instant};

use advsage::{
    ego::Ego,
    generators::{Against, BuiltGenerator},
    latest_start, prepared,
};
use anyhow::{Result, anyhow};
use sage_backbones::Backbone;
use sage_core::{
    generator::Attack,
    metric::{MeasuredTrajectory, Metric, MetricInfo},
    objective::{Context, ContextOptions, FurtherMeasures, Objective},
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    attack_test::{AttackPath, AttackTest},
    avoidable::{Avoidance, AvoidanceOptions},
    metrics::MeasuredAttack,
    unattacked::UnattackedDrive,
};

pub use metrics::{Choice, MeasuredPlan};
use metrics::{OF_PLAN, PlanAndDrive, attacked_metrics, plan_metrics};

use super::{
    ByPrior, Group, MeasuredScene, Measurement, SceneResult, cell,
    ego_samples::{self, EgoSamples},
    infos, is_contact_now,
};
use crate::{
    Registries,
    rows::{Cell, Key, Subject},
    study::{PlannedAgainst, Study},
};

/// Arm of attacks on the recording.
pub const RECORDING: &str = "recording";

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

/// Generators and drivers of a study.
pub struct Attacks {
    /// Drivers; empty for the recording.
    egos: Vec<Ego>,
    groups: Vec<Group>,
    keys: Vec<Key>,
    drives: Vec<Metric<UnattackedDrive>>,
    attacked: Vec<Metric<PlanAndDrive>>,
    plans: Vec<Metric<MeasuredPlan>>,
    further: FurtherMeasures,
    /// Its feasibility rule decides whether an attack on a driver counts.
    objective: Objective,
    /// Search for evasive manoeuvres from the ego's path and in attacked drives.
    search: AvoidanceOptions,
    searches: [bool; 2],
    targets: Vec<f64>,
    /// Paths that attacks on drivers are planned against.
    planned_against: Vec<PlannedAgainst>,
    measure: [bool; 3],
    seed: u64,
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
            let of_samples = ego_samples::metrics().map(|m| m.info.name.to_string());
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
        let plans = plan_metrics(registries, &further, study)?.chosen(&names)?;
        let drives = registries.metrics.drive.chosen(&listed(Subject::Drive))?;
        let mut attack_names = listed(Subject::AttackedDrive);
        if study.avoidable.is_some() {
            // The search was asked for, so its metrics are shown.
            let costly = registries.metrics.attack.all().iter().filter(|m| m.info.is_costly);
            let missing: Vec<String> = costly.map(|m| m.info.name.to_string()).collect();
            attack_names
                .extend(missing.into_iter().filter(|name| !listed(Subject::AttackedDrive).contains(name)));
        }
        let attacked = attacked_metrics(registries, &attack_names)?.chosen(&attack_names)?;
        let measure =
            [Subject::Drive, Subject::Trajectory, Subject::AttackedDrive].map(|s| study.measures(s));
        let is_costly = |infos: &[MetricInfo]| infos.iter().any(|info| info.is_costly);
        let searches = [is_costly(&infos(&plans)), is_costly(&infos(&attacked))];
        let mut all = Self {
            egos,
            groups,
            keys: Vec::new(),
            drives,
            attacked: if measure[2] { attacked } else { Vec::new() },
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
            measure,
            seed: study.seed,
        };
        all.keys = all.make_keys();
        Ok(all)
    }

    /// Keys ego by ego: the unchanged drive, then for each group, generator, point and target the trajectory and the
    /// attacked drive.
    fn make_keys(&self) -> Vec<Key> {
        let [drive, trajectory, attacked] = self.measure;
        let mut keys = Vec::new();
        for k in 0..self.egos.len().max(1) {
            let ego = self.egos.get(k);
            let knows = ego.map(|ego| ego.policy.knows().to_string()).unwrap_or_default();
            if let Some(ego) = ego.filter(|_| drive) {
                keys.push(Key { knows: knows.clone(), ..Key::new(Subject::Drive, &*ego.label, self.seed) });
            }
            for group in &self.groups {
                let labels = [ego.map(|ego| ego.label.clone()), Some(group.arm.clone())];
                let labels: Vec<String> =
                    labels.into_iter().flatten().filter(|label| !label.is_empty()).collect();
                let arm = if labels.is_empty() { RECORDING.to_owned() } else { labels.join(", ") };
                let rows =
                    group.built.iter().flat_map(|built| built.keys.iter().map(move |row| (built, row)));
                let rows: Vec<_> = rows.collect();
                let all = self.paths(ego).flat_map(|path| rows.iter().map(move |row| (path, row)));
                for (path, (built, row)) in all {
                    let made_against = match (path, self.planned_against.len()) {
                        (_, 1) | (None, _) => "",
                        (Some(PlannedAgainst::Drive), _) => "its drive",
                        (Some(PlannedAgainst::Log), _) => "the log",
                    };
                    let key = |subject, target, knows: &str| Key {
                        made_against: made_against.to_owned(),
                        training_seed: group.training_seed,
                        attack: row.part().to_string(),
                        point: row.point.clone(),
                        target,
                        knows: knows.to_owned(),
                        ..Key::new(subject, &*arm, self.seed)
                    };
                    let of_generator = built.facts.knows.beyond_now();
                    if trajectory && self.targets.is_empty() {
                        keys.push(key(Subject::Trajectory, None, &of_generator));
                    }
                    for target in &self.targets {
                        keys.push(key(Subject::Trajectory, Some(*target), &of_generator));
                    }
                    if attacked && ego.is_some() {
                        keys.push(key(Subject::AttackedDrive, None, &knows));
                    }
                }
            }
        }
        keys
    }

    /// The paths that attacks on an ego are planned against; one without a name for the recorded ego.
    fn paths(&self, ego: Option<&Ego>) -> impl Iterator<Item = Option<PlannedAgainst>> {
        let paths = match ego {
            Some(_) => self.planned_against.iter().copied().map(Some).collect(),
            None => vec![None],
        };
        paths.into_iter()
    }

    /// Cells of one ego from the number of its first key on; returns the number after its last key.
    fn of_ego(
        &self,
        data: &SceneData,
        driver: Option<(&Ego, &Result<Arc<SimScene>, sage_sim::Error>)>,
        first: usize,
        result: &mut SceneResult,
    ) -> usize {
        let mut key = first;
        let [drive, ..] = self.measure;
        let ego = driver.map(|(ego, _)| ego);
        let test = driver.map(|(ego, simulated)| -> Result<(AttackTest<'_>, SceneData)> {
            let simulated = simulated.as_ref().map_err(|error| anyhow!("{error}"))?;
            let test = AttackTest::new(&*ego.policy, simulated, self.seed)?;
            let (name, index) = (data.name.clone(), data.index.clone());
            let recorded = SceneData { name, scene: test.recorded(), index };
            Ok((test, recorded))
        });
        let test = match test.transpose() {
            Ok(test) => test,
            Err(error) => {
                let end = first + self.keys_of_ego(ego);
                result.cells.extend((first..end).map(|key| Cell::failed(key, format!("{error:#}"))));
                return end;
            }
        };
        if let Some((test, _)) = test.as_ref().filter(|_| drive) {
            result.cells.push(cell(key, &self.drives, &test.unattacked_drive()));
            key += 1;
        }
        // Without an adversary there is nothing to attack with.
        let attacks = data.scene.adversary.is_some();
        let mut prepared: Vec<_> = self.paths(ego).map(|path| (path, ByPrior(Vec::new()))).collect();
        for group in &self.groups {
            for (path, prepared) in &mut prepared {
                let end =
                    key + group.built.iter().map(|built| self.keys_of(built, ego.is_some())).sum::<usize>();
                if attacks {
                    let may_query = !matches!(path, Some(PlannedAgainst::Log));
                    let data = match (&test, path) {
                        (Some((_, recorded)), Some(PlannedAgainst::Drive)) => recorded,
                        _ => data,
                    };
                    let prepared = prepared.get(group, |prior| self.prepare(data, prior, may_query));
                    self.of_group(prepared, group, test.as_ref().map(|(test, _)| test), key, result);
                }
                key = end;
            }
        }
        key
    }

    fn keys_of(&self, built: &BuiltGenerator, is_driven: bool) -> usize {
        let [_, trajectory, attacked] = self.measure;
        let of_plan = if self.targets.is_empty() { usize::from(trajectory) } else { self.targets.len() };
        built.keys.len() * (of_plan + usize::from(attacked && is_driven))
    }

    fn keys_of_ego(&self, ego: Option<&Ego>) -> usize {
        let built = self.groups.iter().flat_map(|group| &group.built);
        usize::from(self.measure[0] && ego.is_some())
            + self.paths(ego).count() * built.map(|built| self.keys_of(built, ego.is_some())).sum::<usize>()
    }

    fn prepare(&self, data: &SceneData, prior: &dyn Backbone, may_query: bool) -> Result<Prepared<'_>> {
        let ctx = Arc::new(prepared::recording(&data.scene, &data.index)?);
        let of_plan = |metric: &Metric<PlanAndDrive>| metric.info.name.starts_with(OF_PLAN);
        let is_shown = self.measure[1] || self.attacked.iter().any(of_plan);
        let is_measured = is_shown && self.targets.is_empty();
        let measured = is_measured.then(|| MeasuredScene::new(ctx.clone(), data, prior, &self.further));
        let is_searched = self.searches[0] || !self.targets.is_empty();
        let avoidance = is_searched.then(|| Avoidance::new(&ctx, self.search));
        let is_sampled = is_measured && self.searches[0];
        let samples = is_sampled.then(|| EgoSamples::of(data, &ctx, prior)).transpose()?;
        let (measured, avoidance) = (measured.transpose()?, avoidance.transpose()?);
        Ok(Prepared { ctx, may_query, measured, avoidance, samples })
    }

    fn of_group(
        &self,
        prepared: &Result<Prepared>,
        group: &Group,
        test: Option<&AttackTest>,
        first: usize,
        result: &mut SceneResult,
    ) {
        let mut key = first;
        for built in &group.built {
            let end = key + self.keys_of(built, test.is_some());
            let known = prepared.as_ref().map_err(|error| anyhow!("{error:#}"));
            let cells = known.and_then(|prepared| self.of_generator(built, prepared, test, key));
            match cells {
                Ok(cells) => result.cells.extend(cells),
                Err(error) => {
                    let reason = format!("{error:#}");
                    let is_left_out = prepared.as_ref().is_err_and(is_contact_now) || is_contact_now(&error);
                    if is_left_out {
                        result.left_out.push(format!("{}: {reason}", self.keys[key].stream()));
                    } else {
                        result.cells.extend((key..end).map(|key| Cell::failed(key, &reason)));
                    }
                }
            }
            key = end;
        }
    }

    fn of_generator(
        &self,
        built: &BuiltGenerator,
        prepared: &Prepared,
        test: Option<&AttackTest>,
        first: usize,
    ) -> Result<Vec<Cell>> {
        let Prepared { ctx, may_query, measured, avoidance, samples } = prepared;
        let clock = Instant::now();
        let attacks = match test {
            Some(test) if *may_query => built.planned(ctx, Against::Driver(test), self.seed)?,
            Some(test) => built.planned(ctx, Against::Drive(test), self.seed)?,
            None => built.attacks(ctx, Against::Recording, self.seed)?,
        };
        let seconds = clock.elapsed().as_secs_f64() / attacks.len() as f64;
        let (mut cells, mut key) = (Vec::new(), first);
        for (attack, point) in attacks.into_iter().zip(&built.points) {
            attack.check(ctx.scene())?;
            let path = match test {
                Some(test) => test.path_of(&attack)?,
                None => AttackPath::of(attack.trajectory().clone()),
            };
            let attack = &attack.driven(path.trajectory.clone(), "the driver under test");
            let mut plan = None;
            if let Some(scene) = measured {
                plan = Some(Arc::new(scene.measured(attack, seconds)?));
            }
            if let Some(trajectory) = plan.as_ref().filter(|_| self.measure[1]) {
                let avoidable = avoidance.as_ref().map(|avoidance| avoidance.of(&trajectory.candidate));
                let samples_hit = samples.as_ref().map(|samples| samples.share_hit(&trajectory.candidate));
                let plan = MeasuredPlan {
                    trajectory: Some(trajectory.clone()),
                    avoidable,
                    samples_hit,
                    choice: None,
                };
                cells.push(cell(key, &self.plans, &plan));
                key += 1;
            }
            if let Some(avoidance) = avoidance.as_ref().filter(|_| !self.targets.is_empty()) {
                let avoided = latest_start::avoided(attack, ctx, &self.objective, point.mu, avoidance);
                for target in &self.targets {
                    let time = latest_start::chosen(&avoided, *target).map(|one| one.time);
                    let choice = Some(Choice { target: *target, time });
                    cells.push(cell(key, &self.plans, &MeasuredPlan { choice, ..MeasuredPlan::default() }));
                    key += 1;
                }
            }
            if let Some(test) = test.filter(|_| self.measure[2]) {
                cells.push(self.attacked_cell(path, ctx, test, plan, key)?);
                key += 1;
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
        let is_feasible = self.objective.evaluate(&candidate, ctx).is_feasible();
        let outcome = test.attack_along(path, is_feasible)?;
        let is_searched = self.searches[1];
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

    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        let all = [
            (Subject::Drive, infos(&self.drives)),
            (Subject::Trajectory, infos(&self.plans)),
            (Subject::AttackedDrive, infos(&self.attacked)),
        ];
        all.into_iter()
            .zip(self.measure)
            .filter(|(_, is_measured)| *is_measured)
            .map(|(one, _)| one)
            .collect()
    }

    fn attack(&self, key: usize, data: &SceneData) -> Result<Option<Attack>> {
        let wanted = &self.keys[key];
        if !self.egos.is_empty() || !self.targets.is_empty() {
            return Ok(None);
        }
        let mut first = 0;
        for built in self.groups.iter().flat_map(|group| &group.built) {
            let end = first + self.keys_of(built, false);
            if key < end && wanted.subject == Subject::Trajectory {
                let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
                return Ok(built.attack(&ctx, key - first, self.seed)?);
            }
            first = end;
        }
        Ok(None)
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let mut result = SceneResult::default();
        if self.egos.is_empty() {
            self.of_ego(data, None, 0, &mut result);
            return result;
        }
        let simulated = SimScene::new(data.scene.clone(), data.index.clone());
        let of_ego = |first, ego| self.of_ego(data, Some((ego, &simulated)), first, &mut result);
        self.egos.iter().fold(0, of_ego);
        result
    }
}
