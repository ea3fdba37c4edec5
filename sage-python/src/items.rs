//! The scenes of a list, and work on them in their order.

use std::{
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use pyo3::{
    exceptions::PyException,
    prelude::*,
    types::{PyIterator, PyList},
};
use sage_data::ReadOptions;
use sage_run::Result;

use crate::{
    ahead::Ahead,
    errors::{OptionError, detached},
    folder::{PyScenes, files_of},
    loading::Reading,
    scene::{PyScene, Shared},
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
    pub(crate) fn read(self) -> Result<(Option<Py<PyScene>>, Shared)> {
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
/// *Errors*: those of the result; Ctrl-C.
pub(crate) fn next_ahead<R: Send + 'static>(
    ahead: &Mutex<Ahead<Item, R>>,
    scenes: &Bound<'_, PyIterator>,
) -> PyResult<Option<R>> {
    let py = scenes.py();
    // Only the thread whose turn it is comes here.
    let mut ahead = ahead.lock().unwrap_or_else(PoisonError::into_inner);
    let mut scenes = scenes.clone();
    while ahead.wants_more() {
        match scenes.next().map(|scene| Item::of(&scene?)) {
            None => break,
            Some(Ok(item)) => ahead.give(item),
            Some(Err(error)) if !error.is_instance_of::<PyException>(py) => return Err(error),
            Some(Err(error)) => ahead.give_failed(error),
        }
    }
    ahead.take(py)
}

/// The object of a scene that was read.
pub(crate) fn object(py: Python<'_>, object: Option<Py<PyScene>>, shared: Shared) -> PyResult<Py<PyScene>> {
    object.map_or_else(|| Py::new(py, PyScene::of_shared(shared)), Ok)
}
