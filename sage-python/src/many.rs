//! Many scenes at once: where they come from, and their attacks.

use std::{
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use pyo3::{
    exceptions::PyException,
    prelude::*,
    types::{PyIterator, PyList},
};
use sage_core::generator::Attack;
use sage_data::ReadOptions;

use crate::{
    ahead::{Ahead, Turn, threads},
    attack::PyAttack,
    errors::{OptionError, Raised, detached, to_python},
    folder::{PyScenes, files_of},
    generator::PyGenerator,
    parts::Driver,
    scene::{PyScene, Reading, Shared},
};

/// A scene of a list: loaded, or the path of its file.
pub(crate) enum Item {
    Scene(Py<PyScene>, Shared),
    Path(PathBuf),
}

impl Item {
    /// The item of a value of Python.
    ///
    /// *Errors*: neither a scene nor a path.
    pub(crate) fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(scene) = value.cast::<PyScene>() {
            return Ok(Self::Scene(scene.clone().unbind(), scene.get().shared()));
        }
        let path = value.extract().map_err(|_| {
            let class = value.get_type().name().map_or("value".to_owned(), |name| name.to_string());
            OptionError::new_err(format!("a {class} is no scene; expected scenes and paths of scene files"))
        })?;
        Ok(Self::Path(path))
    }

    /// The scene, read if it is not loaded. Its object of Python comes along if it has one.
    ///
    /// *Errors*: a file that is no scene.
    pub(crate) fn read(self) -> anyhow::Result<(Option<Py<PyScene>>, Shared)> {
        Ok(match self {
            Self::Scene(object, shared) => (Some(object), shared),
            Self::Path(path) => {
                let reading = Reading { options: ReadOptions::default(), keep_source: true };
                (None, reading.read(&path)?.shared())
            }
        })
    }
}

/// A scene, or the scene of a path.
///
/// *Errors*: neither, or a file that is no scene.
pub(crate) fn scene_of(value: &Bound<'_, PyAny>) -> PyResult<Py<PyScene>> {
    let py = value.py();
    let item = Item::of(value)?;
    let (scene, shared) = detached(py, || item.read())?;
    object(py, scene, shared)
}

/// The scenes of a list, of a folder, of a file, or a single one.
///
/// *Errors*: a folder that cannot be listed; anything else.
pub(crate) fn iterator(scenes: &Bound<'_, PyAny>) -> PyResult<Py<PyIterator>> {
    let py = scenes.py();
    if scenes.is_instance_of::<PyScene>() {
        return Ok(PyList::new(py, [scenes])?.try_iter()?.unbind());
    }
    // A text is a sequence too, of letters.
    if let Ok(path) = scenes.extract::<PathBuf>() {
        let paths = detached(py, || files_of(&path))?;
        return Ok(PyList::new(py, paths)?.try_iter()?.unbind());
    }
    if let Ok(folder) = scenes.cast::<PyScenes>() {
        return Ok(PyList::new(py, folder.get().paths())?.try_iter()?.unbind());
    }
    Ok(scenes.try_iter()?.unbind())
}

/// The next result of work on scenes, after more of them were given. What the scenes raise stands at its place.
///
/// *Errors*: Ctrl-C.
pub(crate) fn next_ahead<R: Send + 'static>(
    ahead: &Mutex<Ahead<Item, R>>,
    scenes: &Bound<'_, PyIterator>,
) -> PyResult<Option<anyhow::Result<R>>> {
    let py = scenes.py();
    // Only the thread whose turn it is comes here.
    let mut ahead = ahead.lock().unwrap_or_else(PoisonError::into_inner);
    let mut scenes = scenes.clone();
    while ahead.wants_more() {
        match scenes.next().map(|scene| Item::of(&scene?)) {
            None => break,
            Some(Ok(item)) => ahead.give(item),
            Some(Err(error)) if !error.is_instance_of::<PyException>(py) => return Err(error),
            Some(Err(error)) => ahead.give_failed(Raised(error).into()),
        }
    }
    ahead.take(py)
}

/// The object of a scene that was read.
pub(crate) fn object(py: Python<'_>, object: Option<Py<PyScene>>, shared: Shared) -> PyResult<Py<PyScene>> {
    object.map_or_else(|| Py::new(py, PyScene::of_shared(shared)), Ok)
}

/// What becomes of one scene of a list.
type Attacked = (
    Option<Py<PyScene>>,
    Shared,
    std::sync::Arc<crate::generator::Built>,
    std::sync::Arc<sage_core::scene::SceneData>,
    Attack,
);

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
        match next_ahead(ahead, scenes)? {
            Some(Ok(attacked)) => this.attack(py, attacked).map(Some),
            Some(Err(error)) => Err(to_python(py, &error)),
            None => Ok(None),
        }
    }
}

impl PyAttacks {
    fn attack(&self, py: Python<'_>, (scene, shared, built, seen, attack): Attacked) -> PyResult<PyAttack> {
        let scene = object(py, scene, shared)?;
        Ok(PyAttack::new(self.generator.clone_ref(py), built, scene, seen, attack, self.seed))
    }
}

fn attacked(item: Item, generator: &PyGenerator, driver: &Driver, seed: u64) -> anyhow::Result<Attacked> {
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
