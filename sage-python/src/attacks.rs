//! Attacks on many scenes.

use std::sync::{Arc, Mutex};

use pyo3::{prelude::*, types::PyIterator};
use sage_core::{generator::Attack, scene::SceneData};
use sage_run::Result;

use crate::{
    ahead::{Ahead, Turn, threads},
    attack::PyAttack,
    built::Built,
    errors::detached,
    generator::PyGenerator,
    items::{Item, iterator, next_ahead, object},
    parts::Driver,
    scene::{PyScene, Shared},
};

/// What becomes of one scene of a list.
type Attacked = (Option<Py<PyScene>>, Shared, Arc<Built>, Arc<SceneData>, Attack);

/// Attacks on many scenes, in their order.
#[pyclass(module = "advsage._advsage", name = "Attacks", frozen)]
pub(crate) struct PyAttacks {
    generator: Py<PyGenerator>,
    scenes: Py<PyIterator>,
    driver: Driver,
    seed: u64,
    /// `None` for a planner of Python, which is called on the caller's thread.
    ahead: Option<Mutex<Ahead<Item, Attacked>>>,
    turn: Turn,
}

#[pymethods]
impl PyAttacks {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(slf: &Bound<'_, Self>) -> PyResult<Option<PyAttack>> {
        let (py, this) = (slf.py(), slf.get());
        let _turn = this.turn.take(py)?;
        let scenes = this.scenes.bind(py);
        let Some(ahead) = &this.ahead else {
            let Some(scene) = scenes.clone().next() else { return Ok(None) };
            let (item, generator) = (Item::of(&scene?)?, this.generator.get());
            let attacked = detached(py, || attacked(item, generator, &this.driver, this.seed));
            // An interrupt is no error of the driver.
            this.driver.raise_interrupt()?;
            return this.attack(py, attacked?).map(Some);
        };
        next_ahead(ahead, scenes)?.map(|attacked| this.attack(py, attacked)).transpose()
    }
}

impl PyAttacks {
    fn attack(&self, py: Python<'_>, (scene, shared, built, seen, attack): Attacked) -> PyResult<PyAttack> {
        let scene = object(py, scene, shared)?;
        Ok(PyAttack::new(self.generator.clone_ref(py).into_any(), built, scene, seen, attack, self.seed))
    }
}

fn attacked(item: Item, generator: &PyGenerator, driver: &Driver, seed: u64) -> Result<Attacked> {
    let (object, shared) = item.read()?;
    let built = generator.of_seed(seed)?;
    let (seen, attack) = built.attack(&shared.0, driver, seed)?;
    Ok((object, shared, built, seen, attack))
}

/// Attacks many scenes in parallel: an iterator of `Attack`, in the order of the scenes, a few scenes ahead.
///
/// `scenes` holds scenes and paths of scene files; paths are read in the threads. A scene that fails raises at its place, and the
/// iterator goes on behind it. Bits do not depend on `threads` (all processors by default). Ctrl-C stops it.
#[pyfunction]
#[pyo3(signature = (generator, scenes, *, ego=None, seed=0, threads=None))]
pub(crate) fn generate_many(
    py: Python<'_>,
    generator: Py<PyGenerator>,
    scenes: &Bound<'_, PyAny>,
    ego: Option<&Bound<'_, PyAny>>,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
    #[pyo3(from_py_with = crate::seed::optional_count)] threads: Option<usize>,
) -> PyResult<PyAttacks> {
    let driver = Driver::of_optional(py, ego, "replay")?;
    let threads = self::threads(threads)?;
    let scenes = iterator(scenes)?;
    let ahead = if driver.planner.is_some() {
        None
    } else {
        let (generator, driver) = (generator.clone_ref(py), driver.clone());
        let work = move |item| attacked(item, generator.get(), &driver, seed);
        Some(Mutex::new(Ahead::new(threads, work)?))
    };
    Ok(PyAttacks { generator, scenes, driver, seed, ahead, turn: Turn::default() })
}
