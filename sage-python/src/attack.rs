//! Attacks: candidates of the adversary, the selected one, and what they are worth.

use std::sync::Arc;

use pyo3::{prelude::*, types::PyList};
use sage_core::{
    generator::{Attack, Extension, Note, Proposal},
    geometry::Point,
    motion::Trajectory,
    objective::{Context, ContextOptions, Scorer, Scores},
    scene::SceneData,
};
use sage_generators::attacked;
use sage_run::Result;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{
    built::Built,
    errors::detached,
    made_once::MadeOnce,
    scene::PyScene,
    values::{self, Reduced},
};

/// A new future of the adversary, with the candidates it was selected from.
#[pyclass(frozen, module = "advsage", name = "Attack", weakref)]
pub(crate) struct PyAttack {
    generator: Py<PyAny>,
    built: Arc<Built>,
    /// The scene that was attacked.
    pub(crate) original: Py<PyScene>,
    /// The scene as the generator saw it.
    seen: Arc<SceneData>,
    pub(crate) attack: Attack,
    seed: u64,
    made: Made,
}

/// Values that are made at their first use.
#[derive(Default)]
struct Made {
    candidates: MadeOnce,
    trajectory: MadeOnce,
    log_probs: MadeOnce,
    goals: MadeOnce,
    scores: MadeOnce,
    candidate_scores: MadeOnce<PyList>,
    scene: MadeOnce<PyScene>,
}

impl PyAttack {
    pub(crate) fn new(
        generator: Py<PyAny>,
        built: Arc<Built>,
        original: Py<PyScene>,
        seen: Arc<SceneData>,
        attack: Attack,
        seed: u64,
    ) -> Self {
        Self { generator, built, original, seen, attack, seed, made: Made::default() }
    }

    fn context(&self) -> Result<Context> {
        Ok(Context::new(&self.seen.scene, &self.seen.index, &ContextOptions::default())?)
    }

    fn scores_of(&self, proposals: &[Proposal]) -> Result<Vec<Scores>> {
        let ctx = self.context()?;
        let scorer = Scorer::with(&ctx, &self.built.named.further);
        Ok(proposals.iter().map(|one| scorer.scores(&ctx.candidate(one.trajectory.clone()))).collect())
    }

    /// How the attack was generated, as the metadata of its scene say.
    fn provenance(&self) -> Value {
        let named = &self.built.named;
        let mut fields = named.generated_by(&named.points[0]).to_map();
        for (key, value) in [
            ("by", json!(concat!("advsage ", env!("CARGO_PKG_VERSION")))),
            ("seed", json!(self.seed)),
            ("weights", json!(named.weights_name())),
        ] {
            fields.insert(key.to_owned(), value);
        }
        Value::Object(fields)
    }
}

#[pymethods]
impl PyAttack {
    /// The adversary's new positions, metres: array (80, 2) for frames 11 to 90, read-only.
    #[getter]
    pub(crate) fn trajectory(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let points = self.attack.trajectory().points();
        let make = || values::shared_array(py, points.as_flattened().to_vec(), &[points.len(), 2]);
        self.made.trajectory.get(py, make)
    }

    /// All candidates, metres: array (candidates, 80, 2), read-only.
    #[getter]
    fn candidates(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let all = &self.attack.candidates;
        let values = || values::flat(all.iter().flat_map(|one| one.trajectory.points()));
        let length = all.first().map_or(0, |one| one.trajectory.points().len());
        let make = || values::shared_array(py, values(), &[all.len(), length, 2]);
        self.made.candidates.get(py, make)
    }

    /// Log-probabilities of the candidates under the generator's model: array (candidates,), NaN without one, read-only.
    #[getter]
    fn log_probs(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let values = self.attack.candidates.iter().map(|one| one.log_prob.unwrap_or(f64::NAN));
        let make = || values::shared_array(py, values.collect(), &[self.attack.candidates.len()]);
        self.made.log_probs.get(py, make)
    }

    /// Goals of the candidates, metres: array (candidates, 2), NaN without one, read-only.
    #[getter]
    fn goals(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let values = self.attack.candidates.iter().flat_map(|one| one.goal.unwrap_or([f64::NAN; 2]));
        let make = || values::shared_array(py, values.collect(), &[self.attack.candidates.len(), 2]);
        self.made.goals.get(py, make)
    }

    /// Number of the selected candidate.
    #[getter]
    fn chosen(&self) -> usize {
        self.attack.chosen
    }

    /// Warning about the selection; None without one.
    #[getter]
    fn note(&self) -> Option<String> {
        self.attack.note.as_ref().map(Note::to_string)
    }

    /// Drives of the driver under test that the generator asked for; 0 for those that ask for none.
    #[getter]
    fn queries(&self) -> u64 {
        self.attack
            .extension
            .as_ref()
            .filter(|one| one.name == "queries")
            .and_then(|one| one.value.as_u64())
            .unwrap_or(0)
    }

    /// Seed of the attack.
    #[getter]
    fn seed(&self) -> u64 {
        self.seed
    }

    /// The generator that made it.
    #[getter]
    fn generator(&self, py: Python<'_>) -> Py<PyAny> {
        self.generator.clone_ref(py)
    }

