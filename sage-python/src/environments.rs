//! Environments of reinforcement learning that step together, behind `advsage.gym`.
//!
//! Gymnasium stays outside the binary module: here are rows and arrays, in Python the classes that Gymnasium and
//! Stable-Baselines3 want, the configuration with the keys of MetaDrive, and the pictures (Pillow).

mod adversaries;
mod picture;
mod rows;
mod scenes;

use std::{
    mem,
    sync::{Arc, Mutex, MutexGuard},
};

use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::{
    prelude::*,
    types::{PyDict, PyIterator, PyString},
};
use rayon::ThreadPool;
use sage_run::{Result, outcome::caught};
use sage_sim::{
    batch::{AutoReset, Batch, BatchOptions, BatchOutput, Reset, SceneOrder, Setting},
    environment::EnvironmentOptions,
    observation::LENGTH,
    traffic::TrafficMode,
};

use self::{
    rows::{Infos, info},
    scenes::ListedScenes,
};
use crate::{
    ahead::pool,
    errors::{OptionError, UnknownName, detached},
    values,
};

/// Environments that step together. All methods are those of `advsage.gym`, without its checks.
#[pyclass(frozen, module = "advsage._advsage", name = "Environments")]
pub(crate) struct PyEnvironments {
    scenes: Arc<ListedScenes>,
    inner: Mutex<Inner>,
}

struct Inner {
    batch: Batch,
    threads: Threads,
}

/// Observations, rewards, terminations, truncations and infos.
type Stepped<'py> = (
    Bound<'py, PyArrayDyn<f32>>,
    Bound<'py, PyArrayDyn<f64>>,
    Bound<'py, PyArrayDyn<bool>>,
    Bound<'py, PyArrayDyn<bool>>,
    Bound<'py, PyDict>,
);

/// The same of one environment.
type SteppedOne<'py> = (Bound<'py, PyArrayDyn<f32>>, f64, bool, bool, Bound<'py, PyDict>);

/// Threads of a batch. They are kept from step to step, but not over a fork.
struct Threads {
    count: usize,
    /// The process that started them.
    pool: Option<(u32, ThreadPool)>,
}

impl Threads {
    /// Works in the threads; in the caller's if there is one.
    ///
    /// *Errors*: those of the work, and that the system starts no threads.
    fn work<T: Send>(&mut self, py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
        if self.count == 1 {
            return detached(py, work);
        }
        let process = std::process::id();
        if !matches!(&self.pool, Some((owner, _)) if *owner == process) {
            // The threads of a pool are not in a forked child, where its locks may be held by them for ever.
            mem::forget(self.pool.replace((process, pool(self.count)?)));
        }
        match &self.pool {
            Some((_, pool)) => detached(py, || pool.install(|| caught(work))),
            None => detached(py, work),
        }
    }
}

