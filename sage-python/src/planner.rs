//! A planner of Python in the ego's seat. It is called on the thread that drives, which is the caller's.

use std::{
    cell::RefCell,
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use pyo3::{
    exceptions::PyException,
    intern,
    prelude::*,
    types::{PyFloat, PyTuple},
};
use sage_sim::{
    Error,
    policy::{
        Driver, EgoPolicy, Shown, Start, View,
        planner::{AGENTS, Answer, Follower, RADIUS, ToldScene, ToldStep},
    },
    vehicle::{Action, Vehicle},
    world::Control,
};
use serde_json::{Map, Value};

use crate::{
    observation::{HISTORY, PyStep, PyToldScene},
    values,
};

thread_local! {
    /// What a planner raised last on this thread.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// Takes what a planner raised last on this thread.
pub(crate) fn take_raised() -> Option<PyErr> {
    RAISED.take()
}

/// The policy of a planner.
pub(crate) struct PythonPlanner {
    shared: Arc<Shared>,
}

struct Shared {
    planner: Py<PyAny>,
    name: String,
    /// Set by what is no `Exception`, such as Ctrl-C: no drive calls the planner again.
    is_stopped: AtomicBool,
}

impl PythonPlanner {
    /// The policy of an object with a method `act`.
    ///
    /// *Errors*: it has none.
    pub(crate) fn new(planner: &Bound<'_, PyAny>) -> PyResult<Self> {
        let name = planner.getattr_opt(intern!(planner.py(), "name"))?;
        let name = name.filter(|name| name.is_instance_of::<pyo3::types::PyString>());
        let name = match name {
            Some(name) => name.extract()?,
            None => planner.get_type().name()?.to_string(),
        };
        let is_stopped = AtomicBool::new(false);
        Ok(Self { shared: Arc::new(Shared { planner: planner.clone().unbind(), name, is_stopped }) })
    }

    /// Its name in results.
    pub(crate) fn name(&self) -> &str {
        &self.shared.name
    }
}

impl EgoPolicy for PythonPlanner {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(PythonDriver {
            shared: self.shared.clone(),
            seed: start.seed(),
            scene: None,
            follower: Follower::default(),
            steps: VecDeque::with_capacity(HISTORY),
            shown: None,
        }))
    }
}

/// A drive of a planner.
struct PythonDriver {
    shared: Arc<Shared>,
    seed: u64,
    /// What the planner was told of the scene, as `reset` got it.
    scene: Option<(Arc<ToldScene>, Py<PyAny>)>,
    follower: Follower,
    /// The last steps at which it was asked.
    steps: VecDeque<Arc<ToldStep>>,
    shown: Option<Shown>,
}

impl Driver for PythonDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        if let Some(action) = self.follower.kept(view) {
            return Ok(Control::Drive(action));
        }
        let answer = if self.shared.is_stopped.load(Ordering::Relaxed) {
            Err("it was interrupted".to_owned())
        } else {
            Python::attach(|py| self.answer(py, view))
        };
        let answer = answer.map_err(|problem| Error::Planner {
            scene: self.scene.as_ref().map_or(String::new(), |(told, _)| told.id().to_owned()),
            step: Some(view.step()),
            problem: format!("the planner `{}` failed: {problem}", self.shared.name),
            log: sage_sim::PlannerLog::default(),
            drive: None,
        })?;
        let (action, plan) = self.follower.follow(view, answer);
        self.shown = (!plan.is_empty()).then(|| Shown { step: view.step(), plan, log: String::new() });
        Ok(Control::Drive(action))
    }

    fn shown(&mut self) -> Option<Shown> {
        self.shown.take()
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Err(Error::Clone {
            problem: format!(
                "the planner `{}` is an object of Python, whose state is not copied",
                self.shared.name
            ),
        })
    }
}

