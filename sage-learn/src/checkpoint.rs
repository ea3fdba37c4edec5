//! Checkpoints of a training run: `checkpoint.safetensors`, and what the learner keeps beside it, such as the rows of a
//! replay buffer.
//!
//! Saving writes the new rows to a file of their own and then replaces the checkpoint by renaming, so a kill at any time
//! leaves a whole checkpoint with the rows that it needs.

use std::{
    borrow::Cow,
    collections::{BTreeMap, VecDeque},
    io,
    path::Path,
};

use safetensors::{Dtype, SafeTensors};
use sage_core::{content_hash::check_hash, files};
use sage_sim::{
    Error,
    actor::{
        Network,
        tensor_file::{TensorBytes, hashed_tensors, write_tensors},
    },
    curriculum::SuccessRates,
    evaluation::EpisodeRow,
    vehicle::Motion,
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    Counters, Evaluation, SceneRecord, TrainingOptions, TrainingState,
    running_episode::EpisodeRecord,
    training_state::{KeptAttack, StoredDrive},
};

/// File of everything but the buffer.
pub const CHECKPOINT: &str = "checkpoint.safetensors";
/// Key of the record in the header.
const KEY: &str = "checkpoint";
/// What marks a file as a checkpoint of this format.
const FORMAT: &str = "sage train-ego checkpoint 3";
/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT: u64 = 1 << 30;
/// Most episodes that a run counts.
const MOST_EPISODES: u64 = 1 << 40;
/// Numbers of a motion.
const MOTION: usize = 6;

/// Everything of a state but tensors.
#[derive(Serialize, Deserialize)]
struct Record<'a> {
    format: Cow<'a, str>,
    /// What identifies the run.
    identity: Cow<'a, str>,
    /// What the learner adds to its tensors.
    learner: Value,
    /// The episodes in progress, by their place.
    episodes: Cow<'a, [Option<EpisodeRecord>]>,
    /// For each stored drive: scene, step, number of motions; the newest of a scene first.
    drives: Vec<(usize, u64, usize)>,
    /// The attacks that are met again, by scene.
    #[serde(default)]
    attacks: Cow<'a, BTreeMap<usize, KeptAttack>>,
    records: Cow<'a, [SceneRecord]>,
    success: Cow<'a, SuccessRates>,
    counters: Cow<'a, Counters>,
    loss_curve: Cow<'a, [[f64; 3]]>,
    evaluations: Cow<'a, [Evaluation]>,
}

impl TrainingState {
    /// Saves the state into a folder.
    ///
    /// *Errors*: as the system.
    pub fn save(&mut self, folder: &Path, identity: &str) -> io::Result<()> {
        self.learner.save_rows(folder)?;
        let mut drives = Vec::new();
        let mut motions: Vec<u8> = Vec::new();
        for (scene, stored) in self.drives.iter().enumerate() {
            for drive in stored {
                drives.push((scene, drive.step, drive.motions.len()));
                motions.extend(drive.motions.iter().flat_map(numbers).flat_map(f64::to_le_bytes));
            }
        }
        let record = Record {
            format: FORMAT.into(),
            identity: identity.into(),
            learner: self.learner.record(),
            episodes: (&self.episodes).into(),
            drives,
            attacks: Cow::Borrowed(&self.attacks),
            records: (&self.records).into(),
            success: Cow::Borrowed(&self.success),
            counters: Cow::Borrowed(&self.counters),
            loss_curve: (&self.loss_curve).into(),
            evaluations: (&self.evaluations).into(),
        };
        let record = serde_json::to_string(&record)?;
        let learner = self.learner.tensors().into_iter();
        let mut tensors: Vec<(String, TensorBytes)> =
            learner.map(|tensor| (tensor.name, TensorBytes::singles(tensor.shape, tensor.numbers))).collect();
        for (number, evaluation) in self.evaluations.iter().enumerate() {
            let Some(actor) = &evaluation.actor else { continue };
            let all = actor.parameters();
            tensors.push((format!("evaluated.{number}"), TensorBytes::singles(vec![all.len()], all)));
        }
        let shape = vec![motions.len() / 8 / MOTION, MOTION];
        tensors.push(("drives".to_owned(), TensorBytes { dtype: Dtype::F64, shape, bytes: motions }));
        write_tensors(&folder.join(CHECKPOINT), &tensors, KEY, &record)?;
        self.learner.remove_old_rows(folder)
    }

