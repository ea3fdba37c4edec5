//! The loop of pretraining and fine-tuning: epochs, steps, and checkpoints to resume an interrupted run.

use std::{path::Path, time::Instant};

use rayon::prelude::*;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

use super::{Checkpoint, Gradient, Trainer};
use crate::{
    Error, Parameters,
    nn::{AdamW, AdamWConfig},
    parameters::Header,
};

/// What differs between pretraining and fine-tuning: the training items, their gradients and the epoch
/// results.
pub(super) trait Task: Sync {
    /// A training item.
    type Item: Sync;
    /// Statistics of an item.
    type Note: Send;
    /// Results of an epoch.
    type Row: Clone + Serialize + DeserializeOwned;

    /// Items of an epoch, numbered from 1, in their order.
    fn items(&self, epoch: u32) -> Vec<Self::Item>;

    /// Learning rate at one of `steps` steps.
    fn rate(&self, step: u64, steps: u64) -> f64;

    /// Gradient of an item, if it has one, and its statistics; `step` counts within the epoch, from 1.
    fn item_gradient(
        &self,
        trainer: &Trainer,
        item: &Self::Item,
        epoch: u32,
        step: usize,
    ) -> Result<(Option<Gradient>, Self::Note), Error>;

    /// Called after each step with the gradients of its items; returns whether to stop.
    fn after_step(&mut self, _epoch: u32, _step: usize, _steps: usize, _gradients: &[Gradient]) -> bool {
        false
    }

    /// Results of an epoch.
    fn row(&mut self, trainer: &Trainer, epoch: Epoch<Self::Note>) -> Result<Self::Row, Error>;

    /// Called after each epoch with the earlier rows and the new one. The loop writes the checkpoint of the
    /// epoch after this call, so files that must exist before the checkpoint are written here.
    fn after_epoch(&mut self, trainer: &Trainer, before: &[Self::Row], row: &Self::Row) -> Result<(), Error>;

    /// Called once with the rows of a resumed run.
    fn resumed(&mut self, rows: &[Self::Row]);
}

/// One pass over the items.
pub(super) struct Epoch<N> {
    /// Its number, from 1.
    pub number: u32,
    /// Statistics of all items in their order.
    pub notes: Vec<N>,
    /// Number of steps.
    pub steps: usize,
    /// Sum of the gradient norms of the steps before clipping.
    pub norms: f64,
    /// Learning rate of the last step.
    pub rate: f64,
    /// Start of the epoch.
    pub clock: Instant,
}

/// Options of the training loop.
pub(super) struct LoopOptions {
    pub epochs: u32,
    /// Items per step.
    pub batch: usize,
    /// Maximum norm of the gradient of a step.
    pub clip: f64,
    pub weight_decay: f64,
}

/// Where the checkpoint of a run is written after each epoch, so that the run can resume.
pub struct CheckpointFile<'p> {
    /// The file.
    pub file: &'p Path,
    /// Identity of the run: a checkpoint of another run is refused.
    pub identity: Value,
    /// Header of the file.
    pub header: Header,
}

