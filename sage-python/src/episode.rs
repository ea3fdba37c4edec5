//! Drives: a driver in a scene, alone or under attack.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
};

use anyhow::Result;
use experiments::results::{AttackOfDrive, DriveResult};
use pyo3::{prelude::*, types::PyIterator};
use sage_core::{
    motion::Trajectory,
    objective::{Context, Scorer},
    scene::SceneData,
};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    drive::Drive,
    episode::{End, Episode, Verdict},
    vehicle::Motion,
};

use crate::{
    ahead::{Ahead, threads},
    attack::PyAttack,
    errors::{OptionError, caught, detached, to_python},
    generator::{Built, PyGenerator},
    made_once::MadeOnce,
    many::{self, Item},
    parts::Driver,
    planner::{Planner, PlannerPolicy, Way, keep_raised},
    scene::{PyScene, Shared},
    together::{Outcome, drive_together},
    values,
};

/// What attacks a driver.
#[derive(Clone)]
pub(crate) enum Attacker {
    /// Nothing: the scene as it is.
    Nobody,
    /// One plan of the adversary, made before.
    Plan(Trajectory),
    /// A generator, which plans against the drive without attack.
    Generator(Arc<Built>),
}

impl Attacker {
    /// The attacker of a value of Python.
    ///
    /// *Errors*: neither an attack, nor a generator, nor positions.
    pub(crate) fn of(attack: Option<&Bound<'_, PyAny>>, seed: u64) -> PyResult<Self> {
        let Some(attack) = attack else { return Ok(Self::Nobody) };
        if let Ok(attack) = attack.cast::<PyAttack>() {
            return Ok(Self::Plan(attack.get().attack.trajectory().clone()));
        }
        if let Ok(generator) = attack.cast::<PyGenerator>() {
            let generator = generator.get();
            return Ok(Self::Generator(detached(attack.py(), || generator.of_seed(seed))?));
        }
        let mut plans = values::trajectories("attack", attack)?;
        match (plans.len(), plans.pop()) {
            (1, Some(plan)) => Ok(Self::Plan(plan)),
            (count, _) => Err(OptionError::new_err(format!(
                "attack holds {count} plans; expected an Attack, a Generator, or positions of shape (80, 2)"
            ))),
        }
    }
}

/// A drive with all that is shown of it.
pub(crate) struct Driven {
    episode: Episode,
    attacked: Option<Attacked>,
}

/// The attack of a drive.
struct Attacked {
    ctx: Context,
    before: Drive,
    plan: Trajectory,
    verdict: Verdict,
}

impl Driven {
    /// Drives a scene.
    ///
    /// *Errors*: a scene that cannot be driven or attacked; a planner that fails.
    pub(crate) fn new(scene: &SceneData, driver: &Driver, attacker: &Attacker, seed: u64) -> Result<Self> {
        let simulated = SimScene::new(scene.scene.clone(), scene.index.clone())?;
        if matches!(attacker, Attacker::Nobody) {
            let episode = Episode::run(&simulated, None, &*driver.policy, seed)?;
            return Ok(Self { episode, attacked: None });
        }
        scene.scene.attackable_horizon()?;
        scene.scene.check_apart_now()?;
        let test = AttackTest::new(&*driver.policy, &simulated, seed)?;
        let ctx = test.context()?;
        ctx.check_apart_now()?;
        let plan = match attacker {
            Attacker::Generator(built) => built.attack_in(&ctx, seed)?.trajectory().clone(),
            Attacker::Plan(plan) => plan.clone(),
            Attacker::Nobody => return Err(sage_bench::Error::Value("there is no attack".to_owned()).into()),
        };
        let is_feasible = Scorer::new(&ctx).scores(&ctx.candidate(plan.clone())).feasible;
        let outcome = test.attack(&plan, is_feasible)?;
        let (episode, verdict) = (outcome.episode, outcome.verdict);
        let attacked = Some(Attacked { ctx, before: test.unattacked().clone(), plan, verdict });
        Ok(Self { episode, attacked })
    }
}

/// A drive up to the first contact or to the horizon.
#[pyclass(frozen, module = "advsage", name = "Episode", weakref)]
pub(crate) struct PyEpisode {
    scene: Py<PyScene>,
    ego: String,
    seed: u64,
    driven: Driven,
    trajectory: MadeOnce,
    before: MadeOnce,
    row: MadeOnce,
}

impl PyEpisode {
    pub(crate) fn new(scene: Py<PyScene>, ego: String, seed: u64, driven: Driven) -> Self {
        let [trajectory, before, row] = Default::default();
        Self { scene, ego, seed, driven, trajectory, before, row }
    }

