//! Searches for what drivers fail at, and the λ from which they fail.

use std::{path::Path, sync::Arc};

use advsage::{
    AdversarySpec,
    ego::Ego,
    operating_point::OperatingPointSpec,
    part::Part,
    prepared::DriverInScene,
    search::{ONE_SHOT, POOL, PlanSources},
    selection::Selection,
};
use sage_core::{
    generator::Proposal,
    metric::{Metric, MetricInfo},
    objective::{Context, Objective},
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    search::{Clause, MOST_PLANS, MeasuredSearch, MeasuredThreshold, Order, PlanDrives, SearchOptions},
};
use serde::Deserialize;
use serde_json::Value;

use super::{Group, Measurement, SceneResult, cell, driver_in_scene, infos, leaves_out};
use crate::{
    Error, Registries, Result,
    context::{Context as _, require},
    in_one_line,
    rows::{Cell, Key, Subject},
    study::Study,
};

/// Options of the method `pool` in a study.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields)]
struct PoolOptions {
    order: Order,
    plans: usize,
    refine: f64,
}

impl Default for PoolOptions {
    fn default() -> Self {
        let SearchOptions { order, refine, .. } = SearchOptions::default();
        Self { order, plans: MOST_PLANS, refine }
    }
}

/// One method with one set of weights.
struct Method {
    /// What distinguishes the weights; empty if there is only one set.
    arm: String,
    training_seed: Option<u64>,
    label: String,
    /// Operating point of the selected plan.
    point: Option<OperatingPointSpec>,
    plans: PlanSources,
    options: SearchOptions,
}

/// Searches and thresholds of a study.
pub struct Searches {
    egos: Vec<Ego>,
    methods: Vec<Method>,
    /// The plans that are selected at each λ, and λ.
    along: Vec<(Method, Vec<f64>)>,
    /// Who attacks, with its label.
    adversaries: Vec<(String, AdversarySpec)>,
    keys: Vec<Key>,
    searches: Vec<Metric<MeasuredSearch>>,
    thresholds: Vec<Metric<MeasuredThreshold>>,
    rule: Objective,
    seed: u64,
}

impl Searches {
    /// Builds the sources of all plans.
    ///
    /// *Errors*: a method, a metric or a rule that is not registered; thresholds without λ.
    pub fn new(
        study: &Study,
        registries: &Registries,
        egos: Vec<Ego>,
        groups: &[Group],
        selection: &Selection,
    ) -> Result<Self> {
        let (rule, options) = study.searches(&registries.parts)?;
        let listed = |subject| study.metrics.get(&subject).cloned().unwrap_or_default();
        let (mut methods, mut along) = (Vec::new(), Vec::new());
        for group in groups {
            let with = |selection| group.generators(registries, selection, study.seed);
            let (likeliest, selecting) = (with(&rule), with(selection));
            let method = |label: String, point, plans, options| Method {
                arm: group.arm.clone(),
                training_seed: group.training_seed,
                label,
                point,
                plans,
                options,
            };
            for text in study.method.iter().filter(|_| study.measures(Subject::Search)) {
                let part: Part = text.parse().map_err(Error::Value)?;
                let built = match &*part.name {
                    POOL => {
                        let own: PoolOptions = serde_json::from_value(Value::Object(part.options.clone()))
                            .with_context(|| format!("`{text}`"))?;
                        let plans = PlanSources::pool(&likeliest, &[], own.plans)?;
                        vec![method(
                            text.clone(),
                            None,
                            plans,
                            SearchOptions { order: own.order, refine: own.refine, ..options },
                        )]
                    }
                    ONE_SHOT => {
                        let one = |point: &OperatingPointSpec| -> Result<Method> {
                            let plans = PlanSources::one_shot(&selecting, std::slice::from_ref(point))?;
                            Ok(method(ONE_SHOT.to_owned(), Some(point.clone()), plans, options))
                        };
                        group.points.iter().map(one).collect::<Result<Vec<_>>>()?
                    }
                    _ => {
                        let facts = likeliest.facts(&part)?;
                        let generators = if facts.plans_against_ego { &selecting } else { &likeliest };
                        let plans = PlanSources::of_generator(generators, &part, &[], MOST_PLANS)?;
                        vec![method(text.clone(), None, plans, options)]
                    }
                };
                methods.extend(built);
            }
            if study.measures(Subject::Threshold) {
                let lambdas: Option<Vec<f64>> = group.points.iter().map(|point| point.lambda).collect();
                let lambdas = lambdas.filter(|all| all.len() > 2 && all.windows(2).all(|p| p[0] < p[1]));
                let lambdas =
                    lambdas.with_context(|| "thresholds need `lambda`: at least three rising values")?;
                let plans = PlanSources::one_shot(&selecting, &group.points)?;
                along.push((method("sage".to_owned(), None, plans, options), lambdas));
            }
        }
        require(!methods.is_empty() || !along.is_empty(), || "`method` names no plans to search")?;
        let mut all = Self {
            egos,
            methods,
            along,
            adversaries: study.adversaries()?,
            keys: Vec::new(),
            searches: registries.metrics.search.by_names(&listed(Subject::Search))?,
            thresholds: registries.metrics.threshold.by_names(&listed(Subject::Threshold))?,
            rule: rule.objective,
            seed: study.seed,
        };
        all.keys = all.make_keys();
        Ok(all)
    }

