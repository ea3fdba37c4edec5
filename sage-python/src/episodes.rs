//! Drives in many scenes.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
};

use anyhow::Result;
use pyo3::{prelude::*, types::PyIterator};

use crate::{
    ahead::{Ahead, threads},
    driven::{Attacker, Driven},
    episode::PyEpisode,
    errors::{OptionError, caught, to_python},
    many::{self, Item},
    parts::Driver,
    planner::{Planner, PlannerPolicy, Way, keep_raised},
    scene::{PyScene, Shared},
    together::{Outcome, drive_together},
};

/// One scene of a list, driven.
type Done = (Option<Py<PyScene>>, Shared, Driven);

fn driven(item: Item, driver: &Driver, attacker: &Attacker, seed: u64) -> Result<Done> {
    let (object, shared) = item.read()?;
    let driven = Driven::new(&shared.0, driver, attacker, seed)?;
    Ok((object, shared, driven))
}

/// Drives in many scenes, in their order.
#[pyclass(module = "advsage._advsage", name = "Episodes", frozen)]
pub(crate) struct PyEpisodes {
    scenes: Py<PyIterator>,
    driver: Driver,
    attacker: Attacker,
    seed: u64,
    /// Scenes that a planner with `act_many` drives at once.
    batch: usize,
    /// `None` for a planner of Python.
    ahead: Option<Mutex<Ahead<Item, Done>>>,
    /// Drives of a batch that are done.
    done: Mutex<VecDeque<Outcome<Done>>>,
}

#[pymethods]
impl PyEpisodes {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(slf: &Bound<'_, Self>) -> PyResult<Option<PyEpisode>> {
        let (py, this) = (slf.py(), slf.get());
        let outcome = match (&this.ahead, &this.driver.planner) {
            (Some(ahead), _) => this.next_ahead(py, ahead)?,
            (None, Some(planner)) if planner.takes_many => this.next_of_batch(py, planner)?,
            (None, _) => this.next_alone(py)?,
        };
        let Some((result, raised)) = outcome else { return Ok(None) };
        if raised.is_some() {
            keep_raised(raised);
        }
        let (object, shared, driven) = result.map_err(|error| to_python(py, &error))?;
        let scene = many::object(py, object, shared)?;
        Ok(Some(PyEpisode::new(scene, this.driver.label.clone(), this.seed, driven)))
    }
}

impl PyEpisodes {
    fn next_ahead(
        &self,
        py: Python<'_>,
        ahead: &Mutex<Ahead<Item, Done>>,
    ) -> PyResult<Option<Outcome<Done>>> {
        let Ok(mut ahead) = ahead.try_lock() else {
            return Err(OptionError::new_err("another thread takes episodes from this iterator"));
        };
        let mut scenes = self.scenes.bind(py).clone();
        while ahead.wants_more() {
            let Some(scene) = scenes.next() else { break };
            ahead.give(Item::of(&scene?)?);
        }
        Ok(ahead.take(py)?.map(|result| (result, None)))
    }

    fn next_alone(&self, py: Python<'_>) -> PyResult<Option<Outcome<Done>>> {
        let Some(scene) = self.scenes.bind(py).clone().next() else { return Ok(None) };
        py.check_signals()?;
        let item = Item::of(&scene?)?;
        let result = py.detach(|| caught(|| driven(item, &self.driver, &self.attacker, self.seed)));
        self.driver.raise_interrupt()?;
        Ok(Some((result, None)))
    }

    fn next_of_batch(&self, py: Python<'_>, planner: &Arc<Planner>) -> PyResult<Option<Outcome<Done>>> {
        let Ok(mut done) = self.done.try_lock() else {
            return Err(OptionError::new_err("another thread takes episodes from this iterator"));
        };
        if done.is_empty() {
            let scenes = self.scenes.bind(py).clone().take(self.batch);
            let items = scenes.map(|scene| Item::of(&scene?)).collect::<PyResult<Vec<_>>>()?;
            let drive = |item, questions| {
                let policy = Arc::new(PlannerPolicy(Way::Question(planner.clone(), questions)));
                let driver = Driver { policy, ..self.driver.clone() };
                driven(item, &driver, &self.attacker, self.seed)
            };
            done.extend(drive_together(py, planner, items, drive)?);
        }
        Ok(done.pop_front())
    }
}

/// Drives many scenes: an iterator of `Episode`, in the order of the scenes.
///
/// The arguments are those of `simulate`, and of `generate_many` for `scenes` and `threads`. A planner that has
/// `act_many(observations)` drives `batch` scenes at once: it gets a list of observations, one for each drive that still runs, and
/// returns as many answers; `reset` is called for each drive, and `obs.scene.drive` numbers it. A planner without it drives one
/// scene after the other.
#[pyfunction]
#[pyo3(signature = (scenes, ego=None, attack=None, *, seed=0, threads=None, batch=32))]
pub(crate) fn simulate_many(
    py: Python<'_>,
    scenes: &Bound<'_, PyAny>,
    ego: Option<&Bound<'_, PyAny>>,
    attack: Option<&Bound<'_, PyAny>>,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
    threads: Option<usize>,
    batch: usize,
) -> PyResult<PyEpisodes> {
    let driver = Driver::of_optional(py, ego, "idm")?;
    let attacker = Attacker::of(attack, seed)?;
    if !(1..=1024).contains(&batch) {
        return Err(OptionError::new_err(format!("batch is {batch}; expected 1 to 1024")));
    }
    let threads = self::threads(threads)?;
    let scenes = many::iterator(scenes)?;
    let ahead = if driver.planner.is_some() {
        None
    } else {
        let (driver, attacker) = (driver.clone(), attacker.clone());
        Some(Mutex::new(Ahead::new(threads, move |item| driven(item, &driver, &attacker, seed))?))
    };
    Ok(PyEpisodes { scenes, driver, attacker, seed, batch, ahead, done: Mutex::default() })
}
