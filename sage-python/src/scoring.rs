//! Scores of trajectories of the adversary.

use numpy::PyArrayDyn;
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};
use sage_core::{
    motion::{NOW, Trajectory, check_path},
    objective::{Context, ContextOptions, Convention, EgoPaths, FurtherMeasures, Scorer, Scores, Sizes},
};
use sage_run::Result;
use sage_sim::avoidable::{Avoidable, Avoidance, AvoidanceOptions};
use serde::Serialize;

use crate::{
    errors::{OptionError, UnknownName, detached},
    parts::registries,
    scene::PyScene,
    values,
};

/// A row of `sage score --json` without its name.
#[derive(Serialize)]
struct ScoreRow {
    #[serde(flatten)]
    scores: Scores,
    #[serde(flatten)]
    avoidable: Option<Avoidable>,
}

/// Scores trajectories of the adversary: one dictionary each, as `sage score --json` prints them.
///
/// `candidates` is an array (n, 80, 2) or (80, 2): positions from frame 11 on, metres. `ego` is the ego's path in the same
/// frames, (n, 2) positions or (n, 3) with headings; without it the recording. `convention` is "paper", or "release", as the published
/// code computes; `sizes` "logged", or "metadrive", the boxes of its vehicle classes. `avoidable` also searches evasive manoeuvres.
#[pyfunction]
#[pyo3(signature = (scene, candidates, *, convention="paper", ego=None, sizes="logged", avoidable=false))]
pub(crate) fn score<'py>(
    py: Python<'py>,
    scene: &Bound<'py, PyScene>,
    candidates: &Bound<'py, PyAny>,
    convention: &str,
    ego: Option<&Bound<'py, PyAny>>,
    sizes: &str,
    avoidable: bool,
) -> PyResult<Bound<'py, PyList>> {
    let rows = scored(py, scene, candidates, convention, ego, sizes, avoidable)?;
    let rows = rows.iter().map(|row| values::from_serde(py, row)).collect::<PyResult<Vec<_>>>()?;
    PyList::new(py, rows)
}

/// The numbers of `score` as columns: a dictionary of arrays (n,), in which NaN is what cannot be measured. A number of
/// steps is a float, and `feasible`, `feasible_drivable`, `collision` and `believable` are 1, 0 or NaN.
#[pyfunction]
#[pyo3(signature = (scene, candidates, *, convention="paper", ego=None, sizes="logged", avoidable=false))]
pub(crate) fn score_columns<'py>(
    py: Python<'py>,
    scene: &Bound<'py, PyScene>,
    candidates: &Bound<'py, PyAny>,
    convention: &str,
    ego: Option<&Bound<'py, PyAny>>,
    sizes: &str,
    avoidable: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let rows = scored(py, scene, candidates, convention, ego, sizes, avoidable)?;
    let columns = py.detach(|| columns(&rows)).map_err(|error| OptionError::new_err(error.to_string()))?;
    let dict = PyDict::new(py);
    for (name, column) in columns {
        let column: Bound<'py, PyArrayDyn<f64>> = values::array(py, column, &[rows.len()])?;
        dict.set_item(name, column)?;
    }
    Ok(dict)
}

/// All numbers and truth values of rows, by name.
fn columns(rows: &[ScoreRow]) -> serde_json::Result<Vec<(String, Vec<f64>)>> {
    use serde_json::Value;
    let rows = rows.iter().map(serde_json::to_value).collect::<serde_json::Result<Vec<Value>>>()?;
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let number = |value: &Value| match value {
        Value::Bool(is) => Some(f64::from(u8::from(*is))),
        Value::Number(number) => number.as_f64(),
        Value::Null => Some(f64::NAN),
        _ => None,
    };
    for (k, row) in rows.iter().enumerate() {
        let fields = row.as_object().into_iter().flatten();
        let mut all: Vec<(String, f64)> = Vec::new();
        for (name, value) in fields {
            if let Some(value) = number(value) {
                all.push((name.clone(), value));
            } else if name == "rewards" {
                // Rewards beyond the fields, each a column of its own.
                let rewards = value.as_object().into_iter().flatten();
                all.extend(rewards.filter_map(|(name, value)| Some((name.clone(), number(value)?))));
            }
        }
        for (name, value) in all {
            let at = columns.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
                columns.push((name, vec![f64::NAN; rows.len()]));
                columns.len() - 1
            });
            columns[at].1[k] = value;
        }
    }
    // What is null in every row may be a text elsewhere, such as the side that is hit.
    columns.retain(|(name, _)| name != "side_hit");
    Ok(columns)
}

fn scored(
    py: Python<'_>,
    scene: &Bound<'_, PyScene>,
    candidates: &Bound<'_, PyAny>,
    convention: &str,
    ego: Option<&Bound<'_, PyAny>>,
    sizes: &str,
    avoidable: bool,
) -> PyResult<Vec<ScoreRow>> {
    let convention = match convention {
        "paper" => Convention::Paper,
        "release" => Convention::Release,
        _ => {
            return Err(UnknownName::new_err(format!(
                "unknown convention `{convention}`; known: paper, release"
            )));
        }
    };
    let sizes = match sizes {
        "logged" => Sizes::Logged,
        "metadrive" => Sizes::MetaDrive { cycle: 0 },
        _ => return Err(UnknownName::new_err(format!("unknown sizes `{sizes}`; known: logged, metadrive"))),
    };
    let ego = ego.map(ego_path).transpose()?;
    let trajectories = values::trajectories("candidates", candidates)?;
    let data = &scene.get().data;
    detached(py, || {
        let options = ContextOptions { convention, sizes, ego, ..ContextOptions::default() };
        let ctx = Context::new(&data.scene, &data.index, &options)?;
        rows(&ctx, trajectories, avoidable)
    })
}

fn rows(ctx: &Context, trajectories: Vec<Trajectory>, avoidable: bool) -> Result<Vec<ScoreRow>> {
    let registries = registries()?;
    let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, None)?;
    let scorer = Scorer::with(ctx, &further);
    let avoidance = avoidable.then(|| Avoidance::new(ctx, AvoidanceOptions::default())).transpose()?;
    let score = |(k, trajectory): (usize, Trajectory)| {
        let prepared = ctx.candidate(trajectory);
        let start = prepared.start().position;
        check_path([(0, start), (1, prepared.points()[0])]).map_err(|problem| {
            advsage::Error::Value(format!(
                "candidates: point 0 of candidate {k} {problem}, the adversary's at frame {NOW}"
            ))
        })?;
        let avoidable = avoidance.as_ref().map(|avoidance| avoidance.of(&prepared));
        Ok(ScoreRow { scores: scorer.scores(&prepared), avoidable })
    };
    trajectories.into_iter().enumerate().map(score).collect()
}

/// The ego's path of an array.
///
/// *Errors*: another shape, and points that no path has.
fn ego_path(value: &Bound<'_, PyAny>) -> PyResult<EgoPaths> {
    const EXPECTED: &str = "an array (n, 2) of positions or (n, 3) with headings, 1 to 80 rows";
    let (shape, numbers) = values::numbers("ego", value, EXPECTED)?;
    let [_, width @ (2 | 3)] = shape[..] else {
        return Err(OptionError::new_err(format!("ego has the shape {shape:?}; expected {EXPECTED}")));
    };
    let rows = || numbers.chunks_exact(width);
    let positions = rows().map(|row| [row[0], row[1]]).collect();
    let headings = (width == 3).then(|| rows().map(|row| row[2]).collect());
    EgoPaths::one("ego", positions, headings).map_err(|error| OptionError::new_err(error.to_string()))
}
