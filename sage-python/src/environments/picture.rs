//! What a picture of an environment shows: numbers, which `advsage.gym` draws.

use pyo3::{prelude::*, types::PyDict};
use sage_core::scene::{MapKind, TrackKind};
use sage_sim::environment::Environment;

use crate::values;

/// The moving part: `ego` (x, y, heading), `boxes` (number of the kind, and four corners each), `route` (points), `scene` (its id) and `time`
/// (seconds).
pub(crate) fn shown<'py>(py: Python<'py>, environment: &Environment) -> PyResult<Bound<'py, PyDict>> {
    let world = environment.world();
    let scene = world.scene();
    let adversary = world.plan().map(|plan| plan.track);
    let (mut kinds, mut corners) = (vec![0_i64], world.area().corners().as_flattened().to_vec());
    for body in world.bodies() {
        let kind = match scene.scene().tracks[body.track].kind {
            _ if Some(body.track) == adversary => 1,
            TrackKind::Vehicle => 2,
            _ => 3,
        };
        kinds.push(kind);
        corners.extend(body.area.corners().as_flattened());
    }
    let dict = PyDict::new(py);
    let motion = world.motion();
    let [x, y] = motion.position;
    dict.set_item("ego", (x, y, motion.heading))?;
    let count = kinds.len();
    dict.set_item("kinds", values::array(py, kinds, &[count])?)?;
    dict.set_item("corners", values::array(py, corners, &[count, 4, 2])?)?;
    let route: Vec<f64> = scene.route().points().flatten().collect();
    let count = route.len() / 2;
    dict.set_item("route", values::array(py, route, &[count, 2])?)?;
    dict.set_item("scene", &scene.scene().id)?;
    dict.set_item("time", world.step_count() as f64 / 10.0)?;
    Ok(dict)
}

/// The map: identifier of the scene, and kind and points of each line.
pub(crate) fn map<'py>(py: Python<'py>, environment: &Environment) -> PyResult<Bound<'py, PyAny>> {
    let scene = environment.world().scene();
    let map = scene.index().map();
    let mut lines = Vec::new();
    for (kind, accept) in [
        ("lane", MapKind::is_lane as fn(&MapKind) -> bool),
        ("line", |kind| matches!(kind, MapKind::Line(_))),
        ("edge", MapKind::is_edge),
    ] {
        for (_, points) in map.polylines(accept) {
            let points: Vec<f64> = points.iter().flat_map(|point| [point[0], point[1]]).collect();
            let count = points.len() / 2;
            lines.push((kind, values::array(py, points, &[count, 2])?));
        }
    }
    Ok((scene.scene().id.clone(), lines).into_pyobject(py)?.into_any())
}