#[pymethods]
impl PyEnvironments {
    #[new]
    #[pyo3(signature = (scenes, rules, *, count, auto_reset, sequence, adversary, share, threads, in_memory, first))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        py: Python<'_>,
        scenes: &Bound<'_, PyIterator>,
        rules: &Bound<'_, PyDict>,
        count: usize,
        auto_reset: &str,
        sequence: Option<(usize, usize)>,
        adversary: Option<&Bound<'_, PyDict>>,
        share: bool,
        threads: usize,
        in_memory: usize,
        first: usize,
    ) -> PyResult<Self> {
        let scenes = Arc::new(ListedScenes::new(
            scenes,
            in_memory,
            sequence.map_or(1, |(_, workers)| workers),
            first,
        )?);
        let rules = self::rules(rules)?;
        let adversary = adversary.map(adversaries::of).transpose()?;
        let auto_reset = match auto_reset {
            "same_step" => AutoReset::SameStep,
            "next_step" => AutoReset::NextStep,
            _ => AutoReset::Off,
        };
        let options = BatchOptions { count, auto_reset, share_experience: share, parallel: threads > 1 };
        let batch = detached(py, || {
            let order = sequence
                .map_or(SceneOrder::Random, |(first, workers)| SceneOrder::Sequential { first, workers });
            let adversary = adversary.map(adversaries::Described::build).transpose()?;
            Ok(Batch::new(Setting { scenes: scenes.clone(), order, rules, adversary }, options)?)
        })?;
        let threads = Threads { count: threads, pool: None };
        Ok(Self { scenes, inner: Mutex::new(Inner { batch, threads }) })
    }

    /// Names of the scenes, in their order.
    fn scene_names(&self) -> Vec<String> {
        self.scenes.names()
    }

    /// Resets environments: number, seed or None, and number of a scene or None for each. Returns observations and infos of all.
    fn reset<'py>(
        &self,
        py: Python<'py>,
        resets: Vec<(usize, Option<u64>, Option<usize>)>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyDict>)> {
        let (out, n) = self.reset_rows(py, resets)?;
        let infos = self.infos(&out).columns(py)?;
        Ok((values::array(py, out.observations, &[n, LENGTH])?, infos))
    }

    /// Resets the only environment.
    fn reset_one<'py>(
        &self,
        py: Python<'py>,
        seed: Option<u64>,
        scene: Option<usize>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyDict>)> {
        let (out, _) = self.reset_rows(py, vec![(0, seed, scene)])?;
        let info = info(py, &out.rows[0], self.scenes.counts(), None)?;
        Ok((values::array(py, out.observations, &[LENGTH])?, info))
    }

    /// Steps all environments: actions (n, 2).
    fn step<'py>(&self, py: Python<'py>, actions: PyReadonlyArrayDyn<'py, f32>) -> PyResult<Stepped<'py>> {
        let (out, n) = self.step_rows(py, &actions, None)?;
        self.stepped(py, out, &[n])
    }

    /// Steps each environment several times: actions (n, steps, 2). Results are (n, steps, ...).
    fn roll_out<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArrayDyn<'py, f32>,
    ) -> PyResult<Stepped<'py>> {
        let steps = actions.shape()[1];
        let (out, n) = self.step_rows(py, &actions, Some(steps))?;
        self.stepped(py, out, &[n, steps])
    }

    /// Steps the only environment: an action (2,).
    fn step_one<'py>(
        &self,
        py: Python<'py>,
        action: PyReadonlyArrayDyn<'py, f32>,
    ) -> PyResult<SteppedOne<'py>> {
        let (out, _) = self.step_rows(py, &action, None)?;
        let row = &out.rows[0];
        let info = info(py, row, self.scenes.counts(), Some((row.episode_return, row.steps)))?;
        let observation = values::array(py, out.observations, &[LENGTH])?;
        Ok((observation, out.rewards[0], out.terminated[0], out.truncated[0], info))
    }

    /// What was noted since the last call: name of the scene, and the problem.
    fn take_notes(&self) -> PyResult<Vec<(String, String)>> {
        let names = |scene: usize| self.scenes.name(scene);
        Ok(self
            .lock()?
            .batch
            .take_notes()
            .into_iter()
            .map(|note| (names(note.scene), note.problem))
            .collect())
    }

    /// What a picture of an environment shows; None before its first reset.
    fn picture<'py>(&self, py: Python<'py>, number: usize) -> PyResult<Option<Bound<'py, PyDict>>> {
        let inner = self.lock()?;
        inner.batch.environment(number).map(|environment| picture::shown(py, environment)).transpose()
    }

    /// Lines of the map of an environment's scene: name of the scene, and kind and points of each line.
    fn picture_map<'py>(&self, py: Python<'py>, number: usize) -> PyResult<Option<Bound<'py, PyAny>>> {
        let inner = self.lock()?;
        inner.batch.environment(number).map(|environment| picture::map(py, environment)).transpose()
    }
}

