//! A drive as a value of Python, and the function that makes it.

use std::borrow::Cow;

use pyo3::{prelude::*, types::PyType};
use sage_core::geometry::Point;
use sage_run::Result;
use sage_sim::vehicle::Motion;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{
    driven::{Attacker, Driven},
    errors::{OptionError, detached},
    items,
    made_once::MadeOnce,
    parts::Driver,
    results::{AttackOfDrive, DriveResult},
    scene::PyScene,
    values::{self, Reduced},
};

/// x, y, heading and speed.
type State = [f64; 4];

/// All that is known of a drive, also after it was pickled.
#[derive(Clone, Serialize, Deserialize)]
struct Record {
    row: Value,
    ending: String,
    page: String,
    states: Vec<State>,
    states_before: Option<Vec<State>>,
    plan: Option<Vec<Point>>,
}

/// Where what is known of a drive comes from.
enum Content {
    Driven(Box<Driven>),
    Recorded(Box<Record>),
}

fn states(motions: &[Motion]) -> Vec<State> {
    let state = |motion: &Motion| [motion.position[0], motion.position[1], motion.heading, motion.speed()];
    motions.iter().map(state).collect()
}

/// A drive of the ego from frame 0 up to its first contact or to the horizon, alone or under attack.
#[pyclass(frozen, module = "advsage", name = "Episode", weakref)]
pub(crate) struct PyEpisode {
    scene: Py<PyScene>,
    ego: String,
    seed: u64,
    content: Content,
    trajectory: MadeOnce,
    trajectory_before: MadeOnce,
    plan: MadeOnce,
    row: MadeOnce,
}

impl PyEpisode {
    pub(crate) fn new(scene: Py<PyScene>, ego: String, seed: u64, driven: Driven) -> Self {
        Self::of(scene, ego, seed, Content::Driven(Box::new(driven)))
    }

    fn of(scene: Py<PyScene>, ego: String, seed: u64, content: Content) -> Self {
        let [trajectory, trajectory_before, plan, row] = Default::default();
        Self { scene, ego, seed, content, trajectory, trajectory_before, plan, row }
    }

    /// The drive as the library records and shows it.
    fn result<'a>(&'a self, driven: &'a Driven) -> DriveResult<'a> {
        let data = &self.scene.get().data;
        let attack = driven.attacked.as_ref().map(|attacked| AttackOfDrive {
            ctx: &attacked.ctx,
            before: &attacked.before,
            trajectory: &attacked.plan,
            verdict: attacked.verdict,
            extension: attacked.extension.as_ref(),
        });
        DriveResult {
            scene: &data.scene,
            name: &data.name,
            ego: &self.ego,
            seed: self.seed,
            episode: &driven.episode,
            attack,
        }
    }

    fn record(&self) -> Result<Cow<'_, Record>> {
        Ok(match &self.content {
            Content::Recorded(record) => Cow::Borrowed(record),
            Content::Driven(driven) => Cow::Owned(Record {
                row: self.result(driven).row()?,
                ending: self.result(driven).ending()?,
                page: self.result(driven).page()?,
                states: states(&driven.episode.drive.motions),
                states_before: driven.attacked.as_ref().map(|attacked| states(&attacked.before.motions)),
                plan: driven.attacked.as_ref().map(|attacked| attacked.plan.points().to_vec()),
            }),
        })
    }

    /// A field of the row.
    fn field<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        self.row(py)?.into_bound(py).get_item(name)
    }
}

fn array_of_states(py: Python<'_>, states: &[State]) -> PyResult<Py<PyAny>> {
    values::shared_array(py, states.as_flattened().to_vec(), &[states.len(), 4])
}

#[pymethods]
impl PyEpisode {
    /// The scene.
    #[getter]
    fn scene(&self, py: Python<'_>) -> Py<PyScene> {
        self.scene.clone_ref(py)
    }

    /// Name of the driver.
    #[getter]
    fn ego(&self) -> &str {
        &self.ego
    }

    /// x, y (metres), heading (rad) and speed (m/s) of the ego at each frame from 0 on: array (frames, 4), read-only.
    #[getter]
    fn trajectory(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.trajectory.get(py, || match &self.content {
            Content::Driven(driven) => array_of_states(py, &states(&driven.episode.drive.motions)),
            Content::Recorded(record) => array_of_states(py, &record.states),
        })
    }

    /// x, y, heading and speed of the ego in the drive before the attack, which the attack was planned against: array (frames, 4),
    /// read-only. None without an attack.
    #[getter]
    fn trajectory_before(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let states = match &self.content {
            Content::Driven(driven) => {
                driven.attacked.as_ref().map(|attacked| states(&attacked.before.motions))
            }
            Content::Recorded(record) => record.states_before.clone(),
        };
        states.map(|states| self.trajectory_before.get(py, || array_of_states(py, &states))).transpose()
    }

    /// Positions of the adversary's plan, metres: array (80, 2), read-only. None without an attack.
    #[getter]
    fn plan(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let points = match &self.content {
            Content::Driven(driven) => driven.attacked.as_ref().map(|attacked| attacked.plan.points()),
            Content::Recorded(record) => record.plan.as_deref(),
        };
        let array =
            |points: &[Point]| values::shared_array(py, points.as_flattened().to_vec(), &[points.len(), 2]);
        points.map(|points| self.plan.get(py, || array(points))).transpose()
    }

