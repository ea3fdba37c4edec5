//! What is known of environments after a step: a dictionary for one, columns for several. Keys are MetaDrive's where it has them.
//!
//! Columns are made here: as dictionaries of each environment in Python they would cost more than the simulation.

use std::collections::HashMap;

use numpy::PyArray1;
use pyo3::{
    IntoPyObjectExt, intern,
    prelude::*,
    sync::PyOnceLock,
    types::{PyDict, PyList, PyString},
};
use sage_sim::{
    batch::{Last, Row},
    observation::LENGTH,
};

use super::scenes::Counts;
use crate::values;

type Flag = fn(&Row) -> bool;
type Number = fn(&Row) -> f64;

/// What is known of every environment, as a column too.
const FLAGS: [(&str, Flag); 8] = [
    ("crash_vehicle", |row| row.outcome.vehicle_contact),
    ("crash_object", |row| row.outcome.object_contact),
    ("crash_human", |row| row.outcome.human_contact),
    ("crash_sidewalk", |row| row.on_edge),
    // MetaDrive has no other name for an episode that ends because the car drives backwards.
    ("out_of_road", |row| row.outcome.out_of_road || row.drove_backwards),
    ("arrive_dest", |row| row.outcome.arrived),
    ("max_step", |row| row.is_at_limit),
    ("under_attack", |row| row.intensity.is_some()),
];
const NUMBERS: [(&str, Number); 5] = [
    ("cost", |row| row.outcome.cost),
    ("step_reward", |row| row.progress_reward),
    ("route_completion", |row| row.outcome.completion),
    ("lateral_dist", |row| row.across),
    ("distance_to_log", |row| row.outcome.distance_to_log),
];
/// What is 1 in a step in which something happens: of one environment alone.
const COUNTS: [(&str, Flag); 4] = [
    ("num_crash_object", |row| row.outcome.object_contact),
    ("num_crash_human", |row| row.outcome.human_contact),
    ("num_crash_vehicle", |row| row.outcome.vehicle_contact),
    ("num_on_line", |row| row.on_line || row.on_edge),
];
/// What MetaDrive has and no scene here: 0 throughout.
const ZEROS: [&str; 4] =
    ["step_reward_lateral", "step_reward_heading", "step_reward_action_smooth", "scenario_difficulty"];

/// The other keys.
const OTHER_KEYS: [&str; 14] = [
    "scenario_index",
    "episode_reward",
    "episode_length",
    "attack_lambda",
    "crash",
    "crash_building",
    "curriculum_level",
    "env_seed",
    "num_stored_maps",
    "track_length",
    "carsize",
    "data_coverage",
    "curriculum_success",
    "curriculum_route_completion",
];

/// λ of the attack; `None` without one, and for one at a mixture of experts.
fn lambda(row: &Row) -> Option<f64> {
    row.intensity.filter(|lambda| lambda.is_finite())
}

/// The info of one environment; `episode` are the return and the length of the episode, after a step.
pub(crate) fn info<'py>(
    py: Python<'py>,
    row: &Row,
    counts: Counts,
    episode: Option<(f64, usize)>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let flag = |key: &'static str, is: bool| dict.set_item(interned(py, key), is);
    let number = |key: &'static str, value: f64| dict.set_item(interned(py, key), value);
    let count = |key: &'static str, value: usize| dict.set_item(interned(py, key), value);
    for (key, of) in FLAGS {
        flag(key, of(row))?;
    }
    let outcome = &row.outcome;
    flag("crash", outcome.vehicle_contact || outcome.object_contact || outcome.human_contact || row.on_edge)?;
    flag("crash_building", false)?;
    for (key, of) in NUMBERS {
        number(key, of(row))?;
    }
    for (key, of) in COUNTS {
        count(key, of(row).into())?;
    }
    for key in ZEROS {
        number(key, 0.0)?;
    }
    count("curriculum_level", 0)?;
    let scene = counts.first + row.scene;
    count("env_seed", scene)?;
    count("scenario_index", scene)?;
    count("num_stored_maps", row.scenes_begun.min(counts.in_memory))?;
    number("track_length", row.route_length)?;
    let [length, width] = row.size;
    dict.set_item(interned(py, "carsize"), [width, length])?;
    // As MetaDrive has it: of the scenes of this environment.
    let share = |sum: f64| sum * counts.workers as f64 / counts.all as f64;
    number("data_coverage", share(row.scenes_begun as f64))?;
    number("curriculum_success", share(row.arrivals as f64))?;
    number("curriculum_route_completion", share(row.completions))?;
    lambda(row).map(|lambda| number("attack_lambda", lambda)).transpose()?;
    if let Some((total, steps)) = episode {
        number("episode_reward", total)?;
        count("episode_length", steps)?;
    }
    Ok(dict)
}

