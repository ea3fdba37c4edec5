//! Generators of attacks.

use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use pyo3::{
    prelude::*,
    types::{PyDict, PyType},
};
use sage_bench::{
    Error,
    named_generator::{GeneratorSpec, NamedGenerator},
    operating_point::OperatingPoints,
    part::Part,
    weights::SHIPPED,
};
use sage_core::{
    generator::Attack,
    objective::{Context, ContextOptions, FurtherMeasures},
    scene::SceneData,
};
use sage_sim::{SimScene, attack_test::AttackTest};

use crate::{
    attack::PyAttack,
    errors::{OptionError, detached},
    many,
    parts::{Driver, registries},
    values,
};

/// A generator with all that it needs, at one operating point.
pub(crate) struct Built {
    pub(crate) spec: GeneratorSpec,
    pub(crate) named: NamedGenerator,
    /// What scores measure besides their own fields.
    pub(crate) further: FurtherMeasures,
}

impl Built {
    fn new(spec: GeneratorSpec) -> Result<Self> {
        let registries = registries()?;
        let named = spec.clone().checked(registries)?.build(|_| {})?;
        let objective = Some(named.selection.objective.spec());
        let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, objective)?;
        Ok(Self { spec, named, further })
    }

    /// Attacks a scene. Returns the scene as the generator saw it, with the driver's unattacked drive in place of the ego's
    /// recording, and the attack.
    ///
    /// *Errors*: a scene that cannot be attacked or driven; those of the generator.
    pub(crate) fn attack(
        &self,
        scene: &SceneData,
        driver: &Driver,
        seed: u64,
    ) -> Result<(Arc<SceneData>, Attack)> {
        let (index, mut seen) = (scene.index.clone(), scene.scene.clone());
        seen.check_apart_now()?;
        if !driver.policy.is_recording() {
            let simulated = SimScene::new(seen, index.clone())?;
            seen = AttackTest::new(&*driver.policy, &simulated, seed)?.recorded();
        }
        index.build_all();
        let ctx = Context::new(&seen, &index, &ContextOptions::default())?;
        let attack = self.attack_in(&ctx, seed)?;
        Ok((Arc::new(SceneData { name: scene.name.clone(), scene: seen, index }), attack))
    }

    /// Attacks in a context.
    ///
    /// *Errors*: those of the generator.
    pub(crate) fn attack_in(&self, ctx: &Context, seed: u64) -> Result<Attack> {
        let attack = self.named.built.attack(ctx, 0, seed)?;
        let attack = attack.ok_or_else(|| Error::Value("the generator gave no attack".to_owned()))?;
        attack.check(ctx.scene())?;
        Ok(attack)
    }
}

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
    /// The generator for a seed.
    ///
    /// *Errors*: none that building it the first time did not have.
    pub(crate) fn of_seed(&self, seed: u64) -> Result<Arc<Built>> {
        // The plain mixture draws nothing.
        if seed == self.built.spec.seed || self.built.spec.merger == Part::named("linear") {
            return Ok(self.built.clone());
        }
        let mut other = self.other_seed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(built) = other.as_ref().filter(|built| built.spec.seed == seed) {
            return Ok(built.clone());
        }
        let built = Arc::new(Built::new(GeneratorSpec { seed, ..self.built.spec.clone() })?);
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
        let keywords = PyDict::new(py);
        for (key, text) in [("method", method), ("selection", selection), ("merger", merger)] {
            keywords.set_item(key, text)?;
        }
        for (key, text) in [("weights", weights.as_deref()), ("feasibility", feasibility)] {
            text.map(|text| keywords.set_item(key, text)).transpose()?;
        }
        for (key, number) in [("lambda_", lambda_), ("aggression", aggression), ("mu", mu)] {
            number.map(|number| keywords.set_item(key, number)).transpose()?;
        }
        for (key, dict) in [("mix", &mix), ("options", &options)] {
            dict.as_ref().map(|dict| keywords.set_item(key, dict.copy()?)).transpose()?;
        }
        let mut method = part(method)?;
        method.options.extend(values::options("options", options.as_ref())?);
        let spec = GeneratorSpec {
            method,
            selection: selection.to_owned(),
            feasibility: feasibility.map(part).transpose()?,
            merger: part(merger)?,
            weights,
            points: points(lambda_, aggression, mix.as_ref(), mu, Some(1.0))?,
            seed: 0,
        };
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
        let scene = many::scene_of(scene)?;
        let (generator, data) = (slf.get(), &scene.get().data);
        let (built, seen, attack) = detached(py, || {
            let built = generator.of_seed(seed)?;
            let (seen, attack) = built.attack(data, &driver, seed)?;
            Ok((built, seen, attack))
        })?;
        Ok(PyAttack::new(slf.clone().unbind(), built, scene, seen, attack, seed))
    }

    /// What the generator knows beyond *now*, in words; empty for nothing.
    #[getter]
    fn knows(&self) -> String {
        self.built.named.facts.knows.beyond_now()
    }

    /// What the user should know of weights and dial.
    #[getter]
    fn notes(&self) -> Vec<String> {
        let named = &self.built.named;
        let of_weights = named.weights.iter().filter_map(|weights| weights.note.clone());
        of_weights.chain(named.notes.iter().cloned()).collect()
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

    #[classmethod]
    fn _of_keywords(class: &Bound<'_, PyType>, keywords: &Bound<'_, PyDict>) -> PyResult<Py<PyAny>> {
        Ok(class.call((), Some(keywords))?.unbind())
    }
}

/// A part as a user writes it: a name, perhaps with options in braces.
pub(crate) fn part(text: &str) -> PyResult<Part> {
    text.parse().map_err(OptionError::new_err)
}

/// Operating points of keywords; λ is `default` if none is given.
///
/// *Errors*: keywords that exclude each other, or weights of experts that are no numbers.
pub(crate) fn points(
    lambda: Option<f64>,
    aggression: Option<f64>,
    mix: Option<&Bound<'_, PyDict>>,
    mu: Option<f64>,
    default: Option<f64>,
) -> PyResult<OperatingPoints> {
    let given = [lambda.is_some(), aggression.is_some(), mix.is_some()];
    if given.into_iter().filter(|is| *is).count() > 1 {
        return Err(OptionError::new_err("lambda_, aggression and mix exclude each other; give one of them"));
    }
    if aggression.is_some() && mu.is_some() {
        return Err(OptionError::new_err("aggression sets mu; leave mu out, or give lambda_ and mu"));
    }
    // In the order in which they are given, which decides the name of the point.
    let mix = mix.map(|mix| mix.items().extract::<Vec<(String, f64)>>());
    let mix =
        mix.transpose().map_err(|_| OptionError::new_err("mix is no dictionary of names and weights"))?;
    let lambda = lambda.or(default.filter(|_| aggression.is_none() && mix.is_none()));
    Ok(OperatingPoints {
        aggression: aggression.into_iter().collect(),
        mix: mix.into_iter().collect(),
        lambda: lambda.into_iter().collect(),
        mu,
    })
}
