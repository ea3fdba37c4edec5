//! Scenes: a recorded or procedural one with arrays of its tracks.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use advsage::AdversarySpec;
use pyo3::{
    prelude::*,
    types::{PyBytes, PyDict, PyList, PyType},
};
use sage_core::scene::{Scene, SceneData};
use sage_data::{ReadOptions, Recording, Source, VariantWriter};

use crate::{
    errors::{OptionError, UnknownName, detached},
    made_once::MadeOnce,
    values::{self, Reduced},
};

/// Where a scene comes from: what its file holds besides the scene.
pub(crate) struct Origin {
    pub(crate) path: PathBuf,
    source: Arc<Source>,
    options: ReadOptions,
    /// How it was derived from that file, if it was.
    provenance: Option<String>,
}

/// A recorded scene of traffic at 10 Hz.
#[pyclass(frozen, module = "advsage", name = "Scene", weakref)]
pub(crate) struct PyScene {
    pub(crate) data: Arc<SceneData>,
    pub(crate) origin: Arc<Origin>,
    arrays: Arrays,
}

/// A scene without its object of Python, for work in other threads.
#[derive(Clone)]
pub(crate) struct Shared(pub(crate) Arc<SceneData>, Arc<Origin>);

/// Arrays of a scene, each made at its first use.
#[derive(Default)]
struct Arrays {
    positions: MadeOnce,
    headings: MadeOnce,
    velocities: MadeOnce,
    sizes: MadeOnce,
    valid: MadeOnce,
    map_points: MadeOnce,
}

impl Shared {
    /// The scene with another adversary.
    ///
    /// *Errors*: as [`AdversarySpec::of`].
    pub(crate) fn with_adversary(&self, adversary: &AdversarySpec) -> sage_run::Result<Self> {
        let Self(data, origin) = self;
        let Origin { path, source, options, provenance } = &**origin;
        let scene = (*data.scene).clone();
        let recording =
            Recording { path: path.clone(), scene, source: (**source).clone(), options: options.clone() };
        let Recording { path, scene, source, options } = adversary.of(recording)?;
        let origin = Origin { path, source: Arc::new(source), options, provenance: provenance.clone() };
        let data = SceneData { name: data.name.clone(), scene: Arc::new(scene), index: data.index.clone() };
        Ok(Self(Arc::new(data), Arc::new(origin)))
    }
}

/// A person as the adversary, by the name of a kind and values of the place; no person without a kind.
///
/// *Errors*: a kind that there is not, or a value out of range.
pub(crate) fn person(kind: Option<&str>, place: Option<&Bound<'_, PyDict>>) -> PyResult<AdversarySpec> {
    let kind = kind.map(|kind| {
        serde_json::from_value(kind.into()).map_err(|_| {
            UnknownName::new_err(format!("unknown kind of person `{kind}`; known: pedestrian, cyclist"))
        })
    });
    let place = place.map(|place| {
        let place = values::to_json("place", place, 0)?;
        serde_json::from_value(place).map_err(|error| OptionError::new_err(format!("place: {error}")))
    });
    let spec = AdversarySpec { id: None, kind: kind.transpose()?, place: place.transpose()? };
    spec.check().map_err(|error| OptionError::new_err(error.to_string()))?;
    Ok(spec)
}

impl PyScene {
    pub(crate) fn new(data: Arc<SceneData>, origin: Arc<Origin>) -> Self {
        Self { data, origin, arrays: Arrays::default() }
    }

    /// The scene for work in other threads.
    pub(crate) fn shared(&self) -> Shared {
        Shared(self.data.clone(), self.origin.clone())
    }

    /// The object of a scene.
    pub(crate) fn of_shared(Shared(data, origin): Shared) -> Self {
        Self::new(data, origin)
    }

    /// A scene as it was read.
    pub(crate) fn of_recording(recording: Recording, name: String, keep_source: bool) -> Self {
        let Recording { path, scene, source, options } = recording;
        let source = if keep_source { source } else { Source::Procedural };
        let origin = Origin { path, source: Arc::new(source), options, provenance: None };
        Self::new(Arc::new(SceneData::new(name, scene)), Arc::new(origin))
    }

    /// A scene derived from this one.
    pub(crate) fn derived(&self, scene: Scene, provenance: String) -> Self {
        let Origin { path, source, options, .. } = &*self.origin;
        let origin = Origin {
            path: path.clone(),
            source: source.clone(),
            options: options.clone(),
            provenance: Some(provenance),
        };
        let data = SceneData {
            name: self.data.name.clone(),
            scene: Arc::new(scene),
            index: self.data.index.clone(),
        };
        Self::new(Arc::new(data), Arc::new(origin))
    }

    fn scene(&self) -> &Scene {
        &self.data.scene
    }

    /// The scene with the other content of its file.
    fn recording(&self) -> Recording {
        let Origin { path, source, options, .. } = &*self.origin;
        let scene = (*self.data.scene).clone();
        Recording { path: path.clone(), scene, source: (**source).clone(), options: options.clone() }
    }

