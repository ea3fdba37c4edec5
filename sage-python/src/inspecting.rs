//! What a scene holds and can be used for, other formats, and pictures.

use std::path::PathBuf;

use advsage::{in_one_line, prepared};
use pyo3::{
    prelude::*,
    types::{PyDict, PyType},
};
use sage_core::{
    files::{Existing, write},
    scene::SceneData,
};
use sage_data::{Error, Format, Recording, checks::Summary, womd};
use sage_run::Result;
use sage_sim::SimScene;

use crate::{
    attack::PyAttack,
    errors::{OptionError, UnknownName, detached},
    items::Item,
    results,
    scene::PyScene,
    values::{self, Reduced},
};

/// Summary of a scene or of a scene file, as `sage inspect --json` prints it, with `capabilities`: why it cannot be attacked or
/// driven (None if it can), and whether its map has road edges and its recording traffic lights.
#[pyfunction]
pub(crate) fn inspect<'py>(py: Python<'py>, scene: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let item = Item::of(scene)?;
    let (data, summary) = detached(py, || {
        let (_, shared) = item.read()?;
        let summary = Summary::of(&shared.0.name, &shared.0.scene);
        Ok((shared.0, summary))
    })?;
    let [attack, drive] = detached(py, || Ok([why_not(attackable(&data)), why_not(drivable(&data))]))?;
    let row = values::from_serde(py, &summary)?;
    let capabilities = PyDict::new(py);
    capabilities.set_item("attack", attack)?;
    capabilities.set_item("drive", drive)?;
    capabilities.set_item("road_edges", data.scene.map.has_edges())?;
    capabilities.set_item("traffic_lights", !data.scene.lights.is_empty())?;
    row.set_item("capabilities", capabilities)?;
    Ok(row)
}

fn why_not(outcome: Result<()>) -> Option<String> {
    outcome.err().map(|error| in_one_line(&error))
}

fn attackable(data: &SceneData) -> Result<()> {
    prepared::recording(&data.scene, &data.index)?;
    Ok(())
}

fn drivable(data: &SceneData) -> Result<()> {
    SimScene::new(data.scene.clone(), data.index.clone())?;
    Ok(())
}

/// Writes a scene in another format and returns the paths of the files. Replaces files.
///
/// `to` is `"pickle"` (MetaDrive, ScenarioNet), `"native"` (.safetensors), `"womd"` (a TFRecord file), `"gpudrive"` (.json) or
/// `"openscenario"` (.xosc, with its OpenDRIVE map beside it); without it the ending of `path` decides.
#[pyfunction]
#[pyo3(signature = (scene, path, *, to=None))]
pub(crate) fn convert(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    path: PathBuf,
    to: Option<&str>,
) -> PyResult<Vec<String>> {
    let item = Item::of(scene)?;
    let known = || Format::all_written().map(Format::name).collect::<Vec<_>>().join(", ");
    let format = match to {
        Some(to) => Format::named(to)
            .filter(|format| format.is_written())
            .ok_or_else(|| UnknownName::new_err(format!("unknown format `{to}`; known: {}", known())))?,
        None => {
            let ending = path.extension().and_then(|ending| ending.to_str());
            let of_ending = Format::all_written().find(|format| Some(format.ending()) == ending);
            of_ending.ok_or_else(|| {
                let endings: Vec<String> =
                    Format::all_written().map(|format| format!(".{}", format.ending())).collect();
                OptionError::new_err(format!(
                    "`{}` ends in none of {}; say to= one of {}",
                    path.display(),
                    endings.join(", "),
                    known()
                ))
            })?
        }
    };
    detached(py, || {
        let scene = PyScene::of_shared(item.read()?.1);
        let mut files = Vec::new();
        // With what a derived scene says of itself.
        let derived =
            || -> Result<Recording> { Ok(Recording::from_bytes(&scene.origin.path, scene.bytes(true)?)?) };
        match format {
            Format::Pickle | Format::Native => files.push((path, scene.bytes(format == Format::Native)?)),
            Format::TfRecord => files.push((path, womd::frame(&derived()?.to_scenario()?.data))),
            Format::GpuDrive => files.push((path, derived()?.to_gpudrive()?.json)),
            Format::OpenScenario => {
                let (map, network, scenario) = results::scenario(&derived()?)?;
                files.push((path.with_file_name(map), network.into_bytes()));
                files.push((path, scenario.into_bytes()));
            }
            Format::Parquet => {
                Err(advsage::Error::Value(format!("no scenes are written as {}", format.name())))?
            }
        }
        for (path, bytes) in &files {
            scene.refuse_source(path)?;
            write(path, bytes, Existing::Replace)
                .map_err(|source| Error::Write { path: path.clone(), source })?;
        }
        Ok(files.into_iter().map(|(path, _)| path.display().to_string()).collect())
    })
}

/// A picture of a scene from above, with the selected candidate of an attack. In a notebook it shows itself.
#[pyfunction]
#[pyo3(signature = (scene, attack=None))]
pub(crate) fn draw(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    attack: Option<&Bound<'_, PyAttack>>,
) -> PyResult<PyPicture> {
    let item = Item::of(scene)?;
    let plan = attack.map(|attack| attack.get().attack.trajectory().clone());
    let svg = detached(py, || {
        let (_, shared) = item.read()?;
        let candidates = plan.map(|plan| ("attack".to_owned(), plan)).into_iter().collect();
        results::picture(&shared.0, candidates)
    })?;
    Ok(PyPicture { svg })
}

/// A picture as SVG.
#[pyclass(frozen, module = "advsage", name = "Picture")]
pub(crate) struct PyPicture {
    svg: String,
}

#[pymethods]
impl PyPicture {
    /// Its text.
    #[getter]
    fn svg(&self) -> &str {
        &self.svg
    }

    /// Writes it. Replaces a file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        detached(py, || {
            write(&path, self.svg.as_bytes(), Existing::Replace)
                .map_err(|source| Error::Write { path: path.clone(), source })?;
            Ok(())
        })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py, (String,)>> {
        Ok((py.get_type::<Self>().getattr("_of_svg")?, (self.svg.clone(),)))
    }

    #[classmethod]
    fn _of_svg(_class: &Bound<'_, PyType>, svg: String) -> Self {
        Self { svg }
    }

    fn _repr_svg_(&self) -> &str {
        &self.svg
    }

    fn __repr__(&self) -> String {
        format!("<Picture: SVG, {} kB>", self.svg.len() / 1000)
    }
}
