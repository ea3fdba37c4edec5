//! What a planner of Python sees: numbers that become arrays when they are read.
//!
//! A step holds a copy of the world (a microsecond), so the 101 numbers are computed only for planners that ask.

use std::sync::Arc;

use pyo3::{
    prelude::*,
    types::{PyList, PyTuple},
};
use sage_core::scene::MapKind;
use sage_sim::{
    observation::{LENGTH, LaterObservation},
    policy::planner::{AGENTS, ToldAgent, ToldScene, ToldStep},
};

use crate::{errors::detached, values};

/// Frames of the history, the present one included.
pub(crate) const HISTORY: usize = 10;
/// Numbers of a road user: x, y, heading, vx, vy, length, width.
const ROW: usize = 7;

/// What a planner is told of a scene, behind `advsage.planner.Scene`.
#[pyclass(frozen, module = "advsage._advsage", name = "ToldScene")]
pub(crate) struct PyToldScene(Arc<ToldScene>);

impl PyToldScene {
    pub(crate) fn new(told: Arc<ToldScene>) -> Self {
        Self(told)
    }
}

#[pymethods]
impl PyToldScene {
    /// Identifier of the scene.
    #[getter]
    fn id(&self) -> &str {
        self.0.id()
    }

    /// Corner points of the route.
    fn route(&self) -> Vec<(f64, f64)> {
        self.0.route().map(|[x, y]| (x, y)).collect()
    }

    /// Sizes and limits of the car, by name.
    fn car<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        values::from_serde(py, self.0.vehicle())
    }

    /// The features of the map near the route: a list of dictionaries.
    fn map<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        values::from_serde(py, &self.0.map())
    }

    /// Lights on the route: a list of dictionaries with `lane`, `along` and `point`.
    fn lights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        values::from_serde(py, &self.0.lights())
    }

    /// The other lights: a list of dictionaries with `lane` and `point`.
    fn other_lights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        values::from_serde(py, &self.0.other_lights())
    }

    /// Identifiers of the lanes that the route follows.
    fn route_lanes(&self) -> Vec<&str> {
        self.0.route_lanes()
    }

    /// Where the recording ends along the route, metres, if the planner asks.
    #[getter]
    fn goal(&self) -> Option<f64> {
        self.0.goal()
    }

    /// How the planner is to follow its plans, if it offers ways.
    #[getter]
    fn follow(&self) -> Option<&str> {
        self.0.follow()
    }

    /// Points of all lanes, or of all edges, of the scene: a list of arrays (points, 3).
    fn lines<'py>(&self, py: Python<'py>, of_edges: bool) -> PyResult<Bound<'py, PyList>> {
        let map = self.0.scene().index().map();
        let accept = |kind: &MapKind| if of_edges { kind.is_edge() } else { kind.is_lane() };
        let all = PyList::empty(py);
        for (_, points) in map.polylines(accept) {
            all.append(values::shared_array(py, points.as_flattened().to_vec(), &[points.len(), 3])?)?;
        }
        Ok(all)
    }
}

/// What a planner is told before a step, behind `advsage.planner.Observation`.
#[pyclass(frozen, module = "advsage._advsage", name = "ToldStep")]
pub(crate) struct PyStep {
    scene: Arc<ToldScene>,
    /// The last frames, the present one last, with whether the planner was asked then.
    frames: Vec<(Arc<ToldStep>, bool)>,
    observation: Option<LaterObservation>,
}

impl PyStep {
    pub(crate) fn new(
        scene: Arc<ToldScene>,
        frames: Vec<(Arc<ToldStep>, bool)>,
        observation: Option<LaterObservation>,
    ) -> Self {
        Self { scene, frames, observation }
    }

    fn now(&self) -> &ToldStep {
        &self.frames[self.frames.len() - 1].0
    }

    fn track_id(&self, track: usize) -> &str {
        &self.scene.scene().scene().tracks[track].id
    }
}

#[pymethods]
impl PyStep {
    /// Seconds since frame 0.
    #[getter]
    fn t(&self) -> f64 {
        self.now().t
    }

    /// x, y, heading, vx, vy, yaw rate, acceleration and angle of the front wheels of the car.
    fn ego(&self) -> [f64; 8] {
        let now = self.now();
        let ([x, y], [vx, vy]) = (now.position, now.velocity);
        [x, y, now.heading, vx, vy, now.yaw_rate, now.acceleration, now.steering_angle]
    }

    /// The other road users, the nearest first: id, type, length, width, x, y, heading, vx and vy of each.
    fn agents<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyTuple>>> {
        let agents = self.now().agents.iter().map(|agent| {
            let ([length, width], [x, y], [vx, vy]) = (agent.size, agent.position, agent.velocity);
            (self.track_id(agent.track), agent.kind, length, width, x, y, agent.heading, vx, vy)
                .into_pyobject(py)
        });
        agents.collect()
    }

    /// The numbers of the other road users: array (agents, 7).
    fn agent_rows<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let agents = &self.now().agents;
        let rows = agents.iter().flat_map(row).collect();
        Ok(values::array(py, rows, &[agents.len(), ROW])?.into_any())
    }

    /// The same over the last ten frames: array (64, 10, 7), and where it is known: array (64, 10) of bool. The present
    /// frame is the last, and road users are in the present order.
    fn agent_history<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let (mut rows, mut mask) = (vec![0.0; AGENTS * HISTORY * ROW], vec![false; AGENTS * HISTORY]);
        let first = HISTORY - self.frames.len();
        for (k, agent) in self.now().agents.iter().enumerate() {
            for (frame, (step, _)) in self.frames.iter().enumerate() {
                let Some(then) = step.agents.iter().find(|other| other.track == agent.track) else {
                    continue;
                };
                let at = k * HISTORY + first + frame;
                mask[at] = true;
                rows[at * ROW..(at + 1) * ROW].copy_from_slice(&row(then));
            }
        }
        let rows = values::array(py, rows, &[AGENTS, HISTORY, ROW])?.into_any();
        Ok((rows, values::array(py, mask, &[AGENTS, HISTORY])?.into_any()))
    }

    /// States of the lights on the route.
    fn lights(&self) -> Vec<&'static str> {
        self.now().lights.clone()
    }

    /// States of the other lights.
    fn other_lights(&self) -> Vec<&'static str> {
        self.now().other_lights.clone()
    }

    /// The 101 numbers of a learning driver: array (101,) of 32-bit floats.
    fn vector<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let numbers = match &self.observation {
            Some(observation) => detached(py, || Ok(observation.numbers()))?,
            None => Box::new([0.0; LENGTH]),
        };
        Ok(values::array(py, numbers.to_vec(), &[LENGTH])?.into_any())
    }

    /// The messages of the last ten frames in which the planner was asked, as the protocol of programs has them: a list of
    /// dictionaries.
    fn messages<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let scene = self.scene.scene().scene();
        let asked = self.frames.iter().filter(|(_, is_asked)| *is_asked);
        let all = asked.map(|(step, _)| values::from_serde(py, &step.message(scene, None)));
        PyList::new(py, all.collect::<PyResult<Vec<_>>>()?)
    }

    /// Ids of the other road users, the nearest first.
    fn agent_ids(&self) -> Vec<&str> {
        self.now().agents.iter().map(|agent| self.track_id(agent.track)).collect()
    }
}

/// The numbers of a road user.
fn row(agent: &ToldAgent) -> [f64; ROW] {
    let ([x, y], [vx, vy], [length, width]) = (agent.position, agent.velocity, agent.size);
    [x, y, agent.heading, vx, vy, length, width]
}
