//! Searches with the driver in the loop.

use std::sync::{Arc, Mutex};

use advsage::{
    AdversarySpec, GeneratorSpec,
    named_search::{NamedSearch, SearchSpec},
    prepared::DriverInScene,
    rows::search::RowHead,
};
use pyo3::{
    prelude::*,
    types::{PyDict, PyIterator, PyList},
};
use sage_core::scene::SceneData;
use sage_run::Result;
use sage_sim::{
    Error, PlannerLog, SimScene,
    attack_test::AttackTest,
    search::{Explained, MOST_PLANS, Order, REFINE, Reason, Requirement, SearchOptions},
};
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::{
    ahead::{Ahead, Turn, threads},
    errors::{OptionError, UnknownName, detached},
    generator::{keywords, spec},
    items::{Item, iterator, next_ahead, object},
    parts::{Driver, registries},
    results::search_rows,
    scene::{PyScene, Shared, person},
    values,
};

/// What drives against many plans in a scene: its row, and one for each failure.
type Work = dyn Fn(&SceneData) -> Result<(Value, Vec<Value>)> + Send + Sync;

/// Work on scenes with a driver in the loop.
struct Searcher {
    work: Box<Work>,
    /// A person who is placed in each scene, if one is asked for.
    person: Option<AdversarySpec>,
    driver: Driver,
}

/// What becomes of one scene.
type Searched = (Option<Py<PyScene>>, Shared, Value, Vec<Value>);

impl Searcher {
    fn searched(&self, item: Item) -> Result<Searched> {
        let (mut object, mut shared) = item.read()?;
        if let Some(person) = &self.person {
            (object, shared) = (None, shared.with_adversary(person)?);
        }
        let (row, failures) = (self.work)(&shared.0)?;
        Ok((object, shared, row, failures))
    }
}

/// A scene, its row, and the rows of its failures.
type SceneRows<'py> = (Py<PyScene>, Bound<'py, PyAny>, Bound<'py, PyList>);

/// Scenes with what a search found in them, in their order.
#[pyclass(module = "advsage._advsage", name = "Searched", frozen)]
pub(crate) struct PySearched {
    searcher: Arc<Searcher>,
    scenes: Py<PyIterator>,
    /// `None` for a planner of Python, which is called on the caller's thread.
    ahead: Option<Mutex<Ahead<Item, Searched>>>,
    turn: Turn,
}

#[pymethods]
impl PySearched {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// A scene, its row, and the rows of its failures.
    fn __next__<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<SceneRows<'py>>> {
        let (py, this) = (slf.py(), slf.get());
        let _turn = this.turn.take(py)?;
        let scenes = this.scenes.bind(py);
        let searched = match &this.ahead {
            None => {
                let Some(scene) = scenes.clone().next() else { return Ok(None) };
                let item = Item::of(&scene?)?;
                let searched = detached(py, || this.searcher.searched(item));
                // An interrupt is no error of the driver.
                this.searcher.driver.raise_interrupt()?;
                searched?
            }
            Some(ahead) => match next_ahead(ahead, scenes)? {
                Some(searched) => searched,
                None => return Ok(None),
            },
        };
        let (scene, shared, row, failures) = searched;
        let failures = failures.iter().map(|row| values::from_json(py, row)).collect::<PyResult<Vec<_>>>()?;
        let scene = object(py, scene, shared)?;
        Ok(Some((scene, values::from_json(py, &row)?, PyList::new(py, failures)?)))
    }
}

impl PySearched {
    /// Works on scenes, each in turn.
    ///
    /// *Errors*: scenes that are none; a number of threads that cannot be.
    pub(crate) fn new(
        scenes: &Bound<'_, PyAny>,
        driver: Driver,
        person: Option<AdversarySpec>,
        threads: Option<usize>,
        work: Box<Work>,
    ) -> PyResult<Self> {
        let threads = self::threads(threads)?;
        let scenes = iterator(scenes)?;
        let is_python = driver.planner.is_some();
        let searcher = Arc::new(Searcher { work, person, driver });
        let ahead = if is_python {
            None
        } else {
            let searcher = searcher.clone();
            Some(Mutex::new(Ahead::new(threads, move |item| searcher.searched(item))?))
        };
        Ok(Self { searcher, scenes, ahead, turn: Turn::default() })
    }
}

/// The head of a row.
pub(crate) fn head(scene: &SceneData, driver: &Driver, in_scene: &DriverInScene, seed: u64) -> RowHead {
    RowHead {
        run_hash: String::new(),
        scene: scene.name.clone(),
        ego: driver.label.clone(),
        source_hash: String::new(),
        seed,
        adversary: in_scene.ctx.adversary().id.clone(),
    }
}

