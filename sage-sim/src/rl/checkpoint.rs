//! Checkpoints of a training run: `checkpoint.safetensors`, and `buffer.rows` with all rows of the replay buffer.
//!
//! Saving appends the new rows to the log and then replaces the checkpoint by renaming, so a kill at any time leaves a
//! whole checkpoint with at least the rows that it needs; reading cuts what lies behind them.

use std::{
    borrow::Cow,
    collections::{BTreeMap, HashMap, VecDeque},
    fs::{File, OpenOptions},
    io::{self, BufReader, BufWriter, Seek, SeekFrom, Write},
    path::Path,
};

use safetensors::{Dtype, SafeTensors, View};
use sage_core::files::{self, Existing};
use serde::{Deserialize, Serialize};

use super::{
    Counters, Evaluation, Network, SceneRecord, SuccessRates, TrainingOptions, TrainingState,
    training_state::StoredDrive,
};
use crate::vehicle::Motion;

/// File of everything but the buffer.
pub const CHECKPOINT: &str = "checkpoint.safetensors";
/// File of the buffer's rows.
pub const BUFFER: &str = "buffer.rows";
/// Key of the record in the header: its checksum, a space, and the record.
const KEY: &str = "checkpoint";
/// What marks a file as a checkpoint of this format.
const FORMAT: &str = "sage train-ego checkpoint 1";
/// Largest checkpoint that is read, bytes.
const MAX_CHECKPOINT: u64 = 1 << 30;
/// Numbers of a motion.
const MOTION: usize = 6;

/// Everything of a state but tensors.
#[derive(Serialize, Deserialize)]
struct Record<'a> {
    format: Cow<'a, str>,
    /// What identifies the run.
    identity: Cow<'a, str>,
    updates: u64,
    written: u64,
    /// For each stored drive: scene, step, number of motions; the newest of a scene first.
    drives: Vec<(usize, u64, usize)>,
    records: Cow<'a, [SceneRecord]>,
    success: Cow<'a, SuccessRates>,
    counters: Cow<'a, Counters>,
    diverging: u32,
    losses: [f64; 3],
    loss_curve: Cow<'a, [[f64; 3]]>,
    evaluations: Cow<'a, [Evaluation]>,
}

/// A tensor to be written.
struct Bytes {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl View for Bytes {
    fn dtype(&self) -> Dtype {
        self.dtype
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }
    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

fn singles(shape: Vec<usize>, numbers: &[f32]) -> Bytes {
    Bytes { dtype: Dtype::F32, shape, bytes: numbers.iter().flat_map(|x| x.to_le_bytes()).collect() }
}

/// Tensors of an actor, with names that start with `prefix`.
pub(super) fn actor_tensors(prefix: &str, actor: &Network<f32>) -> Vec<(String, impl View + use<>)> {
    let mut all = Vec::new();
    for ((name, shape), range) in actor.shape().tensors().into_iter().zip(actor.shape().ranges()) {
        all.push((format!("{prefix}{name}"), singles(shape, &actor.parameters()[range])));
    }
    all
}

/// Writes a safetensors file: to a temporary name first, then renamed.
pub(super) fn write_tensors<V: View>(
    path: &Path,
    tensors: Vec<(String, V)>,
    header: &[(&str, String)],
) -> io::Result<()> {
    let header: HashMap<String, String> = header.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect();
    let bytes = safetensors::serialize(tensors, Some(header)).map_err(io::Error::other)?;
    files::write(path, &bytes, Existing::Replace)
}

/// Checksum of a state: its record, and all tensors by name.
fn checksum<'a>(record: &str, tensors: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(record.as_bytes());
    let sorted: BTreeMap<&str, &[u8]> = tensors.collect();
    for (name, bytes) in sorted {
        hasher.update(name.as_bytes());
        hasher.update(bytes);
    }
    hasher.finalize().to_hex()[..16].to_owned()
}

impl TrainingState {
    /// Saves the state into a folder. `saved` is the number of rows that [`BUFFER`] holds.
    ///
    /// *Errors*: as the system.
    pub fn save(&self, folder: &Path, identity: &str, saved: u64) -> io::Result<u64> {
        let row_bytes = self.buffer.row_bytes() as u64;
        let mut log =
            OpenOptions::new().create(true).truncate(false).write(true).open(folder.join(BUFFER))?;
        // Rows that the ring has lost since the last checkpoint are needed no more: zeros stand in their place.
        let saved = saved.max(self.buffer.oldest());
        log.set_len(saved * row_bytes)?;
        log.seek(SeekFrom::End(0))?;
        let mut to = BufWriter::with_capacity(1 << 20, log);
        self.buffer.write_rows(saved, &mut to)?;
        to.flush()?;
        to.get_ref().sync_data()?;
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
            updates: self.learner.updates(),
            written: self.buffer.written(),
            drives,
            records: (&self.records).into(),
            success: Cow::Borrowed(&self.success),
            counters: Cow::Borrowed(&self.counters),
            diverging: self.diverging,
            losses: self.losses,
            loss_curve: (&self.loss_curve).into(),
            evaluations: (&self.evaluations).into(),
        };
        let record = serde_json::to_string(&record)?;
        let learner = self.learner.tensors().into_iter();
        let mut tensors: Vec<(String, Bytes)> =
            learner.map(|tensor| (tensor.name, singles(tensor.shape, tensor.numbers))).collect();
        for (number, evaluation) in self.evaluations.iter().enumerate() {
            let Some(actor) = &evaluation.actor else { continue };
            let all = actor.parameters();
            tensors.push((format!("evaluated.{number}"), singles(vec![all.len()], all)));
        }
        let rows = motions.len() / 8 / MOTION;
        tensors.push((
            "drives".to_owned(),
            Bytes { dtype: Dtype::F64, shape: vec![rows, MOTION], bytes: motions },
        ));
        let sum = checksum(&record, tensors.iter().map(|(name, tensor)| (&name[..], &tensor.bytes[..])));
        write_tensors(&folder.join(CHECKPOINT), tensors, &[(KEY, format!("{sum} {record}"))])?;
        Ok(self.buffer.written())
    }