    /// Refuses to write over what the scene was read from.
    ///
    /// *Errors*: the path is that of its file, or of the map beside it.
    pub(crate) fn refuse_source(&self, path: &Path) -> sage_run::Result<()> {
        if sage_data::is_source(&self.origin.path, path) {
            let problem = format!("`{}` is what the scene was read from; name another file", path.display());
            return Err(advsage::Error::Value(problem).into());
        }
        Ok(())
    }

    /// The bytes of a file of the scene.
    pub(crate) fn bytes(&self, native: bool) -> sage_run::Result<Vec<u8>> {
        let recording = self.recording();
        let Some(provenance) = &self.origin.provenance else {
            return Ok(if native { recording.to_native()? } else { recording.to_pickle()? });
        };
        let writer = VariantWriter::new(&recording)?;
        let variant = writer.variant(&recording.scene, provenance)?;
        Ok(if native { variant.to_native()? } else { variant.to_pickle() })
    }

    /// An array of all tracks with `width` numbers for each frame.
    fn of_tracks<T: numpy::Element>(
        &self,
        py: Python<'_>,
        shape: &[usize],
        values: impl Iterator<Item = T>,
    ) -> PyResult<Py<PyAny>> {
        let scene = self.scene();
        let shape: Vec<usize> = [&[scene.tracks.len(), scene.frames], shape].concat();
        values::shared_array(py, values.collect(), &shape)
    }
}

#[pymethods]
impl PyScene {
    /// Identifier that the file gives.
    #[getter]
    fn id(&self) -> &str {
        &self.scene().id
    }

    /// Name in results: that of the file without its ending.
    #[getter]
    fn name(&self) -> &str {
        &self.data.name
    }

    /// File that it was read from; for a procedural scene its id.
    #[getter]
    fn path(&self) -> String {
        self.origin.path.display().to_string()
    }

    /// Number of frames, 0.1 s apart. Frame 10 is *now*.
    #[getter]
    fn frames(&self) -> usize {
        self.scene().frames
    }

    /// Number of the car under test in `track_ids`.
    #[getter]
    fn ego(&self) -> usize {
        self.scene().ego
    }

    /// Number of the adversary in `track_ids`; None without one.
    #[getter]
    fn adversary(&self) -> Option<usize> {
        self.scene().adversary
    }

    /// Identifiers of the tracks.
    #[getter]
    fn track_ids(&self) -> Vec<&str> {
        self.scene().tracks.iter().map(|track| &*track.id).collect()
    }

    /// Kinds of the tracks: "VEHICLE", "PEDESTRIAN", "CYCLIST", or another word of the file.
    #[getter]
    fn kinds(&self) -> Vec<&str> {
        self.scene().tracks.iter().map(|track| track.kind.name()).collect()
    }

    /// Box centres, metres: array (tracks, frames, 3), read-only. Only frames that are `valid` count.
    #[getter]
    fn positions(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let all = self.scene().tracks.iter().flat_map(|track| track.position.iter().flatten().copied());
        let make = || self.of_tracks(py, &[3], all);
        self.arrays.positions.get(py, make)
    }

    /// Headings, radians: array (tracks, frames), read-only.
    #[getter]
    fn headings(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let make = || {
            self.of_tracks(
                py,
                &[],
                self.scene().tracks.iter().flat_map(|track| track.heading.iter().copied()),
            )
        };
        self.arrays.headings.get(py, make)
    }

    /// Velocities, m/s: array (tracks, frames, 2), read-only.
    #[getter]
    fn velocities(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let all = self.scene().tracks.iter().flat_map(|track| track.velocity.iter().flatten().copied());
        let make = || self.of_tracks(py, &[2], all);
        self.arrays.velocities.get(py, make)
    }

    /// Length, width and height, metres: array (tracks, frames, 3), read-only.
    #[getter]
    fn sizes(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let all = self.scene().tracks.iter().flat_map(|track| track.size.iter().flatten().copied());
        let make = || self.of_tracks(py, &[3], all);
        self.arrays.sizes.get(py, make)
    }

    /// Whether a track was observed: array (tracks, frames) of bool, read-only.
    #[getter]
    fn valid(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let make = || {
            self.of_tracks(py, &[], self.scene().tracks.iter().flat_map(|track| track.valid.iter().copied()))
        };
        self.arrays.valid.get(py, make)
    }

    /// Points of all map features, metres: array (points, 3), read-only.
    #[getter]
    fn map_points(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let points = &self.scene().map.points;
        let make = || values::shared_array(py, points.as_flattened().to_vec(), &[points.len(), 3]);
        self.arrays.map_points.get(py, make)
    }

