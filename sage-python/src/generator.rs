//! Generators of attacks.

use std::sync::{Arc, Mutex, PoisonError};

use advsage::{named_generator::GeneratorSpec, part::Part, weights::SHIPPED};
use pyo3::{
    prelude::*,
    types::{PyDict, PyType},
};

use sage_run::Result;
use serde_json::{Map, Value, json};

use crate::{
    attack::{self, PyAttack},
    built::Built,
    errors::{OptionError, detached},
    items,
    parts::Driver,
    scene::PyScene,
    values,
};

/// Generates attacks, new futures of the adversary: `generator(scene, *, ego=None, seed=0)` returns an `Attack`.
///
/// `scene` is a `Scene` or the path of a scene file. `ego` drives before the attack, which is planned against that drive: the name of a
/// driver ("replay", the recording, by default), or your planner.
///
/// - `lambda_`: from the realistic expert, 0, to the adversarial one, 1 (default). Instead `aggression`, 0 to 1, with an even effect, or
///   `mix`, weights of experts by name ("realistic", "adversarial", "lawful").
/// - `mu`: weight of attack against realism in the selection, 0 to 1; by default λ.
/// - `method`: the generator ("sage"), `options`: its options. `merger`: how experts are merged ("linear").
/// - `selection`: the objective that selects one of the candidates ("natural"), or a JSON file. `feasibility`: another rule for it.
/// - `weights`: "procedural" (default), "waymo" (`SAGE_WEIGHTS` names their folder), or a folder.
///
/// `advsage.names()` lists what there is.
#[pyclass(frozen, module = "advsage", name = "Generator", weakref)]
pub(crate) struct PyGenerator {
    /// The keywords that it was made from.
    keywords: Py<PyDict>,
    built: Arc<Built>,
    /// The same for the last other seed: a merger may draw random numbers.
    other_seed: Mutex<Option<Arc<Built>>>,
}

impl PyGenerator {
    /// The generator.
    pub(crate) fn built(&self) -> Arc<Built> {
        self.built.clone()
    }

    /// The generator for a seed.
    ///
    /// *Errors*: none that building it the first time did not have.
    pub(crate) fn of_seed(&self, seed: u64) -> Result<Arc<Built>> {
        // The plain mixture draws nothing.
        if seed == self.built.named.spec.seed || self.built.named.spec.merger == Part::named("linear") {
            return Ok(self.built.clone());
        }
        let mut other = self.other_seed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(built) = other.as_ref().filter(|built| built.named.spec.seed == seed) {
            return Ok(built.clone());
        }
        let built = Arc::new(Built::new(GeneratorSpec { seed, ..self.built.named.spec.clone() })?);
        Ok(other.insert(built).clone())
    }
}