    /// Reads the state of a folder; `None` if it has no checkpoint.
    ///
    /// *Errors*: the file, and what is wrong with it.
    pub fn load(
        folder: &Path,
        identity: &str,
        options: &TrainingOptions,
        scenes: usize,
    ) -> Result<Option<Self>, Error> {
        let path = folder.join(CHECKPOINT);
        if !path.exists() {
            return Ok(None);
        }
        let fail = |problem: String| {
            Error::Value(format!("`{}`: {problem}; give --force to start again", path.display()))
        };
        let bytes = files::read(&path, MAX_CHECKPOINT).map_err(|error| fail(error.to_string()))?;
        let damaged = |error: &dyn std::fmt::Display| fail(format!("not a checkpoint, or damaged ({error})"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(&error))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(&error))?;
        let Some(text) = header.metadata().as_ref().and_then(|entries| entries.get(KEY)) else {
            return Err(fail("not a checkpoint of `sage train-ego`".to_owned()));
        };
        let text = check_hash(text, hashed_tensors(&file)).map_err(|error| fail(error.to_string()))?;
        let record: Record = serde_json::from_str(&text).map_err(|error| damaged(&error))?;
        if record.format != FORMAT {
            return Err(fail(format!("its format is `{}`; expected `{FORMAT}`", record.format)));
        }
        if record.identity != identity {
            return Err(fail("it is of a run with other options, scenes or weights".to_owned()));
        }
        record.check(options, scenes).map_err(|error| fail(error.to_string()))?;
        let numbers: BTreeMap<String, Vec<f32>> = file
            .iter()
            .filter(|(_, tensor)| tensor.dtype() == Dtype::F32)
            .map(|(name, tensor)| (name.to_owned(), singles_of(tensor.data())))
            .collect();
        if let Some((name, _)) = numbers.iter().find(|(_, all)| all.iter().any(|x| !x.is_finite())) {
            return Err(fail(format!("tensor `{}` holds a number that is not finite", name.escape_debug())));
        }
        let mut state = Self::new(options, scenes)?;
        let motions = file.tensor("drives").map_err(|error| damaged(&error))?;
        state.drives = stored_drives(&record.drives, motions.data(), scenes)
            .ok_or_else(|| fail("its stored drives do not fit the scenes".to_owned()))?;
        state.attacks = record.attacks.into_owned();
        state.records = record.records.into_owned();
        state.success = record.success.into_owned();
        state.counters = record.counters.into_owned();
        state.loss_curve = record.loss_curve.into_owned();
        state.evaluations = record.evaluations.into_owned();
        let shape = *state.learner.actor().shape();
        for (number, evaluation) in state.evaluations.iter_mut().enumerate() {
            let actor = numbers.get(&format!("evaluated.{number}"));
            evaluation.actor = actor.and_then(|numbers| Network::of(shape, numbers.clone()));
        }
        state.episodes = record.episodes.into_owned();
        let again = |error: Error| match error.to_string() {
            problem if problem.starts_with('`') => {
                Error::Value(format!("{problem}; give --force to start again"))
            }
            problem => fail(problem),
        };
        state.learner.restore(&numbers, record.learner, state.counters.steps, folder).map_err(again)?;
        Ok(Some(state))
    }
}

