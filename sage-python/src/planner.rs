//! A planner of Python in the ego's seat. It is called on the thread that drives, which is the caller's.

use std::{
    cell::Cell,
    sync::{Arc, OnceLock},
};

use pyo3::{
    exceptions::PyException,
    intern,
    prelude::*,
    types::{PyBool, PyDict, PyFloat, PyList, PyString, PyTuple, PyType},
};
use sage_sim::{
    observation::LaterObservation,
    policy::planner::{Answer, ToldScene, ToldStep},
    vehicle::{Action, Vehicle},
};
use serde_json::{Map, Value};

use crate::{
    errors::{OptionError, UnknownName, keep_raised, take_raised},
    observation::{PyStep, PyToldScene},
    values,
};

thread_local! {
    /// Planners of this thread that wait for a drive which their own `act` began.
    static DEPTH: Cell<usize> = const { Cell::new(0) };
}

/// Most drives within each other: each takes stack that Python does not count.
const DEEPEST: usize = 32;

/// One more planner that is asked.
struct Depth;

impl Depth {
    /// *Errors*: too many within each other.
    fn deeper() -> Result<Self, String> {
        let depth = DEPTH.get() + 1;
        if depth > DEEPEST {
            return Err(format!("its `act` drives, whose planner drives, and so on, {DEEPEST} times"));
        }
        DEPTH.set(depth);
        Ok(Self)
    }
}

impl Drop for Depth {
    fn drop(&mut self) {
        DEPTH.set(DEPTH.get() - 1);
    }
}

/// A planner: an object with a method `act`.
pub(crate) struct Planner {
    object: Py<PyAny>,
    /// Its name in results.
    pub(crate) name: String,
    /// Whether it takes the observation of one drive, and those of several drives at once.
    takes_one: bool,
    pub(crate) takes_many: bool,
    /// Whether it wants to know where its recording ends.
    pub(crate) wants_goal: bool,
    /// The ways of following its plans that it offers, the default first.
    pub(crate) follows: Vec<String>,
    /// What it raised that is no `Exception`, such as Ctrl-C or `SystemExit`: no drive asks the planner again.
    stopped_by: OnceLock<PyErr>,
}