    /// The map: a list of dictionaries with `id`, `type`, `points` (rows of `map_points`), and for lanes `speed_limit`
    /// (m/s or None), `entries`, `exits`, `left`, `right`, `stop_signs` (ids).
    #[getter]
    fn map_features<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let map = &self.scene().map;
        let points = self.map_points(py)?.into_bound(py);
        let ids = |numbers: &mut dyn Iterator<Item = usize>| -> Vec<&str> {
            numbers.filter_map(|k| Some(&*map.features.get(k)?.id)).collect()
        };
        let all = PyList::empty(py);
        for feature in &map.features {
            let dict = PyDict::new(py);
            dict.set_item("id", &feature.id)?;
            dict.set_item("type", feature.kind.name())?;
            let range =
                pyo3::types::PySlice::new(py, feature.points.start as isize, feature.points.end as isize, 1);
            dict.set_item("points", points.get_item(range)?)?;
            if let Some(lane) = &feature.lane {
                dict.set_item("speed_limit", lane.speed_limit)?;
                dict.set_item("entries", ids(&mut lane.entries.iter().copied()))?;
                dict.set_item("exits", ids(&mut lane.exits.iter().copied()))?;
                dict.set_item("stop_signs", ids(&mut lane.stop_signs.iter().copied()))?;
                for (side, name) in ["left", "right"].into_iter().enumerate() {
                    dict.set_item(name, ids(&mut lane.neighbors[side].iter().map(|n| n.lane)))?;
                }
            }
            all.append(dict)?;
        }
        Ok(all)
    }

    /// Traffic lights: a list of dictionaries with `lane` (id), `stop_point` (three numbers or None) and `states`, a word for
    /// each frame: "red", "yellow", "green", "flashing red" or "unknown".
    #[getter]
    fn lights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let all = PyList::empty(py);
        for light in &self.scene().lights {
            let dict = PyDict::new(py);
            dict.set_item("lane", &light.lane)?;
            dict.set_item("stop_point", light.stop_point.map(|point| point.to_vec()))?;
            dict.set_item("states", light.states.iter().map(|state| state.word()).collect::<Vec<_>>())?;
            all.append(dict)?;
        }
        Ok(all)
    }

    /// What the reader corrected or noticed, a line each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.scene().notes.iter().map(ToString::to_string).collect()
    }

    /// The scene with another ego or adversary, by track ids.
    #[pyo3(signature = (*, ego=None, adversary=None))]
    fn with_roles(&self, py: Python<'_>, ego: Option<String>, adversary: Option<String>) -> PyResult<Self> {
        detached(py, || {
            let scene = self.scene().clone().with_roles(ego.as_deref(), adversary.as_deref())?;
            let data = SceneData {
                name: self.data.name.clone(),
                scene: Arc::new(scene),
                index: self.data.index.clone(),
            };
            Ok(Self::new(Arc::new(data), self.origin.clone()))
        })
    }

    /// The scene with a person as the adversary, who stands beside the ego's recorded way from the first frame on: `kind` is
    /// "pedestrian" or "cyclist". `place` are values of the place: "side" ("any", "right", "left"), "beyond", "ahead", "after",
    /// "clearance" and "parked_car".
    #[pyo3(signature = (kind, *, place=None))]
    fn with_person(&self, py: Python<'_>, kind: &str, place: Option<Bound<'_, PyDict>>) -> PyResult<Self> {
        let adversary = person(Some(kind), place.as_ref())?;
        let shared = self.shared();
        Ok(Self::of_shared(detached(py, || shared.with_adversary(&adversary))?))
    }

    /// Writes the scene: a MetaDrive pickle (`.pkl`) or a native file (`.safetensors`). Replaces a file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        detached(py, || {
            let native = match path.extension().and_then(|ending| ending.to_str()) {
                Some("safetensors") => true,
                Some("pkl") => false,
                _ => {
                    let problem = format!(
                        "`{}` ends in neither .pkl nor .safetensors; sage.convert writes other formats",
                        path.display()
                    );
                    return Err(advsage::Error::Value(problem).into());
                }
            };
            self.refuse_source(&path)?;
            let bytes = self.bytes(native)?;
            sage_core::files::write(&path, &bytes, sage_core::files::Existing::Replace)
                .map_err(|source| sage_data::Error::Write { path: path.clone(), source })?;
            Ok(())
        })
    }

    fn __repr__(&self) -> String {
        let scene = self.scene();
        let adversary = scene.adversary.map_or("None".to_owned(), |k| format!("'{}'", scene.tracks[k].id));
        format!(
            "<Scene '{}': {} tracks, {} frames, ego '{}', adversary {adversary}>",
            self.data.name,
            scene.tracks.len(),
            scene.frames,
            scene.ego().id
        )
    }

    /// Scenes do not change, so a copy shares all content.
    fn __copy__(&self) -> Self {
        Self::new(self.data.clone(), self.origin.clone())
    }

    fn __deepcopy__(&self, _memo: &Bound<'_, PyAny>) -> Self {
        self.__copy__()
    }

    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<Reduced<'py, (Bound<'py, PyBytes>, String, String)>> {
        let bytes = detached(py, || self.bytes(true))?;
        let rebuild = py.get_type::<Self>().getattr("_from_bytes")?;
        Ok((rebuild, (PyBytes::new(py, &bytes), self.path(), self.data.name.clone())))
    }

    #[classmethod]
    fn _from_bytes(
        _class: &Bound<'_, PyType>,
        py: Python<'_>,
        bytes: Vec<u8>,
        path: PathBuf,
        name: String,
    ) -> PyResult<Self> {
        detached(py, || Ok(Self::of_recording(Recording::from_bytes(&path, bytes)?, name, true)))
    }
}
