//! One plan of the adversary, evaluated as a search evaluates it.

use advsage::{
    part::Part,
    prepared::DriverInScene,
    rows::{
        evaluated::EvaluatedRow,
        failure::{FailureOf, FailureRow},
        search::RowHead,
    },
    search::rule,
};
use pyo3::prelude::*;
use sage_core::{generator::Proposal, motion::Trajectory, scene::SceneData};
use sage_run::Result;
use sage_sim::{
    Error, SimScene,
    attack_test::AttackTest,
    search::{AttackedPath, Explained, Hooks, Order, Pool, Requirement, SearchOptions, search},
};
use serde_json::{Map, Value, json};

use crate::{
    errors::{OptionError, detached},
    parts::{Driver, registries},
    results::without_run,
    scene::PyScene,
    values,
};

/// Drives a driver against one plan of the adversary, and evaluates the drive as `search` does.
///
/// `trajectory` is an array (80, 2): positions from frame 11 on, metres. The result is a dictionary: `failure`, whether all clauses
/// of `require` hold, and `reason`, the first that does not; `contact`, `clauses`, `references`, ... as in the rows of a search;
/// `ego_history` and `ego_path`, the attacked path as the search sees it. A failure is explained too (`deviation`, `sentence`,
/// `explanation` with `shrunk`, `needed` and `braking`) unless `explain` is false.
#[pyfunction]
#[pyo3(signature = (scene, ego, trajectory, *, require=None, references=None, feasibility=None, explain=true, seed=0))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    scene: &Bound<'py, PyScene>,
    ego: &Bound<'py, PyAny>,
    trajectory: &Bound<'py, PyAny>,
    require: Option<&str>,
    references: Option<Vec<String>>,
    feasibility: Option<&str>,
    explain: bool,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
) -> PyResult<Bound<'py, PyAny>> {
    let mut driver = Driver::of(py, ego)?;
    if let Some(names) = references {
        driver = detached(py, || driver.with_references(&names))?;
    }
    let require = require.map(str::parse::<Requirement>).transpose().map_err(OptionError::new_err)?;
    let mut plans = values::trajectories("trajectory", trajectory)?;
    let (Some(plan), true) = (plans.pop(), plans.is_empty()) else {
        return Err(OptionError::new_err("trajectory holds several plans; evaluate one after the other"));
    };
    let options = SearchOptions {
        budget: 1,
        require: require.unwrap_or_default(),
        order: Order::Pool,
        refine: 0.0,
        explain: if explain { Explained::All } else { Explained::None },
        ..SearchOptions::default()
    };
    let feasibility = feasibility.map(str::parse::<Part>).transpose().map_err(OptionError::new_err)?;
    let data = &scene.get().data;
    let row = detached(py, || evaluated(data, &driver, plan, feasibility.as_ref(), &options, seed));
    driver.raise_interrupt()?;
    values::from_json(py, &row?)
}

fn evaluated(
    data: &SceneData,
    driver: &Driver,
    plan: Trajectory,
    feasibility: Option<&Part>,
    options: &SearchOptions,
    seed: u64,
) -> Result<Value> {
    let rule = rule(registries()?, feasibility)?.objective;
    let simulated = SimScene::new(data.scene.clone(), data.index.clone())?;
    let DriverInScene { test, ctx } = DriverInScene::new(&simulated, |scene| {
        let test = AttackTest::new(&*driver.policy, scene, seed)?;
        Ok::<_, Error>(test.with_references(&driver.references))
    })?;
    let mut pool = Pool::new(&ctx, rule.rule(), vec![vec![Proposal::of(plan.clone())]], 1);
    if pool.plans.is_empty() {
        return Ok(json!({"failure": false, "reason": "no-feasible-plan"}));
    }
    let result = search(&test, &ctx, rule.rule(), &mut pool, options, seed, Hooks::default())?;
    let driven = &result.driven[0];
    if let Some(problem) = &driven.error {
        return Err(Error::Policy { scene: data.scene.id.clone(), problem: problem.clone() }.into());
    }
    let mut row = if result.failures.is_empty() {
        let path = AttackedPath::of(&test.attack(&plan, true)?.episode, test.unattacked());
        let ego_path = path.positions.iter().zip(&path.headings).map(|([x, y], heading)| [*x, *y, *heading]);
        let mut row = fields(serde_json::to_value(EvaluatedRow::of(driven))?);
        row.insert("ego_history".to_owned(), json!(path.history));
        row.insert("ego_path".to_owned(), json!(ego_path.collect::<Vec<_>>()));
        row
    } else {
        let head = RowHead {
            run_hash: String::new(),
            scene: data.name.clone(),
            ego: driver.label.clone(),
            source_hash: String::new(),
            seed,
            adversary: ctx.adversary().id.clone(),
        };
        let found = FailureOf { pool: &pool, result: &result, number: 0 };
        fields(without_run(serde_json::to_value(FailureRow::new(&head, found, None, None))?))
    };
    for of_search in ["plan", "drive", "variant"] {
        row.remove(of_search);
    }
    row.insert("failure".to_owned(), json!(!result.failures.is_empty()));
    row.insert("reason".to_owned(), json!(driven.missing(options.require)));
    Ok(Value::Object(row))
}

fn fields(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(fields) => fields,
        _ => Map::new(),
    }
}
