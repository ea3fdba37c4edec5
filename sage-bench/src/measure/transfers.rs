//! Plans that are made against one driver, driven by all.

use std::{path::Path, sync::Arc};

use anyhow::{Result, anyhow, ensure};
use sage_core::{
    generator::Proposal,
    metric::{Metric, MetricInfo},
    objective::{Context, Objective},
    scene::SceneData,
};
use sage_generators::GeneratorInputs;
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    search::{Clause, MOST_PLANS, MeasuredTransfer, Requirement, SearchOptions, evaluate_each},
};

use super::{Group, Measurement, SceneResult, cell, infos};
use crate::{
    Registries,
    ego::Ego,
    generators::{BuiltGenerator, Generators},
    operating_point::{OperatingPointSpec, RowKey},
    part::Part,
    rows::{Cell, Key, Subject},
    search::{self, PlanSources},
    selection::Selection,
    study::Study,
};

/// The strongest plan of a search with the driver in the loop, beside the generators by their names.
const SEARCH: &str = "search";

/// How a plan is made against a driver.
enum Maker {
    /// What a generator selects against the unattacked drive.
    Selected(BuiltGenerator),
    /// The strongest drive of a search.
    Searched(PlanSources, SearchOptions),
}

/// A way to make plans, with one set of weights.
struct Method {
    /// What distinguishes the weights; empty if there is only one set.
    arm: String,
    training_seed: Option<u64>,
    /// Attack and operating point of each plan.
    keys: Vec<(String, Option<OperatingPointSpec>)>,
    maker: Maker,
}

/// All plans against all drivers.
pub struct Transfers {
    egos: Vec<Ego>,
    methods: Vec<Method>,
    keys: Vec<Key>,
    metrics: Vec<Metric<MeasuredTransfer>>,
    rule: Objective,
    options: SearchOptions,
    seed: u64,
}

/// An error that several results have.
type Shared = Arc<anyhow::Error>;
/// The plan of a method against a driver: `None` if a search had no plan.
type Made = Result<Option<Proposal>, Shared>;

/// A driver with its unattacked drive.
struct Prepared<'t> {
    test: AttackTest<'t>,
    ctx: Context,
}

impl Transfers {
    /// Builds the sources of all plans.
    ///
    /// *Errors*: a method, a metric or a rule that is not registered.
    pub fn new(
        study: &Study,
        registries: &Registries,
        egos: Vec<Ego>,
        groups: &[Group],
        selection: &Selection,
    ) -> Result<Self> {
        let feasibility =
            study.feasibility.as_deref().map(str::parse::<Part>).transpose().map_err(anyhow::Error::msg)?;
        let rule = search::rule(registries, feasibility.as_ref())?;
        let mut options = study.search;
        options.avoidable = study.avoidable.unwrap_or(options.avoidable);
        let mut methods = Vec::new();
        for group in groups {
            let with = |selection: &Selection| {
                let inputs = GeneratorInputs {
                    experts: Some(group.experts.clone()),
                    merger: group.merger.clone(),
                    seed: study.seed,
                    selection: Arc::new(selection.objective.clone()),
                };
                Generators::with_inputs(registries, inputs)
            };
            for text in &study.method {
                let part: Part = text.parse().map_err(anyhow::Error::msg)?;
                let (keys, maker) = if part.name == SEARCH {
                    ensure!(part.options.is_empty(), "`{text}`: its options are those of `search`");
                    let plans = PlanSources::pool(&with(&rule), &[], MOST_PLANS)?;
                    (vec![(text.clone(), None)], Maker::Searched(plans, options))
                } else {
                    let built = with(selection).build(&part, &group.points)?;
                    let key = |key: &RowKey| (key.part().to_string(), key.point.clone());
                    (built.keys.iter().map(key).collect(), Maker::Selected(built))
                };
                let (arm, training_seed) = (group.arm.clone(), group.training_seed);
                methods.push(Method { arm, training_seed, keys, maker });
            }
        }
        ensure!(!methods.is_empty(), "`method` names no plans");
        let listed = study.metrics.get(&Subject::Transfer).cloned().unwrap_or_default();
        let mut all = Self {
            egos,
            methods,
            keys: Vec::new(),
            metrics: registries.metrics.transfer.chosen(&listed)?,
            rule: rule.objective,
            // Evasive manoeuvres are searched in every attack, also where the driver is not at fault.
            options: SearchOptions { require: Requirement::of(&[Clause::Avoidable]), ..options },
            seed: study.seed,
        };
        all.keys = all.make_keys();
        Ok(all)
    }

    /// Keys method by method, then by the driver that the plan is made against, then by the driver that is tested.
    fn make_keys(&self) -> Vec<Key> {
        let mut keys = Vec::new();
        for method in &self.methods {
            for (attack, point) in &method.keys {
                for made in &self.egos {
                    keys.extend(self.egos.iter().map(|tested| {
                        let labels = [tested.label.clone(), method.arm.clone()];
                        let labels: Vec<String> = labels.into_iter().filter(|l| !l.is_empty()).collect();
                        Key {
                            training_seed: method.training_seed,
                            attack: attack.clone(),
                            point: point.clone(),
                            made_against: made.label.clone(),
                            knows: tested.policy.knows().to_string(),
                            ..Key::new(Subject::Transfer, labels.join(", "), self.seed)
                        }
                    }));
                }
            }
        }
        keys
    }