/// Runs until the last epoch or until the task stops. Returns the rows, and whether the task stopped.
///
/// *Errors*: [`Error::Format`] for a checkpoint that is damaged or of another run, with the remedy; those of
/// the task.
pub(super) fn run<T: Task>(
    task: &mut T,
    trainer: &mut Trainer,
    options: &LoopOptions,
    checkpoint: Option<&CheckpointFile>,
) -> Result<(Vec<T::Row>, bool), Error> {
    let mut rows = match checkpoint {
        Some(checkpoint) => resume(trainer, checkpoint, options.config())?,
        None => Vec::new(),
    };
    if !rows.is_empty() {
        task.resumed(&rows);
    }
    while (rows.len() as u32) < options.epochs {
        let number = rows.len() as u32 + 1;
        let clock = Instant::now();
        let items = task.items(number);
        let steps = items.len().div_ceil(options.batch);
        let whole = u64::from(options.epochs) * steps as u64;
        let mut epoch =
            Epoch { number, notes: Vec::with_capacity(items.len()), steps, norms: 0.0, rate: 0.0, clock };
        for (k, batch) in items.chunks(options.batch).enumerate() {
            let one = |item| task.item_gradient(trainer, item, number, k + 1);
            let results: Vec<_> = batch.par_iter().with_max_len(1).map(one).collect();
            let results = results.into_iter().collect::<Result<Vec<_>, Error>>()?;
            let (gradients, notes): (Vec<_>, Vec<_>) = results.into_iter().unzip();
            let gradients: Vec<Gradient> = gradients.into_iter().flatten().collect();
            epoch.notes.extend(notes);
            epoch.rate = task.rate(trainer.adam.steps, whole);
            // A batch without gradients makes no step.
            if !gradients.is_empty() {
                epoch.norms += trainer.update(&gradients, epoch.rate, options.clip)?;
            }
            if task.after_step(number, k + 1, steps, &gradients) {
                return Ok((rows, true));
            }
        }
        if rows.is_empty() && epoch.norms > 0.0 {
            trainer.check_reached()?;
        }
        let row = task.row(trainer, epoch)?;
        task.after_epoch(trainer, &rows, &row)?;
        rows.push(row);
        if let Some(checkpoint) = checkpoint {
            checkpoint.write(&rows, &trainer.weights()?, &trainer.adam)?;
        }
    }
    Ok((rows, false))
}

impl LoopOptions {
    pub(super) fn config(&self) -> AdamWConfig {
        AdamWConfig { weight_decay: self.weight_decay, ..AdamWConfig::default() }
    }
}

/// Resumes from the checkpoint of the same run, if there is one; returns the rows so far.
fn resume<Row: Serialize + DeserializeOwned>(
    trainer: &mut Trainer,
    checkpoint: &CheckpointFile,
    config: AdamWConfig,
) -> Result<Vec<Row>, Error> {
    let Some((rows, weights, adam)) = checkpoint.read(config)? else { return Ok(Vec::new()) };
    trainer.set_weights(&weights).map_err(|error| checkpoint.unfit(&error.to_string()))?;
    trainer.adam = adam;
    Ok(rows)
}

impl CheckpointFile<'_> {
    /// Writes the state after an epoch.
    ///
    /// *Errors*: [`Error::Io`].
    pub fn write<Row: Clone + Serialize + DeserializeOwned>(
        &self,
        rows: &[Row],
        weights: &Parameters,
        adam: &AdamW,
    ) -> Result<(), Error> {
        let state = Checkpoint { identity: self.identity.clone(), rows: rows.to_vec(), steps: adam.steps };
        state.save(weights, adam, &self.header, self.file)
    }

    /// Rows, weights and the optimiser's state, if the file exists.
    ///
    /// *Errors*: [`Error::Format`] for a file that is damaged or of another run, with the remedy; [`Error::Io`].
    pub fn read<Row: Serialize + DeserializeOwned>(
        &self,
        config: AdamWConfig,
    ) -> Result<Option<(Vec<Row>, Parameters, AdamW)>, Error> {
        if !self.file.exists() {
            return Ok(None);
        }
        let (state, weights, adam) = match Checkpoint::<Row>::load(self.file, config) {
            Err(Error::Format { problem, .. }) => return Err(self.unfit(&problem)),
            Err(Error::NoNetwork { .. }) => return Err(self.unfit("is no checkpoint of a training")),
            loaded => loaded?,
        };
        if state.identity != self.identity {
            let problem = "belongs to a run with other options or data; give another folder or remove it";
            return Err(Error::Format { path: self.file.to_owned(), problem: problem.to_owned() });
        }
        Ok(Some((state.rows, weights, adam)))
    }

    /// The error of a file from which no run can resume.
    pub fn unfit(&self, problem: &str) -> Error {
        let problem = format!("{problem}; remove it to start again");
        Error::Format { path: self.file.to_owned(), problem }
    }
}