    /// "contact" or "horizon".
    #[getter]
    fn end<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.field(py, "end")
    }

    /// All that `sage simulate` records of the drive: a dictionary. Steps count from *now*.
    #[getter]
    fn row(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.row.get(py, || {
            let row = match &self.content {
                Content::Driven(driven) => detached(py, || self.result(driven).row())?,
                Content::Recorded(record) => record.row.clone(),
            };
            Ok(values::from_json(py, &row)?.unbind())
        })
    }

    /// Contacts of the ego, the first one first: a list of dictionaries with `step`, `with` (track id), `impact_speed` (m/s), `overlap`
    /// (metres), `side_hit`, `at_fault`, `class`.
    #[getter]
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.field(py, "contacts")
    }

    /// What `sage simulate` records of the attack: `feasible`, `verdict`, and of the attacked drive, where the attack works, `believable`,
    /// `avoidable` and `latest_start` (seconds before the contact at which an evasive manoeuvre could still begin), `latest_brake`,
    /// `latest_steer`, ... None without an attack.
    #[getter]
    fn attack<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.field(py, "attack")
    }

    /// Whether the attack works, a dictionary. None without an attack.
    ///
    /// - `attack`: the ego's first contact is with the adversary after now, the plan is feasible, and there is no such contact without it.
    /// - `at_fault`: it works, and nuPlan's rule gives the fault to the ego. `solid`: it works, and the boxes overlap by 0.5 m or more.
    /// - `any_vehicle`: the first contact is with any vehicle (the published flag).
    #[getter]
    fn verdict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        if let Content::Driven(driven) = &self.content {
            // Without the search for evasive manoeuvres, which the row asks for.
            return match &driven.attacked {
                Some(attacked) => values::from_serde(py, &attacked.verdict),
                None => Ok(py.None().into_bound(py)),
            };
        }
        let attack = self.attack(py)?;
        if attack.is_none() { Ok(attack) } else { attack.get_item("verdict") }
    }

    /// Driven share of the logged route; None if that is below 5 m.
    #[getter]
    fn completion<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.field(py, "completion")
    }

    /// A page that plays the drive, as text.
    fn html(&self, py: Python<'_>) -> PyResult<String> {
        match &self.content {
            Content::Driven(driven) => detached(py, || self.result(driven).page()),
            Content::Recorded(record) => Ok(record.page.clone()),
        }
    }

    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        let page = self.html(py)?.replace('&', "&amp;").replace('"', "&quot;");
        Ok(format!(r#"<iframe srcdoc="{page}" style="width:100%;height:640px;border:0"></iframe>"#))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let ending = match &self.content {
            Content::Driven(driven) => detached(py, || self.result(driven).ending())?,
            Content::Recorded(record) => record.ending.clone(),
        };
        Ok(format!("<Episode of '{}' in '{}': {ending}>", self.ego, self.scene.get().data.name))
    }

    /// Drives do not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    #[expect(clippy::type_complexity, reason = "the arguments of `_rebuilt`")]
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py, (Py<PyScene>, String, u64, String)>> {
        let record = detached(py, || Ok(serde_json::to_string(&self.record()?)?))?;
        let rebuild = py.get_type::<Self>().getattr("_rebuilt")?;
        Ok((rebuild, (self.scene.clone_ref(py), self.ego.clone(), self.seed, record)))
    }

    #[classmethod]
    fn _rebuilt(
        _class: &Bound<'_, PyType>,
        scene: Py<PyScene>,
        ego: String,
        seed: u64,
        record: &str,
    ) -> PyResult<Self> {
        let record = serde_json::from_str(record);
        let record = record.map_err(|_| OptionError::new_err("the pickled episode is damaged"))?;
        Ok(Self::of(scene, ego, seed, Content::Recorded(record)))
    }
}

/// Drives a scene.
///
/// `ego` is the name of a driver (`'idm'`, `'expert'`, `'pdm'`, `'replay'`, `'td3:FILE'`, `'cmd:COMMAND'`,
/// `'py:package.module:Class'`) or your planner: an object with `act(obs)`. `attack` is a `Generator`, which plans against what the
/// driver does in the unchanged scene; an `Attack`; or positions (80, 2). Without it the scene is as it was recorded.
#[pyfunction]
#[pyo3(signature = (scene, ego=None, attack=None, *, seed=0))]
pub(crate) fn simulate(
    py: Python<'_>,
    scene: &Bound<'_, PyAny>,
    ego: Option<&Bound<'_, PyAny>>,
    attack: Option<&Bound<'_, PyAny>>,
    #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
) -> PyResult<PyEpisode> {
    let scene = items::scene_of(scene)?;
    let driver = Driver::of_optional(py, ego, "idm")?;
    let attacker = Attacker::of(attack, seed)?;
    let data = &scene.get().data;
    let driven = detached(py, || Driven::new(data, &driver, &attacker, seed))?;
    Ok(PyEpisode::new(scene, driver.label, seed, driven))
}
