//! Where scenes come from: files and the procedural generator.

use std::{path::PathBuf, sync::Arc};

use pyo3::prelude::*;
use sage_core::scene::SceneData;
use sage_data::{
    ReadOptions, Recording, folder,
    procedural::{self, Kind},
};
use serde::{Deserialize, Serialize};

use crate::{
    errors::{OptionError, UnknownName, detached},
    scene::PyScene,
};

/// How files are read.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct Reading {
    pub(crate) options: ReadOptions,
    pub(crate) keep_source: bool,
}

impl Reading {
    /// Reads a scene file or a record.
    ///
    /// *Errors*: as [`Recording::read`].
    pub(crate) fn read(&self, path: &std::path::Path) -> sage_run::Result<PyScene> {
        let recording = Recording::read_as(path, &self.options)?;
        let name = folder::scene_name(path)? + &self.options.suffix();
        Ok(PyScene::of_recording(recording, name, self.keep_source))
    }
}

/// Reads a scene file of any format: a MetaDrive or ScenarioNet pickle, a native file, a record of a TFRecord file of the
/// Waymo Open Motion Dataset (`FILE#3`), JSON of GPUDrive, or a scenario of Argoverse 2 (Parquet).
///
/// - `ego`, `adversary`: track ids, in place of those of the file.
/// - `without`: ids of road users that are left out.
/// - `now`: the frame at 10 Hz that becomes now; the scene is then the window from 1 s before it to 8 s after it.
/// - `resample`: also take recordings below 5 Hz. `rate`: frames per second of a file without times. `trust_positions`: compute velocities and headings from positions.
/// - `strict`: refuse a scene in which a track cannot be used, in place of leaving the track out with a note.
/// - `keep_source=False`: drop what the file holds beyond the scene, which halves the memory; the scene is written as a new file then.
#[pyfunction]
#[pyo3(signature = (path, *, ego=None, adversary=None, without=None, now=None, resample=false, rate=None, trust_positions=false, strict=false, keep_source=true))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn load(
    py: Python<'_>,
    path: PathBuf,
    ego: Option<String>,
    adversary: Option<String>,
    without: Option<Vec<String>>,
    #[pyo3(from_py_with = crate::seed::optional_count)] now: Option<usize>,
    resample: bool,
    rate: Option<f64>,
    trust_positions: bool,
    strict: bool,
    keep_source: bool,
) -> PyResult<PyScene> {
    let rate = checked_rate(rate)?;
    let without = without.unwrap_or_default();
    let options = ReadOptions { now, resample, rate, trust_positions, ego_track: ego, without, strict };
    let reading = Reading { options, keep_source };
    detached(py, || {
        if path.is_dir() {
            let problem =
                format!("`{}` is a folder; load_folder reads the scenes of a folder", path.display());
            return Err(advsage::Error::Value(problem).into());
        }
        let scene = reading.read(&path)?;
        if adversary.is_none() {
            return Ok(scene);
        }
        let (data, origin) = (&scene.data, scene.origin.clone());
        let changed = (*data.scene).clone().with_roles(None, adversary.as_deref())?;
        let data = SceneData { name: data.name.clone(), scene: Arc::new(changed), index: data.index.clone() };
        Ok(PyScene::new(Arc::new(data), origin))
    })
}

/// A number of frames per second.
pub(crate) fn checked_rate(rate: Option<f64>) -> PyResult<Option<f64>> {
    match rate.filter(|rate| !(0.5..=1000.0).contains(rate)) {
        Some(rate) => {
            Err(OptionError::new_err(format!("rate is {rate}; expected frames per second, such as 20")))
        }
        None => Ok(rate),
    }
}

/// A procedural scene: no recording, no licence.
///
/// `kind` is "straight", "curve", "merge", "four-way", "t-junction", "roundabout" or "divided". Each `seed` and `number` (0, 1, 2, ...) is
/// another scene of it.
#[pyfunction]
#[pyo3(signature = (kind, seed=0, number=0))]
pub(crate) fn make(
    py: Python<'_>,
    kind: &str,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
    #[pyo3(from_py_with = crate::seed::seed)] number: u64,
) -> PyResult<PyScene> {
    let found = Kind::from_name(kind).ok_or_else(|| {
        let known = Kind::ALL.map(Kind::name).join(", ");
        UnknownName::new_err(format!("unknown kind of scene `{kind}`; known: {known}"))
    })?;
    let scene = py.detach(|| procedural::generate(found, seed, number));
    let scene = scene.ok_or_else(|| {
        OptionError::new_err(format!(
            "there is no scene `{kind}` of seed {seed} and number {number}; take another number"
        ))
    })?;
    let name = scene.id.clone();
    Ok(PyScene::of_recording(Recording::procedural(scene), name, true))
}
