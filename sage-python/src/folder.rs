//! Folders of scenes, read one at a time.

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

use pyo3::{
    exceptions::PyIndexError,
    prelude::*,
    types::{PySlice, PyType},
};
use sage_data::{Error, ReadOptions, dataset::Shard, folder, womd::is_record_path};

use crate::{
    errors::{OptionError, detached},
    loading::{Reading, checked_rate},
    scene::PyScene,
    values::Reduced,
};

/// The scenes of a folder, in natural order. A scene is read each time that it is asked for.
#[pyclass(frozen, module = "advsage", name = "Scenes", sequence)]
pub(crate) struct PyScenes {
    folder: PathBuf,
    files: Vec<PathBuf>,
    reading: Reading,
}

#[pymethods]
impl PyScenes {
    /// Paths of the files; a record of a TFRecord file is `FILE#3`.
    #[getter]
    pub(crate) fn paths(&self) -> Vec<String> {
        self.files.iter().map(|file| file.display().to_string()).collect()
    }

    fn __len__(&self) -> usize {
        self.files.len()
    }

    /// The scene of a number, or the list of a slice.
    fn __getitem__<'py>(&self, py: Python<'py>, number: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let count = self.files.len();
        if let Ok(slice) = number.cast::<PySlice>() {
            let found = slice.indices(count as isize)?;
            let numbers = (0..found.slicelength as isize).map(|k| (found.start + k * found.step) as usize);
            let files = numbers.map(|number| self.files[number].clone()).collect();
            let part = Self { folder: self.folder.clone(), files, reading: self.reading.clone() };
            return Ok(Bound::new(py, part)?.into_any());
        }
        let number: isize = number.extract()?;
        let at = if number < 0 { number + count as isize } else { number };
        let file = usize::try_from(at).ok().and_then(|at| self.files.get(at));
        let file =
            file.ok_or_else(|| PyIndexError::new_err(format!("there is no scene {number} of {count}")))?;
        let scene = detached(py, || self.reading.read(file))?;
        Ok(Bound::new(py, scene)?.into_any())
    }

    fn __iter__(slf: Py<Self>) -> PyScenesInTurn {
        PyScenesInTurn { scenes: slf, next: AtomicUsize::new(0) }
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py, (PathBuf, Vec<PathBuf>, String)>> {
        let reading = detached(py, || Ok(serde_json::to_string(&self.reading)?))?;
        let rebuild = py.get_type::<Self>().getattr("_of_files")?;
        Ok((rebuild, (self.folder.clone(), self.files.clone(), reading)))
    }

    #[classmethod]
    fn _of_files(
        _class: &Bound<'_, PyType>,
        folder: PathBuf,
        files: Vec<PathBuf>,
        reading: &str,
    ) -> PyResult<Self> {
        let reading = serde_json::from_str(reading);
        let reading = reading.map_err(|_| OptionError::new_err("the pickled list of scenes is damaged"))?;
        Ok(Self { folder, files, reading })
    }

    fn __repr__(&self) -> String {
        format!("<Scenes of '{}': {}>", self.folder.display(), self.files.len())
    }
}

/// The scenes of a folder, one after another. One that cannot be read raises at its place, and the next is read behind it.
#[pyclass(frozen, module = "advsage._advsage", name = "ScenesInTurn")]
pub(crate) struct PyScenesInTurn {
    scenes: Py<PyScenes>,
    next: AtomicUsize,
}

#[pymethods]
impl PyScenesInTurn {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<PyScene>> {
        let (scenes, number) = (self.scenes.get(), self.next.fetch_add(1, Ordering::Relaxed));
        scenes.files.get(number).map(|file| detached(py, || scenes.reading.read(file))).transpose()
    }
}

/// The scene files of a folder, or the records of a file.
///
/// *Errors*: a path that does not exist, or a folder without scenes.
pub(crate) fn files_of(path: &Path) -> sage_run::Result<Vec<PathBuf>> {
    if !is_record_path(path) {
        std::fs::metadata(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    }
    Ok(folder::scene_files(path)?)
}

/// Lists the scenes of a folder: files of any format, the files of a data set's summary, and records of TFRecord files. No scene is
/// read before it is asked for.
///
/// `shard=(K, N)` takes the K-th of N parts (K from 1), the same as `sage generate --shard K/N`.
#[pyfunction]
#[pyo3(signature = (path, *, shard=None, now=None, resample=false, rate=None, trust_positions=false, strict=false, keep_source=true))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn load_folder(
    py: Python<'_>,
    path: PathBuf,
    #[pyo3(from_py_with = crate::seed::shard)] shard: Option<(u32, u32)>,
    #[pyo3(from_py_with = crate::seed::optional_count)] now: Option<usize>,
    resample: bool,
    rate: Option<f64>,
    trust_positions: bool,
    strict: bool,
    keep_source: bool,
) -> PyResult<PyScenes> {
    let shard = shard.map(|(number, of)| format!("{number}/{of}").parse::<Shard>());
    let shard = shard.transpose().map_err(|problem| OptionError::new_err(format!("shard: {problem}")))?;
    let reading = Reading {
        options: ReadOptions {
            now,
            resample,
            rate: checked_rate(rate)?,
            trust_positions,
            strict,
            ..ReadOptions::default()
        },
        keep_source,
    };
    detached(py, || {
        let mut files: Vec<PathBuf> = files_of(&path)?;
        if let Some(shard) = shard {
            // A record that cannot be named fails when it is read.
            let names = files.iter().map(|file| folder::scene_name(file).unwrap_or_default());
            let (names, _) = folder::output_names(&path, &files, &names.collect::<Vec<_>>());
            let mut names = names.into_iter().map(|name| name + &reading.options.suffix());
            files.retain(|_| names.next().is_some_and(|name| shard.holds(&name)));
        }
        Ok(PyScenes { folder: path, files, reading })
    })
}