#[pymethods]
impl PyGenerator {
    #[new]
    #[pyo3(signature = (*, method="sage", weights=None, lambda_=None, aggression=None, mix=None, mu=None, selection="natural",
        feasibility=None, merger="linear", options=None))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        py: Python<'_>,
        method: &str,
        weights: Option<String>,
        lambda_: Option<f64>,
        aggression: Option<f64>,
        mix: Option<Bound<'_, PyDict>>,
        mu: Option<f64>,
        selection: &str,
        feasibility: Option<&str>,
        merger: &str,
        options: Option<Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        // Another process may work in another folder.
        let weights = weights.map(|name| match std::fs::canonicalize(&name) {
            Ok(path) if !SHIPPED.contains(&&*name) => path.display().to_string(),
            _ => name,
        });
        let keywords = keywords(
            py,
            [
                ("method", Some(method)),
                ("selection", Some(selection)),
                ("merger", Some(merger)),
                ("weights", weights.as_deref()),
                ("feasibility", feasibility),
            ],
            [("lambda_", lambda_), ("aggression", aggression), ("mu", mu)],
            [("mix", &mix), ("options", &options)],
        )?;
        let spec = spec(&keywords)?;
        let built = detached(py, || Built::new(spec))?;
        Ok(Self { keywords: keywords.unbind(), built: Arc::new(built), other_seed: Mutex::new(None) })
    }

    /// Attacks a scene. `ego` drives before the attack, which is planned against that drive: the name of a driver, or your
    /// planner. Returns an `Attack`.
    #[pyo3(signature = (scene, *, ego=None, seed=0))]
    fn __call__(
        slf: &Bound<'_, Self>,
        scene: &Bound<'_, PyAny>,
        ego: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = crate::seed::seed)] seed: u64,
    ) -> PyResult<PyAttack> {
        let py = slf.py();
        let driver = Driver::of_optional(py, ego, "replay")?;
        let scene = items::scene_of(scene)?;
        let (generator, data) = (slf.get(), &scene.get().data);
        let (built, seen, attack) = detached(py, || {
            let built = generator.of_seed(seed)?;
            let (seen, attack) = built.attack(data, &driver, seed)?;
            Ok((built, seen, attack))
        })?;
        Ok(PyAttack::new(slf.clone().into_any().unbind(), built, scene, seen, attack, seed))
    }

    /// What the generator knows beyond *now*, in words; empty for nothing.
    #[getter]
    fn knows(&self) -> String {
        self.built.named.built.facts.knows.beyond_now()
    }

    /// What the user should know of weights and dial.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.built.named.notes.clone()
    }

    /// Name of the operating point, as in names of files: "lambda1.00".
    #[getter]
    fn variant(&self) -> &str {
        self.built.named.variants.first().map_or("", |variant| variant)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let given = self.keywords.bind(py).copy()?;
        if let Some(weights) = &self.built.named.weights {
            given.set_item("weights", &weights.name)?;
        }
        let given = given.iter();
        let given: Vec<String> =
            given.map(|(key, value)| Ok(format!("{key}={}", value.repr()?))).collect::<PyResult<Vec<_>>>()?;
        Ok(format!("Generator({})", given.join(", ")))
    }

    /// Generators do not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Py<PyDict>,))> {
        // A copy at all levels: whoever gets it may change it.
        let keywords = py.import("copy")?.call_method1("deepcopy", (&self.keywords,))?;
        Ok((py.get_type::<Self>().getattr("_of_keywords")?, (keywords.cast_into::<PyDict>()?.unbind(),)))
    }

    /// An attack of this generator from its pickled state.
    #[pyo3(signature = (original, seen, state, seed))]
    fn _attack(
        slf: &Bound<'_, Self>,
        original: Py<PyScene>,
        seen: Option<Py<PyScene>>,
        state: &str,
        seed: u64,
    ) -> PyResult<PyAttack> {
        let (py, generator) = (slf.py(), slf.get());
        let seen = seen.map_or_else(|| original.get().data.clone(), |seen| seen.get().data.clone());
        let (built, attack) =
            detached(py, || Ok((generator.of_seed(seed)?, attack::of_state(&seen, state)?)))?;
        Ok(PyAttack::new(slf.clone().into_any().unbind(), built, original, seen, attack, seed))
    }

    #[classmethod]
    fn _of_keywords(class: &Bound<'_, PyType>, keywords: &Bound<'_, PyDict>) -> PyResult<Py<PyAny>> {
        Ok(class.call((), Some(keywords))?.unbind())
    }
}

/// A part as a user writes it: a name, perhaps with options in braces.
pub(crate) fn part(text: &str) -> PyResult<Part> {
    text.parse().map_err(OptionError::new_err)
}

/// The keywords of a generator that are given.
///
/// *Errors*: none but those of Python.
pub(crate) fn keywords<'py>(
    py: Python<'py>,
    texts: [(&str, Option<&str>); 5],
    numbers: [(&str, Option<f64>); 3],
    dicts: [(&str, &Option<Bound<'py, PyDict>>); 2],
) -> PyResult<Bound<'py, PyDict>> {
    let keywords = PyDict::new(py);
    for (key, text) in texts {
        text.map(|text| keywords.set_item(key, text)).transpose()?;
    }
    for (key, number) in numbers {
        number.map(|number| keywords.set_item(key, number)).transpose()?;
    }
    for (key, dict) in dicts {
        dict.as_ref().map(|dict| keywords.set_item(key, dict.copy()?)).transpose()?;
    }
    Ok(keywords)
}

/// What keywords say of a generator: those of `Generator`.
///
/// *Errors*: a wrong value; keywords that exclude each other.
pub(crate) fn spec(keywords: &Bound<'_, PyDict>) -> PyResult<GeneratorSpec> {
    let mut fields = Map::new();
    for (key, value) in keywords {
        let key: String = key.extract()?;
        let value = match &*key {
            // In the order in which they are given, which decides the name of the point.
            "mix" => {
                let pairs = value.cast::<PyDict>().map(|mix| mix.items().extract::<Vec<(String, f64)>>());
                let pairs = pairs.ok().and_then(Result::ok);
                let wrong = || OptionError::new_err("mix is no dictionary of names and weights");
                json!([pairs.ok_or_else(wrong)?])
            }
            _ => values::to_json(&key, &value, 0)?,
        };
        fields.insert(key.trim_end_matches('_').to_owned(), value);
    }
    let spec: GeneratorSpec = serde_json::from_value(Value::Object(fields))
        .map_err(|error| OptionError::new_err(error.to_string()))?;
    spec.points.check().map_err(OptionError::new_err)?;
    Ok(spec)
}