    /// The drive as the library records and shows it.
    fn result(&self) -> DriveResult<'_> {
        let data = &self.scene.get().data;
        let attack = self.driven.attacked.as_ref().map(|attacked| AttackOfDrive {
            ctx: &attacked.ctx,
            before: &attacked.before,
            trajectory: &attacked.plan,
            verdict: attacked.verdict,
        });
        DriveResult {
            scene: &data.scene,
            name: &data.name,
            ego: &self.ego,
            seed: self.seed,
            episode: &self.driven.episode,
            attack,
        }
    }
}

fn states(py: Python<'_>, motions: &[Motion]) -> PyResult<Py<PyAny>> {
    let state = |motion: &Motion| [motion.position[0], motion.position[1], motion.heading, motion.speed()];
    values::shared_array(py, motions.iter().flat_map(state).collect(), &[motions.len(), 4])
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

    /// x, y, heading and speed of the ego at each frame from 0 on: array (frames, 4), read-only.
    #[getter]
    fn trajectory(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.trajectory.get(py, || states(py, &self.driven.episode.drive.motions))
    }

    /// The same of the drive before the attack, which the attack was planned against; None without an attack.
    #[getter]
    fn before(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let Some(attacked) = &self.driven.attacked else { return Ok(None) };
        self.before.get(py, || states(py, &attacked.before.motions)).map(Some)
    }

    /// "contact" or "horizon".
    #[getter]
    fn end(&self) -> &'static str {
        match self.driven.episode.end {
            End::Contact => "contact",
            End::Horizon => "horizon",
        }
    }

    /// All that `sage simulate` records of the drive: a dictionary.
    #[getter]
    fn row(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.row.get(py, || {
            let row = detached(py, || self.result().row())?;
            Ok(values::from_json(py, &row)?.unbind())
        })
    }

    /// Contacts of the ego, the first one first: a list of dictionaries.
    #[getter]
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.row(py)?.into_bound(py).get_item("contacts")
    }

    /// Whether the attack works: `attack`, `at_fault`, `solid`, `any_vehicle`. None without an attack.
    #[getter]
    fn verdict<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.driven.attacked.as_ref().map(|attacked| values::from_serde(py, &attacked.verdict)).transpose()
    }

    /// Driven share of the logged route; None if that is below 5 m.
    #[getter]
    fn completion(&self) -> Option<f64> {
        self.driven.episode.completion
    }

    /// Positions of the adversary's plan, metres: array (80, 2). None without an attack.
    #[getter]
    fn plan(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let plan = self.driven.attacked.as_ref().map(|attacked| attacked.plan.points());
        plan.map(|points| values::shared_array(py, points.as_flattened().to_vec(), &[points.len(), 2]))
            .transpose()
    }

    /// A page that plays the drive.
    fn html(&self, py: Python<'_>) -> PyResult<String> {
        detached(py, || self.result().page())
    }

    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        let page = self.html(py)?.replace('&', "&amp;").replace('"', "&quot;");
        Ok(format!(r#"<iframe srcdoc="{page}" style="width:100%;height:640px;border:0"></iframe>"#))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let ending = detached(py, || self.result().ending())?;
        Ok(format!("<Episode of '{}' in '{}': {ending}>", self.ego, self.scene.get().data.name))
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
    scene: Py<PyScene>,
    ego: Option<&Bound<'_, PyAny>>,
    attack: Option<&Bound<'_, PyAny>>,
    seed: u64,
) -> PyResult<PyEpisode> {
    let driver = Driver::of_optional(py, ego, "idm")?;
    let attacker = Attacker::of(attack, seed)?;
    let data = &scene.get().data;
    let driven = detached(py, || Driven::new(data, &driver, &attacker, seed))?;
    Ok(PyEpisode::new(scene, driver.label, seed, driven))
}

/// One scene of a list, driven.
type Done = (Option<Py<PyScene>>, Shared, Driven);

fn driven(item: Item, driver: &Driver, attacker: &Attacker, seed: u64) -> Result<Done> {
    let (object, shared) = item.read()?;
    let driven = Driven::new(&shared.0, driver, attacker, seed)?;
    Ok((object, shared, driven))
}

/// Drives in many scenes, in their order.
#[pyclass(module = "advsage._advsage", name = "Episodes", frozen)]
pub(crate) struct PyEpisodes {
    scenes: Py<PyIterator>,
    driver: Driver,
    attacker: Attacker,
    seed: u64,
    /// Scenes that a planner with `act_many` drives at once.
    batch: usize,
    /// `None` for a planner of Python.
    ahead: Option<Mutex<Ahead<Item, Done>>>,
    /// Drives of a batch that are done.
    done: Mutex<VecDeque<Outcome<Done>>>,
}

#[pymethods]
impl PyEpisodes {
    fn __iter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __next__(slf: &Bound<'_, Self>) -> PyResult<Option<PyEpisode>> {
        let (py, this) = (slf.py(), slf.get());
        let outcome = match (&this.ahead, &this.driver.planner) {
            (Some(ahead), _) => this.next_ahead(py, ahead)?,
            (None, Some(planner)) if planner.takes_many => this.next_of_batch(py, planner)?,
            (None, _) => this.next_alone(py)?,
        };
        let Some((result, raised)) = outcome else { return Ok(None) };
        if raised.is_some() {
            keep_raised(raised);
        }
        let (object, shared, driven) = result.map_err(|error| to_python(py, &error))?;
        let scene = many::object(py, object, shared)?;
        Ok(Some(PyEpisode::new(scene, this.driver.label.clone(), this.seed, driven)))
    }
}

impl PyEpisodes {
    fn next_ahead(
        &self,
        py: Python<'_>,
        ahead: &Mutex<Ahead<Item, Done>>,
    ) -> PyResult<Option<Outcome<Done>>> {
        let Ok(mut ahead) = ahead.try_lock() else {
            return Err(OptionError::new_err("another thread takes episodes from this iterator"));
        };
        let mut scenes = self.scenes.bind(py).clone();
        while ahead.wants_more() {
            let Some(scene) = scenes.next() else { break };
            ahead.give(Item::of(&scene?)?);
        }
        Ok(ahead.take(py)?.map(|result| (result, None)))
    }

    fn next_alone(&self, py: Python<'_>) -> PyResult<Option<Outcome<Done>>> {
        let Some(scene) = self.scenes.bind(py).clone().next() else { return Ok(None) };
        py.check_signals()?;
        let item = Item::of(&scene?)?;
        let result = py.detach(|| caught(|| driven(item, &self.driver, &self.attacker, self.seed)));
        self.driver.raise_interrupt()?;
        Ok(Some((result, None)))
    }

    fn next_of_batch(&self, py: Python<'_>, planner: &Arc<Planner>) -> PyResult<Option<Outcome<Done>>> {
        let Ok(mut done) = self.done.try_lock() else {
            return Err(OptionError::new_err("another thread takes episodes from this iterator"));
        };
        if done.is_empty() {
            let scenes = self.scenes.bind(py).clone().take(self.batch);
            let items = scenes.map(|scene| Item::of(&scene?)).collect::<PyResult<Vec<_>>>()?;
            let drive = |item, questions| {
                let policy = Arc::new(PlannerPolicy(Way::Question(planner.clone(), questions)));
                let driver = Driver { policy, ..self.driver.clone() };
                driven(item, &driver, &self.attacker, self.seed)
            };
            done.extend(drive_together(py, planner, items, drive)?);
        }
        Ok(done.pop_front())
    }
}

/// Drives many scenes: an iterator of `Episode`, in the order of the scenes.
///
/// The arguments are those of `simulate`, and of `generate_many` for `scenes` and `threads`. A planner that has
/// `act_many(observations)` drives `batch` scenes at once: it gets a list of observations, one for each drive that still runs, and
/// returns as many answers; `reset` is called for each drive, and `obs.scene.drive` numbers it. A planner without it drives one
/// scene after the other.
#[pyfunction]
#[pyo3(signature = (scenes, ego=None, attack=None, *, seed=0, threads=None, batch=32))]
pub(crate) fn simulate_many(
    py: Python<'_>,
    scenes: &Bound<'_, PyAny>,
    ego: Option<&Bound<'_, PyAny>>,
    attack: Option<&Bound<'_, PyAny>>,
    seed: u64,
    threads: Option<usize>,
    batch: usize,
) -> PyResult<PyEpisodes> {
    let driver = Driver::of_optional(py, ego, "idm")?;
    let attacker = Attacker::of(attack, seed)?;
    if !(1..=1024).contains(&batch) {
        return Err(OptionError::new_err(format!("batch is {batch}; expected 1 to 1024")));
    }
    let threads = self::threads(threads)?;
    let scenes = scenes.try_iter()?.unbind();
    let ahead = if driver.planner.is_some() {
        None
    } else {
        let (driver, attacker) = (driver.clone(), attacker.clone());
        Some(Mutex::new(Ahead::new(threads, move |item| driven(item, &driver, &attacker, seed))?))
    };
    Ok(PyEpisodes { scenes, driver, attacker, seed, batch, ahead, done: Mutex::default() })
}
