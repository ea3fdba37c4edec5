//! The loop of pretraining and of fine-tuning: epochs, steps, and a state that a broken run goes on from.

use std::{path::Path, time::Instant};

use rayon::prelude::*;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

use super::{Checkpoint, Gradient, Trainer};
use crate::{Error, nn::AdamWConfig, parameters::Header};

/// What a run learns from, and what an epoch comes to.
pub(super) trait Course: Sync {
    /// Something to learn from.
    type Item: Sync;
    /// What is noted of an item.
    type Note: Send;
    /// What an epoch comes to.
    type Row: Clone + Serialize + DeserializeOwned;

    /// Items of an epoch, from 1, in their order.
    fn items(&self, epoch: u32) -> Vec<Self::Item>;

    /// Learning rate at a step of so many.
    fn rate(&self, step: u64, steps: u64) -> f64;

    /// Gradient of an item, unless it has nothing to teach; `step` is that of the epoch, from 1.
    fn learn(
        &self,
        trainer: &Trainer,
        item: &Self::Item,
        epoch: u32,
        step: usize,
    ) -> Result<(Option<Gradient>, Self::Note), Error>;

    /// After each step; whether to stop. Gradients are those of its items.
    fn stepped(&mut self, _epoch: u32, _step: usize, _steps: usize, _gradients: &[Gradient]) -> bool {
        false
    }

    /// What an epoch came to.
    fn row(&mut self, trainer: &Trainer, epoch: Epoch<Self::Note>) -> Result<Self::Row, Error>;

    /// A row was made or, in a run that is taken up again, found; `new` tells which. What must be on disk
    /// before the state says that the epoch is over is written here.
    fn finished(&mut self, trainer: &Trainer, before: &[Self::Row], row: &Self::Row) -> Result<(), Error>;

    /// Rows of a run that is taken up again.
    fn resumed(&mut self, rows: &[Self::Row]);
}

/// One pass over the items.
pub(super) struct Epoch<N> {
    /// Its number, from 1.
    pub number: u32,
    /// Notes of all items in their order.
    pub notes: Vec<N>,
    /// Steps made.
    pub steps: usize,
    /// Sum of the lengths of their gradients before clipping.
    pub lengths: f64,
    /// Learning rate of the last.
    pub rate: f64,
    /// When it began.
    pub clock: Instant,
}

/// How long and how boldly.
pub(super) struct Plan {
    pub epochs: u32,
    /// Items a step.
    pub batch: usize,
    /// Longest gradient of a step.
    pub clip: f64,
    pub weight_decay: f64,
}

/// Where the checkpoint of a run is written after each epoch, so that the run can resume.
pub struct CheckpointFile<'p> {
    /// The file.
    pub file: &'p Path,
    /// Identity of the run: a checkpoint of another run is refused.
    pub identity: Value,
    /// What the file says of itself.
    pub header: Header,
}

/// Runs to the last epoch, or until the course stops; the rows, and whether it was stopped.
///
/// *Errors*: [`Error::Format`] for a state that is damaged or of another run, with the remedy; those of the
/// course.
pub(super) fn run<C: Course>(
    course: &mut C,
    trainer: &mut Trainer,
    plan: &Plan,
    checkpoint: Option<&CheckpointFile>,
) -> Result<(Vec<C::Row>, bool), Error> {
    let mut rows = match checkpoint {
        Some(checkpoint) => resume(trainer, checkpoint, plan.config())?,
        None => Vec::new(),
    };
    if !rows.is_empty() {
        course.resumed(&rows);
    }
    while (rows.len() as u32) < plan.epochs {
        let number = rows.len() as u32 + 1;
        let clock = Instant::now();
        let items = course.items(number);
        let steps = items.len().div_ceil(plan.batch);
        let whole = u64::from(plan.epochs) * steps as u64;
        let mut epoch =
            Epoch { number, notes: Vec::with_capacity(items.len()), steps, lengths: 0.0, rate: 0.0, clock };
        for (k, batch) in items.chunks(plan.batch).enumerate() {
            let learn = |item| course.learn(trainer, item, number, k + 1);
            let learnt: Vec<_> = batch.par_iter().with_max_len(1).map(learn).collect();
            let learnt = learnt.into_iter().collect::<Result<Vec<_>, Error>>()?;
            let (gradients, notes): (Vec<_>, Vec<_>) = learnt.into_iter().unzip();
            let gradients: Vec<Gradient> = gradients.into_iter().flatten().collect();
            epoch.notes.extend(notes);
            epoch.rate = course.rate(trainer.adam.steps, whole);
            // A batch with nothing to teach makes no step.
            if !gradients.is_empty() {
                epoch.lengths += trainer.update(&gradients, epoch.rate, plan.clip)?;
            }
            if course.stepped(number, k + 1, steps, &gradients) {
                return Ok((rows, true));
            }
        }
        let row = course.row(trainer, epoch)?;
        course.finished(trainer, &rows, &row)?;
        rows.push(row);
        if let Some(CheckpointFile { file, identity, header }) = checkpoint {
            let state =
                Checkpoint { identity: identity.clone(), rows: rows.clone(), steps: trainer.adam.steps };
            state.save(&trainer.weights()?, &trainer.adam, header, file)?;
        }
    }
    Ok((rows, false))
}

impl Plan {
    pub(super) fn config(&self) -> AdamWConfig {
        AdamWConfig { weight_decay: self.weight_decay, ..AdamWConfig::default() }
    }
}

/// Resumes from the checkpoint of the same run, if there is one; the rows so far.
fn resume<Row: Serialize + DeserializeOwned>(
    trainer: &mut Trainer,
    checkpoint: &CheckpointFile,
    config: AdamWConfig,
) -> Result<Vec<Row>, Error> {
    if !checkpoint.file.exists() {
        return Ok(Vec::new());
    }
    let fail = |problem: String| Error::Format { path: checkpoint.file.to_owned(), problem };
    let (state, weights, adam) = match Checkpoint::<Row>::load(checkpoint.file, config) {
        Err(Error::Format { problem, .. }) => {
            return Err(fail(format!("{problem}; remove it to start again")));
        }
        loaded => loaded?,
    };
    if state.identity != checkpoint.identity {
        let problem = "belongs to a run with other options or data; give another folder or remove it";
        return Err(fail(problem.to_owned()));
    }
    trainer.set_weights(&weights).map_err(|error| fail(format!("{error}; remove it to start again")))?;
    trainer.adam = adam;
    Ok(state.rows)
}