impl Planner {
    /// The planner of an object.
    ///
    /// *Errors*: it has no method `act`.
    pub(crate) fn new(object: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = object.py();
        let name = object.getattr_opt(intern!(py, "name"))?;
        let name = match name.filter(|name| name.is_instance_of::<PyString>()) {
            Some(name) => name.extract()?,
            None => match object.cast::<PyType>() {
                Ok(class) => class.name()?.to_string(),
                Err(_) => object.get_type().name()?.to_string(),
            },
        };
        let has = |name: &Bound<'_, PyString>| -> PyResult<bool> {
            Ok(object.getattr_opt(name)?.is_some_and(|act| act.is_callable()))
        };
        let (takes_one, takes_many) = (has(intern!(py, "act"))?, has(intern!(py, "act_many"))?);
        let problem = if object.is_instance_of::<PyType>() {
            Some(format!("the class {name}; give an instance: {name}()"))
        } else if !takes_one && !takes_many {
            Some(format!("{}, which has no method `act`", object.repr()?))
        } else {
            None
        };
        if let Some(problem) = problem {
            return Err(OptionError::new_err(format!(
                "ego is {problem}; expected the name of a driver such as 'idm', 'py:package.module:Class', or an object with `act(obs)`"
            )));
        }
        let wants_goal =
            object.getattr_opt(intern!(py, "wants_goal"))?.is_some_and(|goal| goal.is(PyBool::new(py, true)));
        let follows = match object.getattr_opt(intern!(py, "follows"))? {
            Some(follows) => follows.extract().map_err(|_| {
                OptionError::new_err(format!("`follows` of {name} is {follows}; expected a list of names"))
            })?,
            None => Vec::new(),
        };
        let object = object.clone().unbind();
        let stopped_by = OnceLock::new();
        Ok(Self { object, name, takes_one, takes_many, wants_goal, follows, stopped_by })
    }

    /// Whether something stopped it, such as Ctrl-C.
    pub(crate) fn is_stopped(&self) -> bool {
        self.stopped_by.get().is_some()
    }

    /// What tells its object from others.
    pub(crate) fn address(&self) -> usize {
        self.object.as_ptr() as usize
    }

    /// Raises what stopped the planner, if something did.
    ///
    /// *Errors*: that, such as Ctrl-C.
    pub(crate) fn raise_interrupt(&self) -> PyResult<()> {
        let Some(raised) = self.stopped_by.get() else { return Ok(()) };
        drop(take_raised());
        Err(Python::attach(|py| raised.clone_ref(py)))
    }

    /// Tells it the scene of a drive. Returns the scene as the planner got it.
    ///
    /// *Errors*: what it raised, in words.
    pub(crate) fn reset(
        &self,
        py: Python<'_>,
        told: &Arc<ToldScene>,
        drive: usize,
    ) -> Result<Py<PyAny>, String> {
        let reset = || -> PyResult<Py<PyAny>> {
            let class = py.import(intern!(py, "advsage.planner"))?.getattr(intern!(py, "Scene"))?;
            let scene = class.call1((PyToldScene::new(told.clone()), drive))?;
            if let Some(reset) = self.object.bind(py).getattr_opt(intern!(py, "reset"))? {
                reset.call1((&scene, told.seed()))?;
            }
            Ok(scene.unbind())
        };
        self.caught(py, reset())
    }

    /// Asks it about one drive.
    ///
    /// *Errors*: what it raised, or what is wrong with its answer, in words.
    pub(crate) fn act(&self, py: Python<'_>, scene: &Py<PyAny>, asked: Asked) -> Result<Answer, String> {
        if !self.takes_one {
            let mut answers = self.act_many(py, vec![(scene.clone_ref(py), asked)]);
            return answers.pop().unwrap_or_else(|| Err("it gave no answer".to_owned()));
        }
        keep_raised(None);
        let depth = Depth::deeper()?;
        let car = asked.car;
        let act = || self.object.call_method1(py, intern!(py, "act"), (observation(py, scene, asked)?,));
        let answered = self.caught(py, act())?;
        drop(depth);
        answer_of(answered.bind(py), &car)
    }

    /// Asks it about several drives at once.
    ///
    /// *Errors*: of all drives what it raised, of one what is wrong with its answer, in words.
    pub(crate) fn act_many(
        &self,
        py: Python<'_>,
        all: Vec<(Py<PyAny>, Asked)>,
    ) -> Vec<Result<Answer, String>> {
        keep_raised(None);
        let cars: Vec<Vehicle> = all.iter().map(|(_, asked)| asked.car).collect();
        let act = || -> PyResult<Vec<Bound<'_, PyAny>>> {
            let seen = all.into_iter().map(|(scene, asked)| observation(py, &scene, asked));
            let seen = PyList::new(py, seen.collect::<PyResult<Vec<_>>>()?)?;
            let answers = self.object.bind(py).call_method1(intern!(py, "act_many"), (seen,))?;
            answers.try_iter()?.collect()
        };
        match self.caught(py, act()) {
            Ok(answers) if answers.len() == cars.len() => {
                answers.iter().zip(&cars).map(|(answer, car)| answer_of(answer, car)).collect()
            }
            Ok(answers) => {
                let problem =
                    format!("`act_many` returned {} answers for {} drives", answers.len(), cars.len());
                vec![Err(problem); cars.len()]
            }
            Err(problem) => vec![Err(problem); cars.len()],
        }
    }

    /// Keeps what was raised, with its class and text as the message.
    fn caught<T>(&self, py: Python<'_>, outcome: PyResult<T>) -> Result<T, String> {
        outcome.map_err(|raised| {
            let class = raised.get_type(py).name().map_or("an exception".to_owned(), |name| name.to_string());
            let text = format!("{class}: {}", raised.value(py));
            if !raised.is_instance_of::<PyException>(py) {
                let _ = self.stopped_by.set(raised.clone_ref(py));
            }
            keep_raised(Some(raised));
            text
        })
    }
}

/// What a planner is asked at a step.
pub(crate) struct Asked {
    /// The scene of the drive.
    pub(crate) told: Arc<ToldScene>,
    /// The last frames, the present one last, with whether it was asked then.
    pub(crate) frames: Vec<(Arc<ToldStep>, bool)>,
    pub(crate) observation: Option<LaterObservation>,
    pub(crate) car: Vehicle,
}

fn observation<'py>(py: Python<'py>, scene: &Py<PyAny>, asked: Asked) -> PyResult<Bound<'py, PyAny>> {
    let class = py.import(intern!(py, "advsage.planner"))?.getattr(intern!(py, "Observation"))?;
    class.call1((PyStep::new(asked.told, asked.frames, asked.observation), scene))
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
    let is_rows = returned.is_instance_of::<PyDict>()
        || returned.is_instance_of::<PyList>()
        || returned.is_instance_of::<PyTuple>()
        || returned.hasattr(intern!(returned.py(), "tolist")).unwrap_or(false);
    if !is_rows {
        return Err(format!(
            "`act` returned {}; expected (steer, throttle), rows of a plan, or a dict",
            shown()
        ));
    }
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
        return Err(OptionError::new_err(format!("ego is `py:{name}`; expected `py:package.module:Class`")));
    };
    let found = py.import(module)?;
    let Some(class) = found.getattr_opt(class)? else {
        return Err(UnknownName::new_err(format!(
            "ego is `py:{name}`, and the module `{module}` has no `{class}`"
        )));
    };
    class.call0()
}
