//! What is known of environments after a step: a dictionary for one, columns for several. Keys are MetaDrive's where it has them.

use numpy::PyArrayDyn;
use pyo3::{
    IntoPyObjectExt, intern,
    prelude::*,
    types::{PyDict, PyList},
};
use sage_sim::{
    batch::{Last, Row},
    observation::LENGTH,
};

use crate::{environment_scenes::Counts, values};

/// The info of one environment; `episode` are the return and the length of the episode, after a step.
pub(crate) fn info<'py>(
    py: Python<'py>,
    row: &Row,
    counts: Counts,
    episode: Option<(f64, usize)>,
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    macro_rules! set {
        ($($key:literal: $value:expr,)*) => { $(dict.set_item(intern!(py, $key), $value)?;)* };
    }
    let outcome = &row.outcome;
    let scene = counts.first + row.scene;
    let share = |sum: f64| sum / counts.all as f64;
    let crash = outcome.vehicle_contact || outcome.object_contact || outcome.human_contact || row.on_edge;
    set! {
        "crash_vehicle": outcome.vehicle_contact,
        "crash_object": outcome.object_contact,
        "crash_building": false,
        "crash_human": outcome.human_contact,
        "crash_sidewalk": row.on_edge,
        "crash": crash,
        "out_of_road": outcome.out_of_road,
        "arrive_dest": outcome.arrived,
        "max_step": row.is_at_limit,
        "env_seed": scene,
        "cost": outcome.cost,
        "num_crash_object": u8::from(outcome.object_contact),
        "num_crash_human": u8::from(outcome.human_contact),
        "num_crash_vehicle": u8::from(outcome.vehicle_contact),
        "num_on_line": u8::from(row.on_line || row.on_edge),
        "step_reward": outcome.progress,
        "step_reward_lateral": 0.0,
        "step_reward_heading": 0.0,
        "step_reward_action_smooth": 0.0,
        "track_length": row.route_length,
        "carsize": [row.size[1], row.size[0]],
        "route_completion": outcome.completion,
        "lateral_dist": row.across,
        "scenario_index": scene,
        "scenario_difficulty": 0.0,
        "curriculum_level": 0,
        "data_coverage": share(row.scenes_begun as f64),
        "num_stored_maps": row.scenes_begun.min(counts.in_memory),
        "curriculum_success": share(row.arrivals as f64),
        "curriculum_route_completion": share(row.completions),
        "distance_to_log": outcome.distance_to_log,
        "attacked": row.intensity.is_some(),
    }
    // None for an attack at a mixture of experts.
    if let Some(lambda) = row.intensity.filter(|lambda| lambda.is_finite()) {
        set! { "attack_lambda": lambda, }
    }
    if let Some((total, length)) = episode {
        set! { "episode_reward": total, "episode_length": length, }
    }
    Ok(dict)
}

/// The infos of several environments, as Gymnasium has them: for each key a column, and under the key with `_` before it where it
/// counts.
pub(crate) struct Infos<'r> {
    pub(crate) rows: &'r [Row],
    /// Number of the first scene.
    pub(crate) first: usize,
    pub(crate) has_adversary: bool,
}

impl Infos<'_> {
    /// The columns, in which all rows count.
    pub(crate) fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.masked(py, &vec![true; self.rows.len()])
    }

    /// The columns, in which some rows count.
    fn masked<'py>(&self, py: Python<'py>, counts: &[bool]) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        macro_rules! columns {
            ($($key:literal: $value:expr,)*) => { $(
                let value: fn(&Row) -> _ = $value;
                let values = self.rows.iter().map(value).collect();
                dict.set_item(intern!(py, $key), column(py, values)?)?;
                dict.set_item(intern!(py, concat!("_", $key)), column(py, counts.to_vec())?)?;
            )* };
        }
        columns! {
            "crash_vehicle": |row| row.outcome.vehicle_contact,
            "crash_object": |row| row.outcome.object_contact,
            "crash_human": |row| row.outcome.human_contact,
            "crash_sidewalk": |row| row.on_edge,
            "out_of_road": |row| row.outcome.out_of_road,
            "arrive_dest": |row| row.outcome.arrived,
            "max_step": |row| row.is_at_limit,
            "cost": |row| row.outcome.cost,
            "step_reward": |row| row.outcome.progress,
            "route_completion": |row| row.outcome.completion,
            "lateral_dist": |row| row.across,
            "distance_to_log": |row| row.outcome.distance_to_log,
            "episode_reward": |row| row.episode_return,
            "episode_length": |row| row.steps as i64,
        }
        let scenes = self.rows.iter().map(|row| (self.first + row.scene) as i64).collect();
        dict.set_item(intern!(py, "scenario_index"), column::<i64>(py, scenes)?)?;
        dict.set_item(intern!(py, "_scenario_index"), column(py, counts.to_vec())?)?;
        if self.has_adversary {
            let attacked: Vec<bool> = self.rows.iter().map(|row| row.intensity.is_some()).collect();
            let lambda = |row: &Row| row.intensity.filter(|lambda| lambda.is_finite());
            let known = self.rows.iter().zip(counts).map(|(row, counts)| *counts && lambda(row).is_some());
            dict.set_item(intern!(py, "attacked"), column(py, attacked)?)?;
            dict.set_item(intern!(py, "_attacked"), column(py, counts.to_vec())?)?;
            dict.set_item(intern!(py, "_attack_lambda"), column(py, known.collect::<Vec<bool>>())?)?;
            let lambdas = self.rows.iter().map(|row| lambda(row).unwrap_or(0.0)).collect();
            dict.set_item(intern!(py, "attack_lambda"), column::<f64>(py, lambdas)?)?;
        }
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
        infos.set_item(intern!(py, "_final_obs"), column(py, ended.clone())?)?;
        infos.set_item(intern!(py, "final_info"), final_info)?;
        infos.set_item(intern!(py, "_final_info"), column(py, ended)?)?;
        Ok(())
    }
}

fn column<T: numpy::Element>(py: Python<'_>, values: Vec<T>) -> PyResult<Bound<'_, PyArrayDyn<T>>> {
    let count = values.len();
    values::array(py, values, &[count])
}