impl PyEnvironments {
    fn lock(&self) -> PyResult<MutexGuard<'_, Inner>> {
        self.inner.try_lock().map_err(|_| {
            OptionError::new_err(
                "another thread steps these environments; give each thread environments of its own",
            )
        })
    }

    fn reset_rows(
        &self,
        py: Python<'_>,
        resets: Vec<(usize, Option<u64>, Option<usize>)>,
    ) -> PyResult<(BatchOutput, usize)> {
        let mut inner = self.lock()?;
        let Inner { batch, threads } = &mut *inner;
        for scene in resets.iter().filter_map(|reset| reset.2) {
            // What is wrong with a scene that is asked for keeps its class.
            detached(py, || self.scenes.check(scene))?;
        }
        let resets: Vec<Reset> =
            resets.into_iter().map(|(number, seed, scene)| Reset { number, seed, scene }).collect();
        let out = threads.work(py, || {
            let mut out = BatchOutput::default();
            batch.reset(&resets, &mut out)?;
            Ok(out)
        })?;
        Ok((out, batch.len()))
    }

    fn step_rows(
        &self,
        py: Python<'_>,
        actions: &PyReadonlyArrayDyn<'_, f32>,
        steps: Option<usize>,
    ) -> PyResult<(BatchOutput, usize)> {
        let mut inner = self.lock()?;
        let Inner { batch, threads } = &mut *inner;
        let actions: Vec<[f32; 2]> = actions.as_slice()?.as_chunks::<2>().0.to_vec();
        let out = threads.work(py, || {
            let mut out = BatchOutput::default();
            match steps {
                None => batch.step(&actions, &mut out)?,
                Some(steps) => batch.roll_out(steps, &actions, &mut out)?,
            }
            Ok(out)
        })?;
        Ok((out, batch.len()))
    }

    fn infos<'o>(&self, out: &'o BatchOutput) -> Infos<'o> {
        Infos { rows: &out.rows, first: self.scenes.counts().first }
    }

    fn stepped<'py>(&self, py: Python<'py>, out: BatchOutput, shape: &[usize]) -> PyResult<Stepped<'py>> {
        let described = self.infos(&out);
        let infos = described.columns(py)?;
        if !out.last.is_empty() {
            described.add_last(py, &infos, &out.last)?;
        }
        let shaped = |last: usize| [shape, &[last]].concat();
        Ok((
            values::array(py, out.observations, &shaped(LENGTH))?,
            values::array(py, out.rewards, shape)?,
            values::array(py, out.terminated, shape)?,
            values::array(py, out.truncated, shape)?,
            infos,
        ))
    }
}

/// The rules of a preset, with some keys of `advsage.gym` changed.
///
/// *Errors*: a key that there is not, or a value of a wrong type; `advsage.gym` has checked both.
fn rules(given: &Bound<'_, PyDict>) -> PyResult<Arc<EnvironmentOptions>> {
    let preset: String = given.as_any().get_item("preset")?.extract()?;
    let mut rules = EnvironmentOptions::preset(&preset)
        .ok_or_else(|| UnknownName::new_err(format!("unknown preset `{preset}`")))?;
    let mut world = (*rules.world).clone();
    for (key, value) in given {
        let key: String = key.extract()?;
        match &*key {
            "preset" => {}
            "horizon" => {
                // None is no limit, and a text the end of the recording.
                let steps: Option<usize> = value.extract().unwrap_or(None);
                rules.max_steps = steps.unwrap_or(usize::MAX);
                rules.outlast_log = !value.is_instance_of::<PyString>();
            }
            "no_static_vehicles" => world.traffic.parked = !value.extract::<bool>()?,
            "reactive_traffic" if value.extract()? => world.traffic.mode = TrafficMode::Reactive,
            "reactive_traffic" => {}
            "truncate_as_terminate" => rules.limit_terminates = value.extract()?,
            "crash_vehicle_done" => rules.contact_ends = value.extract()?,
            _ => {
                let rewards = &mut rules.rewards;
                let number = match &*key {
                    "driving_reward" => &mut rewards.progress,
                    "success_reward" => &mut rewards.success,
                    "out_of_road_penalty" => &mut rewards.out_of_road,
                    "crash_vehicle_penalty" => &mut rewards.vehicle_contact,
                    "crash_object_penalty" => &mut rewards.object_contact,
                    "out_of_road_cost" => &mut rewards.out_of_road_cost,
                    "crash_vehicle_cost" => &mut rewards.vehicle_contact_cost,
                    "crash_object_cost" => &mut rewards.object_contact_cost,
                    _ => return Err(UnknownName::new_err(format!("unknown key `{key}`"))),
                };
                *number = value.extract()?;
            }
        }
    }
    rules.world = Arc::new(world);
    Ok(Arc::new(rules))
}