impl PythonDriver {
    /// What the planner answers to a step.
    fn answer(&mut self, py: Python<'_>, view: &View) -> Result<Answer, String> {
        if self.scene.is_none() {
            let told = Arc::new(ToldScene::new(view, self.seed, RADIUS));
            let scene = self.caught(py, reset(py, &self.shared.planner, &told))?;
            self.scene = Some((told, scene));
        }
        let (told, scene) = self.scene.as_ref().ok_or("it was not told the scene")?;
        let step = Arc::new(ToldStep::new(view, AGENTS));
        if self.steps.len() == HISTORY {
            self.steps.pop_front();
        }
        self.steps.push_back(step);
        let later = view.later_observation();
        let step = PyStep::new(told.clone(), self.steps.iter().cloned().collect(), later);
        let answered = act(py, &self.shared.planner, scene, step);
        let answered = self.caught(py, answered)?;
        answer_of(answered.bind(py), view.car())
    }

    /// Keeps what was raised, with its class and text as the message.
    fn caught<T>(&self, py: Python<'_>, outcome: PyResult<T>) -> Result<T, String> {
        outcome.map_err(|raised| {
            let class = raised.get_type(py).name().map_or("an exception".to_owned(), |name| name.to_string());
            let text = format!("{class}: {}", raised.value(py));
            if !raised.is_instance_of::<PyException>(py) {
                self.shared.is_stopped.store(true, Ordering::Relaxed);
            }
            RAISED.set(Some(raised));
            text
        })
    }
}

/// Tells a planner the scene. Returns it as the planner got it.
fn reset(py: Python<'_>, planner: &Py<PyAny>, told: &Arc<ToldScene>) -> PyResult<Py<PyAny>> {
    let class = py.import(intern!(py, "advsage.planner"))?.getattr(intern!(py, "Scene"))?;
    let scene = class.call1((PyToldScene::new(told.clone()),))?;
    if let Some(reset) = planner.bind(py).getattr_opt(intern!(py, "reset"))? {
        reset.call1((&scene, told.seed()))?;
    }
    Ok(scene.unbind())
}

/// Asks a planner.
fn act(py: Python<'_>, planner: &Py<PyAny>, scene: &Py<PyAny>, step: PyStep) -> PyResult<Py<PyAny>> {
    let class = py.import(intern!(py, "advsage.planner"))?.getattr(intern!(py, "Observation"))?;
    let observation = class.call1((step, scene))?;
    planner.call_method1(py, intern!(py, "act"), (observation,))
}

/// What a planner returned, as an answer to the driver of a car.
///
/// *Errors*: what is wrong with it, in words.
fn answer_of(returned: &Bound<'_, PyAny>, car: &Vehicle) -> Result<Answer, String> {
    // Two numbers, the commonest answer, need no detour.
    if let Ok(pair) = returned.cast::<PyTuple>()
        && pair.len() == 2
        && let (Ok(steer), Ok(throttle)) = (pair.get_item(0), pair.get_item(1))
        && let (Ok(steer), Ok(throttle)) = (steer.cast::<PyFloat>(), throttle.cast::<PyFloat>())
    {
        let action = Action { steer: steer.value(), throttle: throttle.value() };
        return match [action.steer, action.throttle].into_iter().find(|x| !x.is_finite()) {
            Some(number) => Err(format!("`act` returned {number}; expected finite numbers")),
            None => Ok(Answer::Control(action.limited())),
        };
    }
    let shown = || {
        let text = returned.repr().map_or("something".to_owned(), |text| text.to_string());
        text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(120).collect::<String>()
    };
    let value = values::to_json("what `act` returned", returned, 0)
        .map_err(|error| Python::attach(|py| error.value(py).to_string()))?;
    let object = match value {
        Value::Object(object) => object,
        Value::Array(rows) if rows.first().is_some_and(Value::is_array) => {
            Map::from_iter([("plan".to_owned(), Value::Array(rows))])
        }
        Value::Array(numbers) if numbers.len() == 2 => {
            let names = ["steer", "throttle"].map(str::to_owned);
            names.into_iter().zip(numbers).collect()
        }
        _ => {
            return Err(format!(
                "`act` returned {}; expected (steer, throttle), rows of a plan, or a dict",
                shown()
            ));
        }
    };
    Answer::of_object(&object, car, &shown())
}

/// A planner by the name of its class: `py:package.module:Class`, called without arguments.
pub(crate) fn imported<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    let Some((module, class)) = name.rsplit_once(':') else {
        return Err(crate::errors::OptionError::new_err(format!(
            "ego is `py:{name}`; expected `py:package.module:Class`"
        )));
    };
    py.import(module)?.getattr(class)?.call0()
}