/// Keys, each with that of its mask in columns.
type Keys = HashMap<&'static str, [Py<PyString>; 2]>;

/// All keys, made once: a text costs as much as its column.
fn all_keys(py: Python<'_>) -> &Keys {
    static KEYS: PyOnceLock<Keys> = PyOnceLock::new();
    KEYS.get_or_init(py, || {
        let flags = FLAGS.into_iter().chain(COUNTS).map(|(key, _)| key);
        let names = flags.chain(NUMBERS.map(|(key, _)| key)).chain(ZEROS).chain(OTHER_KEYS);
        let interned = |key: &str| PyString::intern(py, key).unbind();
        names.map(|key| (key, [interned(key), interned(&format!("_{key}"))])).collect()
    })
}

/// A key of this file, all of which are there.
fn interned<'py>(py: Python<'py>, key: &'static str) -> Bound<'py, PyString> {
    all_keys(py)[key][0].bind(py).clone()
}

/// The infos of several environments, as Gymnasium has them: for each key a column, and under the key with `_` before it where it
/// counts.
#[derive(Clone, Copy)]
pub(crate) struct Infos<'r> {
    pub(crate) rows: &'r [Row],
    /// Number of the first scene.
    pub(crate) first: usize,
}

impl Infos<'_> {
    /// The columns, in which all rows count.
    pub(crate) fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.masked(py, &vec![true; self.rows.len()])
    }

    /// The columns, in which some rows count.
    fn masked<'py>(&self, py: Python<'py>, counts: &[bool]) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        let keys = all_keys(py);
        let put = |name: &'static str, column: Bound<'py, PyAny>, counts: &[bool]| -> PyResult<()> {
            let [key, mask] = &keys[name];
            dict.set_item(key, column)?;
            dict.set_item(mask, self::column(py, counts))
        };
        for (key, of) in FLAGS {
            put(key, column(py, &self.rows.iter().map(of).collect::<Vec<bool>>()), counts)?;
        }
        let returned: (&'static str, Number) = ("episode_reward", |row| row.episode_return);
        for (key, of) in NUMBERS.into_iter().chain([returned]) {
            put(key, column(py, &self.rows.iter().map(of).collect::<Vec<f64>>()), counts)?;
        }
        let scenes: Vec<i64> = self.rows.iter().map(|row| (self.first + row.scene) as i64).collect();
        put("scenario_index", column(py, &scenes), counts)?;
        let lengths: Vec<i64> = self.rows.iter().map(|row| row.steps as i64).collect();
        put("episode_length", column(py, &lengths), counts)?;
        let lambdas: Vec<f64> = self.rows.iter().map(|row| lambda(row).unwrap_or(0.0)).collect();
        let known = self.rows.iter().zip(counts).map(|(row, counts)| *counts && lambda(row).is_some());
        put("attack_lambda", column(py, &lambdas), &known.collect::<Vec<bool>>())?;
        Ok(dict)
    }

    /// Adds how the episodes ended that the same step has reset.
    pub(crate) fn add_last(
        &self,
        py: Python<'_>,
        infos: &Bound<'_, PyDict>,
        last: &[Option<Last>],
    ) -> PyResult<()> {
        let ended: Vec<bool> = last.iter().map(Option::is_some).collect();
        let rows: Vec<Row> =
            last.iter().map(|last| last.as_ref().map_or(Row::default(), |last| last.row)).collect();
        let observations = last.iter().map(|last| match last {
            Some(last) => values::array(py, last.observation.to_vec(), &[LENGTH])?.into_bound_py_any(py),
            None => Ok(py.None().into_bound(py)),
        });
        let observations = PyList::new(py, observations.collect::<PyResult<Vec<_>>>()?)?;
        let final_info = Infos { rows: &rows, ..*self }.masked(py, &ended)?;
        infos.set_item(intern!(py, "final_obs"), observations)?;
        infos.set_item(intern!(py, "_final_obs"), column(py, &ended))?;
        infos.set_item(intern!(py, "final_info"), final_info)?;
        infos.set_item(intern!(py, "_final_info"), column(py, &ended))?;
        Ok(())
    }
}

fn column<'py, T: numpy::Element>(py: Python<'py>, values: &[T]) -> Bound<'py, PyAny> {
    PyArray1::from_slice(py, values).into_any()
}
