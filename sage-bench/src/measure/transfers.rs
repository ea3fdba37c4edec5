//! Plans that are made against one driver, driven by all.

use std::{path::Path, sync::Arc};

use advsage::{
    ego::Ego,
    generators::{Against, BuiltGenerator},
    operating_point::{OperatingPointSpec, RowKey},
    part::Part,
    prepared::DriverInScene,
    search::PlanSources,
    selection::Selection,
};
use sage_core::{
    generator::Proposal,
    metric::{Metric, MetricInfo},
    objective::Objective,
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    search::{Clause, MOST_PLANS, MeasuredTransfer, PlanDrives, Reason, Requirement, SearchOptions},
};

use super::{Group, Measurement, SceneResult, cell, driver_in_scene, infos, leaves_out};
use crate::{
    Error, Registries, Result,
    context::require,
    in_one_line,
    rows::{Cell, Key, Subject},
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

impl Method {
    /// Name of an attack with the weights, if there are several.
    fn named(&self, attack: &str) -> String {
        if self.arm.is_empty() { attack.to_owned() } else { format!("{attack}, {}", self.arm) }
    }
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
type Shared = Arc<Error>;
/// The plan of a method against a driver: `None` if a search had no plan.
type Made = Result<Option<Proposal>, Shared>;

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
        let (rule, options) = study.searches(&registries.parts)?;
        let mut methods = Vec::new();
        for group in groups {
            let with = |selection| group.generators(registries, selection, study.seed);
            for text in &study.method {
                let part: Part = text.parse().map_err(Error::Value)?;
                let (keys, maker) = if part.name == SEARCH {
                    require(part.options.is_empty(), || {
                        format!("`{text}`: its options are those of `search`")
                    })?;
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
        require(!methods.is_empty(), || "`method` names no plans")?;
        let listed = study.metrics.get(&Subject::Transfer).cloned().unwrap_or_default();
        let mut all = Self {
            egos,
            methods,
            keys: Vec::new(),
            metrics: registries.metrics.transfer.by_names(&listed)?,
            rule: rule.objective,
            // Asked of every attack, also where the driver is not at fault.
            options: SearchOptions {
                require: Requirement::of(&[Clause::Avoidable, Clause::Preventable]),
                ..options
            },
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
                    keys.extend(self.egos.iter().map(|tested| Key {
                        training_seed: method.training_seed,
                        attack: method.named(attack),
                        point: point.clone(),
                        made_against: made.label.clone(),
                        knows: tested.policy.knows().to_string(),
                        ..Key::new(Subject::Transfer, &*tested.label, self.seed)
                    }));
                }
            }
        }
        keys
    }

    /// One plan of each key of a method against a driver.
    fn plans(&self, method: &Method, made: &DriverInScene) -> Result<Vec<Proposal>> {
        let DriverInScene { test, ctx } = made;
        match &method.maker {
            Maker::Selected(built) => {
                let mut plans = Vec::new();
                for mut attack in built.attacks(ctx, Against::Driver(test), self.seed)? {
                    attack.check(ctx.scene())?;
                    plans.push(attack.candidates.swap_remove(attack.chosen));
                }
                Ok(plans)
            }
            Maker::Searched(sources, options) => {
                let (pool, result) = sources.search(test, ctx, &self.rule, options, self.seed, None)?;
                if result.reason == Some(Reason::Error) {
                    let first = result.driven.iter().find_map(|drive| drive.error.clone());
                    return Err(Error::Value(format!(
                        "every attacked drive of the search ended in an error: {}",
                        first.unwrap_or_default()
                    )));
                }
                let strongest = result.strongest();
                Ok(strongest.map(|drive| pool.plans[drive.plan].proposal.clone()).into_iter().collect())
            }
        }
    }

    /// Cells of all keys against one tested driver.
    fn of_tested(
        &self,
        tested: usize,
        driver: &Result<DriverInScene, Shared>,
        plans: &[Made],
        result: &mut SceneResult,
    ) {
        // Keys run over the tested drivers fastest, then over those that plans are made against.
        let drivers = self.egos.len();
        let mut drives = driver.as_ref().map_err(Arc::clone).and_then(|DriverInScene { test, ctx }| {
            PlanDrives::new(test, ctx, self.rule.rule(), &self.options)
                .map_err(|error| Arc::new(error.into()))
        });
        for (number, plan) in plans.iter().enumerate() {
            let key = number * drivers + tested;
            let drives = match &mut drives {
                Ok(drives) => drives,
                Err(error) => {
                    self.not_driven(error, &self.egos[tested].label, key, result);
                    continue;
                }
            };
            match plan {
                Ok(plan) => {
                    let evaluated = plan.as_ref().map(|plan| drives.evaluate(number, plan)).transpose();
                    result.cells.push(match evaluated {
                        Ok(evaluated) => {
                            let measured = MeasuredTransfer { evaluated: evaluated.flatten() };
                            cell(key, &self.metrics, &measured)
                        }
                        Err(error) => Cell::failed(key, error),
                    });
                }
                Err(error) => self.not_driven(error, &self.egos[number % drivers].label, key, result),
            }
        }
    }

    /// Notes that there is no result because of a driver: left out if it touches the adversary *now*, else failed.
    fn not_driven(&self, error: &Error, driver: &str, key: usize, result: &mut SceneResult) {
        if leaves_out(error) {
            let reason = format!("{driver}: {}", in_one_line(error));
            if !result.left_out.contains(&reason) {
                result.left_out.push(reason);
            }
        } else {
            result.cells.push(Cell::failed(key, in_one_line(error)));
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
        let prepare = |ego| driver_in_scene(ego, &simulated, self.seed).map_err(Arc::new);
        let prepared: Vec<Result<DriverInScene, Shared>> = self.egos.iter().map(prepare).collect();
        // One plan of each method, operating point and driver that it is made against.
        let mut plans: Vec<Made> = Vec::new();
        for method in &self.methods {
            let made = |against: &Result<DriverInScene, Shared>| {
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