    /// All measures of the selected candidate, as `sage score --json` prints them: a dictionary.
    #[getter]
    fn scores(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let make = || -> PyResult<Py<PyAny>> {
            let chosen = std::slice::from_ref(&self.attack.candidates[self.attack.chosen]);
            let scores = detached(py, || self.scores_of(chosen))?;
            Ok(values::from_serde(py, &scores[0])?.unbind())
        };
        self.made.scores.get(py, make)
    }

    /// All measures of all candidates, in their order: a list of dictionaries.
    #[getter]
    fn candidate_scores(&self, py: Python<'_>) -> PyResult<Py<PyList>> {
        let make = || -> PyResult<Py<PyList>> {
            let all = detached(py, || self.scores_of(&self.attack.candidates))?;
            let all =
                all.iter().map(|scores| values::from_serde(py, scores)).collect::<PyResult<Vec<_>>>()?;
            Ok(PyList::new(py, all)?.unbind())
        };
        self.made.candidate_scores.get(py, make)
    }

    /// Whether the selected candidate keeps the feasibility rule of the selection.
    #[getter]
    fn feasible(&self, py: Python<'_>) -> PyResult<bool> {
        detached(py, || {
            let ctx = self.context()?;
            let candidate = ctx.candidate(self.attack.trajectory().clone());
            Ok(self.built.named.selection.objective.rule().violations(&candidate, &ctx).is_empty())
        })
    }

    /// The attacked scene: the adversary follows the attack, and an ego that is driven follows its drive before it.
    #[getter]
    pub(crate) fn scene(&self, py: Python<'_>) -> PyResult<Py<PyScene>> {
        let make = || -> PyResult<Py<PyScene>> {
            let original = self.original.get();
            let scene = detached(py, || {
                let scene = attacked(&self.seen.scene, self.attack.trajectory())?;
                Ok(original.derived(scene, self.provenance().to_string()))
            })?;
            Py::new(py, scene)
        };
        self.made.scene.get(py, make)
    }

    /// The scene that was attacked.
    #[getter]
    fn original(&self, py: Python<'_>) -> Py<PyScene> {
        self.original.clone_ref(py)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let scores = self.scores(py)?.into_bound(py);
        let after = scores.get_item("collision_step")?.extract::<Option<usize>>()?;
        let contact = after
            .map_or("no contact".to_owned(), |step| format!("contact after {:.1} s", step as f64 / 10.0));
        let feasible = if self.feasible(py)? { "feasible" } else { "not feasible" };
        Ok(format!(
            "<Attack on '{}', {}: {contact}, {feasible}, candidate {} of {}>",
            self.seen.name,
            self.built.named.variants.first().map_or("", |variant| variant),
            self.attack.chosen,
            self.attack.candidates.len()
        ))
    }

    /// Attacks do not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    #[expect(clippy::type_complexity, reason = "the arguments of `Generator._attack`")]
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<Reduced<'py, (Py<PyScene>, Option<PyScene>, String, u64)>> {
        let original = self.original.get();
        // The scene that the generator saw is another one if a driver drove it.
        let is_same = Arc::ptr_eq(&self.seen.scene, &original.data.scene);
        let seen =
            (!is_same).then(|| original.derived((*self.seen.scene).clone(), self.provenance().to_string()));
        let state = detached(py, || Ok(serde_json::to_string(&State::of(&self.attack))?))?;
        // The generator makes it anew.
        let rebuild = self.generator.bind(py).getattr("_attack")?;
        Ok((rebuild, (self.original.clone_ref(py), seen, state, self.seed)))
    }
}

/// An attack as it is pickled.
#[derive(Serialize, Deserialize)]
struct State {
    candidates: Vec<CandidateState>,
    chosen: usize,
    note: Option<Note>,
    extension: Option<(String, Value)>,
}

/// Trajectory, log-probability, goal and negative log-likelihood of a candidate.
#[derive(Serialize, Deserialize)]
struct CandidateState(Trajectory, Option<f64>, Option<Point>, Option<f64>);

impl State {
    fn of(attack: &Attack) -> Self {
        let state = |one: &Proposal| CandidateState(one.trajectory.clone(), one.log_prob, one.goal, one.nll);
        let candidates = attack.candidates.iter().map(state).collect();
        let extension = attack.extension.clone().map(|Extension { name, value }| (name, value));
        Self { candidates, chosen: attack.chosen, note: attack.note.clone(), extension }
    }
}

/// The attack of a pickled state on a scene.
///
/// *Errors*: a state that is damaged.
pub(crate) fn of_state(scene: &SceneData, state: &str) -> Result<Attack> {
    let state: State = serde_json::from_str(state)
        .map_err(|_| advsage::Error::Value("the pickled attack is damaged".to_owned()))?;
    let candidates = state.candidates.into_iter();
    let candidates = candidates
        .map(|CandidateState(trajectory, log_prob, goal, nll)| Proposal { trajectory, log_prob, goal, nll })
        .collect();
    let extension = state.extension.map(|(name, value)| Extension { name, value });
    let attack = Attack { extension, ..Attack::of(candidates, state.chosen, state.note) };
    attack.check(&scene.scene)?;
    Ok(attack)
}
