//! Drives in many scenes.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use pyo3::{prelude::*, types::PyIterator};
use sage_run::{Result, outcome::caught};

use crate::{
    ahead::{Ahead, Turn, threads},
    driven::{Attacker, Driven},
    episode::PyEpisode,
    errors::{OptionError, to_python},
    items::{self, Item, next_ahead},
    parts::Driver,
    planner::Planner,
    planner_drive::{PlannerPolicy, Way},
    scene::{PyScene, Shared},
    together::drive_together,
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
    done: Mutex<VecDeque<PyResult<Done>>>,
    turn: Turn,
}

#[pymethods]
impl PyEpisodes {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(slf: &Bound<'_, Self>) -> PyResult<Option<PyEpisode>> {
        let (py, this) = (slf.py(), slf.get());
        let _turn = this.turn.take(py)?;
        let driven = match (&this.ahead, &this.driver.planner) {
            (Some(ahead), _) => next_ahead(ahead, this.scenes.bind(py))?,
            (None, Some(planner)) if planner.takes_many => this.next_of_batch(py, planner)?,
            (None, _) => this.next_alone(py)?,
        };
        let Some((object, shared, driven)) = driven else { return Ok(None) };
        let scene = items::object(py, object, shared)?;
        Ok(Some(PyEpisode::new(scene, this.driver.label.clone(), this.seed, driven)))
    }
}

impl PyEpisodes {
    fn next_alone(&self, py: Python<'_>) -> PyResult<Option<Done>> {
        let Some(scene) = self.scenes.bind(py).clone().next() else { return Ok(None) };
        let item = Item::of(&scene?)?;
        let result = py.detach(|| caught(|| driven(item, &self.driver, &self.attacker, self.seed)));
        self.driver.raise_interrupt()?;
        result.map(Some).map_err(|error| to_python(py, &error))
    }

    fn next_of_batch(&self, py: Python<'_>, planner: &Arc<Planner>) -> PyResult<Option<Done>> {
        let mut done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        if done.is_empty() {
            let (mut items, mut failed) = (Vec::new(), None);
            for scene in self.scenes.bind(py).clone().take(self.batch) {
                match scene.and_then(|scene| Item::of(&scene)) {
                    Ok(item) => items.push(item),
                    // What the scenes raise stands at its place.
                    Err(error) => {
                        failed = Some(error);
                        break;
                    }
                }
            }
            let drive = |item, questions| {
                let policy = Arc::new(PlannerPolicy::new(Way::Question(planner.clone(), questions)));
                let driver = Driver { policy, ..self.driver.clone() };
                driven(item, &driver, &self.attacker, self.seed)
            };
            done.extend(drive_together(py, planner, items, drive)?);
            done.extend(failed.map(Err));
        }
        done.pop_front().transpose()
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
    #[pyo3(from_py_with = crate::seed::optional_count)] threads: Option<usize>,
    #[pyo3(from_py_with = crate::seed::count)] batch: usize,
) -> PyResult<PyEpisodes> {
    let driver = Driver::of_optional(py, ego, "idm")?;
    let attacker = Attacker::of(attack, seed)?;
    if !(1..=1024).contains(&batch) {
        return Err(OptionError::new_err(format!("batch is {batch}; expected 1 to 1024")));
    }
    let threads = self::threads(threads)?;
    let scenes = items::iterator(scenes)?;
    let ahead = if driver.planner.is_some() {
        None
    } else {
        let (driver, attacker) = (driver.clone(), attacker.clone());
        Some(Mutex::new(Ahead::new(threads, move |item| driven(item, &driver, &attacker, seed))?))
    };
    Ok(PyEpisodes {
        scenes,
        driver,
        attacker,
        seed,
        batch,
        ahead,
        done: Mutex::default(),
        turn: Turn::default(),
    })
}