impl Record<'_> {
    /// Refuses values that no run of these options and scenes has.
    fn check(&self, options: &TrainingOptions, scenes: usize) -> Result<(), Error> {
        let counters = &self.counters;
        let limits = [
            ("counters.steps", counters.steps, options.steps()),
            // Every episode has at least one step; an episode that could not start is skipped.
            ("counters.episodes", counters.episodes, MOST_EPISODES),
            ("counters.attacked", counters.attacked, counters.episodes),
            ("counters.without_drive", counters.without_drive, counters.episodes),
            ("counters.unavoidable", counters.unavoidable, counters.episodes),
            ("counters.skipped", counters.skipped, MOST_EPISODES),
            ("counters.drive_age", counters.drive_age, MOST_EPISODES.saturating_mul(options.steps())),
        ];
        for (name, found, most) in limits {
            if found > most {
                return Err(Error::Value(format!("its field `{name}` is {found}; expected at most {most}")));
            }
        }
        if self.records.len() != scenes {
            return Err(Error::Value(format!(
                "its field `records` has {} entries; expected {scenes}",
                self.records.len()
            )));
        }
        let is_finite = |numbers: &[f64]| numbers.iter().all(|x| x.is_finite());
        let in_order = |rows: &[EpisodeRow]| rows.iter().enumerate().all(|(k, row)| row.scene == k);
        let is_share = |rate: &f64| (0.0..=1.0).contains(rate);
        let checks = [
            ("records", self.records.iter().all(|record| record.visits <= MOST_EPISODES)),
            ("success", self.success.rates.iter().all(is_share)),
            ("episodes", self.episodes.len() == options.slots() || self.episodes.is_empty()),
            ("episodes", self.episodes.iter().flatten().all(|one| one.is_sound(scenes, options.max_steps))),
            ("attacks", self.attacks.keys().all(|scene| *scene < scenes)),
            ("attacks", self.attacks.values().all(|kept| kept.attack.is_sound())),
            ("loss_curve", self.loss_curve.len() as u64 <= options.evaluations),
            ("loss_curve", self.loss_curve.iter().all(|row| is_finite(row))),
            ("drives", self.drives.iter().all(|(_, step, _)| *step <= counters.steps)),
            ("evaluations", self.evaluations.len() as u64 <= options.evaluations),
            ("evaluations", self.evaluations.iter().all(|one| one.step <= options.steps())),
            (
                "evaluations",
                self.evaluations.iter().all(|one| in_order(&one.unchanged) && in_order(&one.attacked)),
            ),
        ];
        match checks.iter().find(|(_, holds)| !holds) {
            Some((name, _)) => {
                Err(Error::Value(format!("its field `{name}` holds values that no run of these options has")))
            }
            None => Ok(()),
        }
    }
}

fn numbers(motion: &Motion) -> [f64; MOTION] {
    let Motion { position: [x, y], heading, velocity: [vx, vy], yaw_rate } = *motion;
    [x, y, heading, vx, vy, yaw_rate]
}

fn singles_of(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn stored_drives(
    list: &[(usize, u64, usize)],
    bytes: &[u8],
    scenes: usize,
) -> Option<Vec<VecDeque<StoredDrive>>> {
    let number = |b: &[u8]| Some(f64::from_le_bytes(b.try_into().ok()?));
    let mut all = bytes.chunks_exact(8 * MOTION);
    let mut drives = vec![VecDeque::new(); scenes];
    for (scene, step, count) in list {
        let mut motions = Vec::new();
        for row in all.by_ref().take(*count) {
            let mut values = [0.0; MOTION];
            for (value, bytes) in values.iter_mut().zip(row.chunks_exact(8)) {
                *value = number(bytes)?;
            }
            let [x, y, heading, vx, vy, yaw_rate] = values;
            let motion = Motion { position: [x, y], heading, velocity: [vx, vy], yaw_rate };
            motions.push(motion.is_finite().then_some(motion)?);
        }
        if motions.len() != *count {
            return None;
        }
        drives.get_mut(*scene)?.push_back(StoredDrive { step: *step, motions });
    }
    Some(drives)
}