    /// One plan of each key of a method against a driver.
    fn plans(&self, method: &Method, made: &Prepared) -> Result<Vec<Proposal>> {
        let Prepared { test, ctx } = made;
        match &method.maker {
            Maker::Selected(built) => {
                let mut plans = Vec::new();
                for mut attack in built.attacks(ctx, self.seed)? {
                    attack.check(ctx.scene())?;
                    plans.push(attack.candidates.swap_remove(attack.chosen));
                }
                Ok(plans)
            }
            Maker::Searched(sources, options) => {
                let (pool, result) = sources.search(test, ctx, &self.rule, options, self.seed)?;
                let strongest = result.strongest();
                Ok(strongest.map(|drive| pool.plans[drive.plan].proposal.clone()).into_iter().collect())
            }
        }
    }

    fn prepare<'t>(
        &'t self,
        ego: &'t Ego,
        simulated: &Result<Arc<SimScene>, sage_sim::Error>,
    ) -> Result<Prepared<'t>> {
        let simulated = simulated.as_ref().map_err(|error| anyhow!("{error}"))?;
        simulated.scene().check_apart_now()?;
        let test = AttackTest::new(&*ego.policy, simulated, self.seed)?;
        let ctx = test.context()?;
        ctx.check_apart_now()?;
        Ok(Prepared { test, ctx })
    }

    /// Cells of all keys against one tested driver.
    fn of_tested(
        &self,
        tested: usize,
        prepared: &Result<Prepared, Shared>,
        plans: &[Made],
        result: &mut SceneResult,
    ) {
        // Keys run over the tested drivers fastest.
        let key = |number: usize| number * self.egos.len() + tested;
        let keys = 0..plans.len();
        let Prepared { test, ctx } = match prepared {
            Ok(prepared) => prepared,
            Err(error) => return keys.for_each(|number| self.not_driven(error, key(number), result)),
        };
        let made: Vec<Proposal> = plans.iter().filter_map(|plan| plan.as_ref().ok()?.clone()).collect();
        match evaluate_each(test, ctx, self.rule.rule(), &made, &self.options) {
            Err(error) => result.cells.extend(keys.map(|k| Cell::failed(key(k), &error))),
            Ok(evaluated) => {
                let mut evaluated = evaluated.into_iter();
                for (number, plan) in plans.iter().enumerate() {
                    match plan {
                        Ok(plan) => {
                            let evaluated = plan.as_ref().and_then(|_| evaluated.next().flatten());
                            if let Some(error) = evaluated.as_ref().and_then(|drive| drive.error.as_ref()) {
                                result.cells.push(Cell::failed(key(number), error));
                                continue;
                            }
                            let measured = MeasuredTransfer { evaluated };
                            result.cells.push(cell(key(number), &self.metrics, &measured));
                        }
                        Err(error) => self.not_driven(error, key(number), result),
                    }
                }
            }
        }
    }

    /// Notes that there is no result: left out if two cars touch *now*, else failed.
    fn not_driven(&self, error: &anyhow::Error, key: usize, result: &mut SceneResult) {
        if matches!(error.downcast_ref(), Some(sage_core::Error::ContactNow { .. })) {
            let reason = format!("{}: {error:#}", self.keys[key].arm);
            if !result.left_out.contains(&reason) {
                result.left_out.push(reason);
            }
        } else {
            result.cells.push(Cell::failed(key, format!("{error:#}")));
        }
    }
}

impl Measurement for Transfers {
    fn write_logs_to(&self, folder: &Path) {
        self.egos.iter().for_each(|ego| ego.policy.write_logs_to(folder));
    }

    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        vec![(Subject::Transfer, infos(&self.metrics))]
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let mut result = SceneResult::default();
        let simulated = SimScene::new(data.scene.clone(), data.index.clone());
        let prepare = |ego| self.prepare(ego, &simulated).map_err(Arc::new);
        let prepared: Vec<Result<Prepared, Shared>> = self.egos.iter().map(prepare).collect();
        // One plan of each method, operating point and driver that it is made against.
        let mut plans: Vec<Made> = Vec::new();
        for method in &self.methods {
            let made = |against: &Result<Prepared, Shared>| {
                let against = against.as_ref().map_err(Arc::clone)?;
                self.plans(method, against).map_err(Arc::new)
            };
            let made: Vec<Result<Vec<Proposal>, Shared>> = prepared.iter().map(made).collect();
            for point in 0..method.keys.len() {
                let of_point = |plans: &Result<Vec<Proposal>, Shared>| {
                    plans.as_ref().map(|plans| plans.get(point).cloned()).map_err(Arc::clone)
                };
                plans.extend(made.iter().map(of_point));
            }
        }
        for (tested, prepared) in prepared.iter().enumerate() {
            self.of_tested(tested, prepared, &plans, &mut result);
        }
        result.cells.sort_by_key(|cell| cell.key);
        result
    }
}