    /// Keys adversary by adversary and ego by ego: first the searches, then the thresholds.
    fn make_keys(&self) -> Vec<Key> {
        let mut keys = Vec::new();
        let egos = |adversary| self.egos.iter().map(move |ego| (adversary, ego));
        for ((adversary, _), ego) in self.adversaries.iter().flat_map(egos) {
            let key = |subject, method: &Method| {
                let arm = if method.arm.is_empty() {
                    ego.label.clone()
                } else {
                    format!("{}, {}", ego.label, method.arm)
                };
                Key {
                    training_seed: method.training_seed,
                    attack: match &**adversary {
                        "" => method.label.clone(),
                        adversary => format!("{adversary}: {}", method.label),
                    },
                    point: method.point.clone(),
                    knows: ego.policy.knows().to_string(),
                    ..Key::new(subject, arm, self.seed)
                }
            };
            keys.extend(self.methods.iter().map(|method| key(Subject::Search, method)));
            keys.extend(self.along.iter().map(|(method, _)| key(Subject::Threshold, method)));
        }
        keys
    }

    /// Cells of one ego, from the number of its first key on.
    fn of_ego(
        &self,
        ego: &Ego,
        simulated: &Result<Arc<SimScene>, sage_sim::Error>,
        first: usize,
        result: &mut SceneResult,
    ) {
        let count = self.methods.len() + self.along.len();
        let DriverInScene { test, ctx } = match driver_in_scene(ego, simulated, self.seed) {
            Ok(driver) => driver,
            Err(error) => {
                let reason = in_one_line(&error);
                if leaves_out(&error) {
                    result.left_out.push(format!("{}: {reason}", ego.label));
                } else {
                    result.cells.extend((first..first + count).map(|key| Cell::failed(key, &reason)));
                }
                return;
            }
        };
        let mut push = |key: usize, found: Result<Cell>| {
            result.cells.push(found.unwrap_or_else(|error| Cell::failed(key, in_one_line(&error))));
        };
        for (key, method) in (first..).zip(&self.methods) {
            push(key, self.search(key, method, &test, &ctx));
        }
        for (key, (method, lambdas)) in (first + self.methods.len()..).zip(&self.along) {
            push(key, self.threshold(key, method, lambdas, &test, &ctx));
        }
    }

    fn search(&self, key: usize, method: &Method, test: &AttackTest, ctx: &Context) -> Result<Cell> {
        let (pool, result) = method.plans.search(test, ctx, &self.rule, &method.options, self.seed, None)?;
        if result.reason == Some(sage_sim::search::Reason::Error) {
            let first = result.driven.iter().find_map(|evaluated| evaluated.error.clone());
            return Err(Error::Value(format!(
                "every attacked drive ended in an error: {}",
                first.unwrap_or_default()
            )));
        }
        Ok(cell(key, &self.searches, &MeasuredSearch::new(result, &pool, method.options.budget, ctx)))
    }

    fn threshold(
        &self,
        key: usize,
        method: &Method,
        lambdas: &[f64],
        test: &AttackTest,
        ctx: &Context,
    ) -> Result<Cell> {
        let plans: Vec<Proposal> = method.plans.proposals(ctx, self.seed)?.into_iter().flatten().collect();
        let mut drives = PlanDrives::new(test, ctx, self.rule.rule(), &method.options)?;
        let evaluate = |(k, plan)| drives.evaluate(k, plan);
        let evaluated = plans.iter().enumerate().map(evaluate).collect::<Result<Vec<_>, _>>()?;
        let require = method.options.require;
        let fails = |evaluated: &Option<_>| {
            evaluated
                .as_ref()
                .is_some_and(|evaluated: &sage_sim::search::Evaluated| evaluated.clauses.meet(require))
        };
        let at_fault_last = evaluated.last().and_then(Option::as_ref).is_some_and(|evaluated| {
            [Clause::Attack, Clause::Believable, Clause::AtFault].iter().all(|c| evaluated.clauses.holds(*c))
        });
        let measured = MeasuredThreshold {
            lambdas: lambdas.to_vec(),
            fails: evaluated.iter().map(fails).collect(),
            at_fault_last,
            at_fault_unattacked: test.unattacked_drive().is_at_fault(),
        };
        Ok(cell(key, &self.thresholds, &measured))
    }
}

impl Measurement for Searches {
    fn write_logs_to(&self, folder: &Path) {
        self.egos.iter().for_each(|ego| ego.policy.write_logs_to(folder));
    }

    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        let searches = (!self.methods.is_empty()).then(|| (Subject::Search, infos(&self.searches)));
        let thresholds = (!self.along.is_empty()).then(|| (Subject::Threshold, infos(&self.thresholds)));
        searches.into_iter().chain(thresholds).collect()
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let mut result = SceneResult::default();
        let count = self.methods.len() + self.along.len();
        for (place, (label, adversary)) in self.adversaries.iter().enumerate() {
            let scene = match adversary.kind {
                None => Ok(data.scene.clone()),
                Some(_) => adversary.in_scene((*data.scene).clone()).map(Arc::new),
            };
            let scene = match scene {
                Ok(scene) => scene,
                Err(error) if leaves_out(&error) => {
                    result.left_out.push(format!("{label}: {}", in_one_line(&error)));
                    continue;
                }
                Err(error) => {
                    let first = place * self.egos.len() * count;
                    let all = first..first + self.egos.len() * count;
                    result.cells.extend(all.map(|key| Cell::failed(key, in_one_line(&error))));
                    continue;
                }
            };
            let simulated = SimScene::new(scene, data.index.clone());
            for (k, ego) in self.egos.iter().enumerate() {
                self.of_ego(ego, &simulated, (place * self.egos.len() + k) * count, &mut result);
            }
        }
        result
    }
}