/// The driver in a scene, with its reference drivers.
///
/// *Errors*: a scene in which it cannot drive.
pub(crate) fn in_scene<'d>(scene: &SceneData, driver: &'d Driver, seed: u64) -> Result<DriverInScene<'d>> {
    let simulated = SimScene::new(scene.scene.clone(), scene.index.clone())?;
    let test = |scene: &Arc<SimScene>| {
        let test = AttackTest::new(&*driver.policy, scene, seed)?;
        Ok::<_, Error>(test.with_references(&driver.references))
    };
    Ok(DriverInScene::new(&simulated, test)?)
}

/// The rows of a search in a scene.
fn search(
    scene: &SceneData,
    named: &NamedSearch,
    driver: &Driver,
    options: &SearchOptions,
    seed: u64,
) -> Result<(Value, Vec<Value>)> {
    let in_scene = in_scene(scene, driver, seed)?;
    let found = named.search(&in_scene, options, seed)?;
    let (pool, result) = (&found.0, &found.1);
    if result.reason == Some(Reason::Error) {
        let first = result.driven.first().and_then(|driven| driven.error.clone()).unwrap_or_default();
        return Err(Error::Planner {
            scene: scene.scene.id.clone(),
            step: None,
            is_late: false,
            problem: format!("every attacked drive ended in an error; the first: {first}"),
            log: PlannerLog::default(),
            drive: None,
        }
        .into());
    }
    let head = head(scene, driver, &in_scene, seed);
    search_rows(&head, options, &in_scene.test, pool, result, &named.plans)
}

/// A value of a list of words.
fn word<T: DeserializeOwned>(what: &str, text: &str, known: &str) -> PyResult<T> {
    serde_json::from_value(text.into())
        .map_err(|_| UnknownName::new_err(format!("unknown {what} `{text}`; known: {known}")))
}

/// Searches scenes, one after another; `advsage.search` gathers what this finds.
#[pyfunction]
#[pyo3(signature = (scenes, ego, *, method=None, weights=None, lambda_=None, aggression=None, mix=None, mu=None, selection="natural",
    feasibility=None, merger="linear", options=None, budget=64, require=None, references=None, first=false, order="surrogate",
    refine=REFINE, explain_failures="mildest", plans=MOST_PLANS, adversary_type=None, place=None, seed=0, threads=None))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn search_each(
    py: Python<'_>,
    scenes: &Bound<'_, PyAny>,
    ego: &Bound<'_, PyAny>,
    method: Option<&str>,
    weights: Option<String>,
    lambda_: Option<f64>,
    aggression: Option<f64>,
    mix: Option<Bound<'_, PyDict>>,
    mu: Option<f64>,
    selection: &str,
    feasibility: Option<&str>,
    merger: &str,
    options: Option<Bound<'_, PyDict>>,
    #[pyo3(from_py_with = crate::seed::count)] budget: usize,
    require: Option<&str>,
    references: Option<Vec<String>>,
    first: bool,
    order: &str,
    refine: f64,
    explain_failures: &str,
    #[pyo3(from_py_with = crate::seed::count)] plans: usize,
    adversary_type: Option<&str>,
    place: Option<Bound<'_, PyDict>>,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
    #[pyo3(from_py_with = crate::seed::optional_count)] threads: Option<usize>,
) -> PyResult<PySearched> {
    let mut driver = Driver::of(py, ego)?;
    if let Some(names) = references {
        driver = detached(py, || driver.with_references(&names))?;
    }
    let require = require.map(str::parse::<Requirement>).transpose().map_err(OptionError::new_err)?;
    let adversary = person(adversary_type, place.as_ref())?;
    let require = require.unwrap_or_else(|| adversary.requirement());
    let order: Order = word("order", order, "surrogate, random, pool")?;
    let explain: Explained = word("explain_failures", explain_failures, "none, mildest, all")?;
    if budget == 0 || plans == 0 {
        return Err(OptionError::new_err(format!(
            "budget is {budget} and plans {plans}; expected at least 1 of each"
        )));
    }
    if !(0.0..=1.0).contains(&refine) {
        return Err(OptionError::new_err(format!(
            "refine is {refine}; expected a share of the budget, 0 to 1"
        )));
    }
    let keywords = keywords(
        py,
        [
            ("method", method),
            ("selection", Some(selection)),
            ("merger", Some(merger)),
            ("weights", weights.as_deref()),
            ("feasibility", feasibility),
        ],
        [("lambda_", lambda_), ("aggression", aggression), ("mu", mu)],
        [("mix", &mix), ("options", &options)],
    )?;
    let generator = GeneratorSpec { seed, ..spec(&keywords)? };
    let generator = detached(py, || Ok(adversary.generator(generator, Some(require))?))?;
    let spec = SearchSpec { generator, plans };
    let options =
        SearchOptions { budget, require, first, order, refine, explain, ..SearchOptions::default() };
    let named = detached(py, || Ok(spec.build(registries()?)?))?;
    let (by, person) = (driver.clone(), adversary.placed());
    let work = move |scene: &SceneData| search(scene, &named, &by, &options, seed);
    PySearched::new(scenes, driver, person, threads, Box::new(work))
}