    /// Reads the state of a folder; `None` if it has no checkpoint. Returns it with the number of rows in [`BUFFER`].
    ///
    /// *Errors*: the file, and what is wrong with it.
    pub fn load(
        folder: &Path,
        identity: &str,
        options: &TrainingOptions,
        scenes: usize,
    ) -> Result<Option<(Self, u64)>, String> {
        let path = folder.join(CHECKPOINT);
        if !path.exists() {
            return Ok(None);
        }
        let fail = |problem: String| format!("`{}`: {problem}; give --force to start again", path.display());
        let bytes = files::read(&path, MAX_CHECKPOINT).map_err(|error| fail(error.to_string()))?;
        let damaged = |error: &dyn std::fmt::Display| fail(format!("not a checkpoint, or damaged ({error})"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|error| damaged(&error))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|error| damaged(&error))?;
        let entry = header.metadata().as_ref().and_then(|entries| entries.get(KEY));
        let Some((sum, text)) = entry.and_then(|entry| entry.split_once(' ')) else {
            return Err(fail("not a checkpoint of `sage train-ego`".to_owned()));
        };
        let all = file.tensors();
        if checksum(text, all.iter().map(|(name, tensor)| (&name[..], tensor.data()))) != sum {
            return Err(fail("its checksum is wrong: the file is damaged".to_owned()));
        }
        let record: Record = serde_json::from_str(text).map_err(|error| damaged(&error))?;
        if record.format != FORMAT {
            return Err(fail(format!("its format is `{}`; expected `{FORMAT}`", record.format)));
        }
        if record.identity != identity {
            return Err(fail("it is of a run with other options, scenes or weights".to_owned()));
        }
        let numbers: BTreeMap<String, Vec<f32>> = all
            .iter()
            .filter(|(_, tensor)| tensor.dtype() == Dtype::F32)
            .map(|(name, tensor)| (name.clone(), singles_of(tensor.data())))
            .collect();
        let mut state = Self::new(options, scenes)?;
        state.learner.set_tensors(&numbers, record.updates).map_err(&fail)?;
        let motions = file.tensor("drives").map_err(|error| damaged(&error))?;
        state.drives = stored_drives(&record.drives, motions.data(), scenes)
            .ok_or_else(|| fail("its stored drives do not fit the scenes".to_owned()))?;
        state.records = record.records.into_owned();
        state.success = record.success.into_owned();
        state.counters = record.counters.into_owned();
        state.diverging = record.diverging;
        state.losses = record.losses;
        state.loss_curve = record.loss_curve.into_owned();
        state.evaluations = record.evaluations.into_owned();
        let shape = *state.learner.actor().shape();
        for (number, evaluation) in state.evaluations.iter_mut().enumerate() {
            let actor = numbers.get(&format!("evaluated.{number}"));
            evaluation.actor = actor.and_then(|numbers| Network::of(shape, numbers.clone()));
        }
        state.read_buffer(&folder.join(BUFFER), record.written)?;
        Ok(Some((state, record.written)))
    }

    fn read_buffer(&mut self, path: &Path, written: u64) -> Result<(), String> {
        let fail = |problem: String| format!("`{}`: {problem}; give --force to start again", path.display());
        let row_bytes = self.buffer.row_bytes() as u64;
        let mut file = File::open(path).map_err(|error| fail(error.to_string()))?;
        let length = file.metadata().map_err(|error| fail(error.to_string()))?.len();
        if length < written * row_bytes {
            return Err(fail(format!("it has {length} bytes; the checkpoint needs {}", written * row_bytes)));
        }
        let kept = self.buffer.rows_kept(written);
        let start = SeekFrom::Start((written - kept) * row_bytes);
        file.seek(start).map_err(|error| fail(error.to_string()))?;
        let mut from = BufReader::with_capacity(1 << 20, file);
        self.buffer.read_rows(written, kept, &mut from).map_err(|error| fail(error.to_string()))
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
            motions.push(Motion { position: [x, y], heading, velocity: [vx, vy], yaw_rate });
        }
        if motions.len() != *count {
            return None;
        }
        drives.get_mut(*scene)?.push_back(StoredDrive { step: *step, motions });
    }
    Some(drives)
}
