//! TD3 as a learner (Fujimoto et al. 2018): random steps first, then so many updates a step, from a replay buffer.

mod buffer_log;
mod options;
mod replay_buffer;
mod update;

use std::{collections::BTreeMap, io, path::Path};

use sage_core::seed::Rng;
use sage_sim::{
    Error,
    actor::{Network, SingleRow},
    observation::LENGTH,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use buffer_log::BUFFER;
pub use options::Td3Options;
pub use replay_buffer::{ReplayBuffer, Transition};
pub use update::{Td3Learner, TransitionBatch, UpdateReport};

use self::buffer_log::BufferLog;
use super::{DrivenStep, Learner, NamedTensor, TrainingOptions};

/// Sizes of observation and action.
const SIZES: [usize; 2] = [LENGTH, 2];
/// Mean |Q| that no sound critic reaches: twice the bound 2.25/(1 − 0.99) + 10 of the return.
const DIVERGED: f64 = 470.0;
/// Updates in a row above it after which the run stops.
const DIVERGED_UPDATES: u32 = 100;
/// Mean |Q| at which it stops at once: after learning rates that large, all units may be dead, and |Q| small again.
const FAR_DIVERGED: f64 = 100.0 * DIVERGED;

/// TD3 in a training.
pub struct Td3 {
    seed: u64,
    all_updates: u64,
    all_steps: u64,
    ratio: f64,
    networks: Td3Learner<f32>,
    buffer: ReplayBuffer,
    /// Where its rows are on disk.
    log: BufferLog,
    /// Row of the newest observation of each episode in progress.
    rows: Vec<u64>,
    batch: TransitionBatch<f32>,
    memory: SingleRow<f32>,
    diverging: u32,
    /// Sums over the updates since the last call of `take_losses`: loss of the critics, its count, mean |Q|.
    losses: [f64; 3],
}

/// Everything of a learner but tensors and rows, for a checkpoint.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    updates: u64,
    /// Rows that were written to the buffer.
    written: u64,
    buffer: BufferLog,
    rows: Vec<u64>,
    diverging: u32,
    losses: [f64; 3],
}

impl Td3 {
    /// A learner for a training.
    ///
    /// *Errors*: as [`Td3Options::check`].
    pub fn new(options: &TrainingOptions) -> Result<Self, Error> {
        let td3 = options.td3.clone();
        let held = (td3.buffer as u64).min(options.steps()) as usize;
        Ok(Self {
            seed: options.seed,
            all_updates: options.updates,
            all_steps: options.steps(),
            ratio: options.ratio,
            buffer: ReplayBuffer::new(held, SIZES),
            log: BufferLog::default(),
            rows: vec![0; options.slots()],
            batch: TransitionBatch::new(td3.batch, SIZES[0], SIZES[1]),
            networks: Td3Learner::new(td3, SIZES, options.seed)?,
            memory: SingleRow::default(),
            diverging: 0,
            losses: [0.0; 3],
        })
    }

    /// The updates that belong to the steps so far.
    fn update(&mut self, steps: u64) -> Result<(), Error> {
        let steps = steps.saturating_sub(self.networks.options().random_steps);
        let due = ((steps as f64 * self.ratio).floor() as u64).min(self.all_updates);
        while self.networks.updates() < due {
            let key = self.networks.updates().to_string();
            let rng = |purpose| Rng::new(self.seed, &key, purpose);
            if !self.buffer.draw(&mut rng("batch"), &mut self.batch) {
                return Ok(());
            }
            let mut smoothing = rng("smoothing");
            self.batch.noise.fill_with(|| smoothing.normal() as f32);
            let report = self.networks.update(&self.batch);
            let [loss, count, q] = &mut self.losses;
            *loss += report.critic_loss;
            *count += 1.0;
            *q += report.mean_abs_q;
            let at = self.networks.updates();
            if !report.critic_loss.is_finite() || report.actor_loss.is_some_and(|loss| !loss.is_finite()) {
                let tensor = self
                    .networks
                    .not_finite()
                    .map_or(String::new(), |name| format!("; tensor `{name}` is not finite"));
                return Err(Error::Value(format!("update {at}: the loss is not finite{tensor}")));
            }
            let q = report.mean_abs_q;
            self.diverging = if q > DIVERGED { self.diverging + 1 } else { 0 };
            if self.diverging >= DIVERGED_UPDATES || q > FAR_DIVERGED {
                return Err(Error::Value(format!(
                    "update {at}: the training diverges; mean |Q| is {q:.3e}, and no return reaches {DIVERGED}; lower the learning rates"
                )));
            }
        }
        Ok(())
    }
}

impl Learner for Td3 {
    fn turn(&self) -> u64 {
        1
    }

    fn begin(&mut self, slot: usize, observation: &[f32; LENGTH]) {
        self.rows[slot] = self.buffer.start(observation);
    }

    /// Random at the start, then the actor's with noise.
    fn act(&mut self, _: usize, steps: u64, observation: &[f32; LENGTH]) -> [f32; 2] {
        let td3 = self.networks.options();
        let mut rng = Rng::new(self.seed, &steps.to_string(), "exploration");
        let mut numbers = [0.0_f32; 2];
        if steps < td3.random_steps {
            numbers.fill_with(|| rng.uniform(-td3.max_action, td3.max_action) as f32);
        } else {
            self.networks.act(observation, &mut self.memory, &mut numbers);
            let deviation = td3.exploration_noise * td3.max_action;
            for x in &mut numbers {
                let noisy = f64::from(*x) + deviation * rng.normal();
                *x = noisy.clamp(-td3.max_action, td3.max_action) as f32;
            }
        }
        numbers
    }

    fn learn(&mut self, step: &DrivenStep) -> Result<(), Error> {
        self.rows[step.slot] = self.buffer.step(&Transition {
            from: self.rows[step.slot],
            action: &step.action,
            reward: step.reward,
            is_terminal: step.is_terminal,
            next: step.next,
        });
        self.update(step.steps)
    }

    fn actor(&self) -> Network<f32> {
        self.networks.actor().clone()
    }

    fn has_learnt(&self, steps: u64) -> bool {
        steps >= self.networks.options().random_steps
    }

    fn updates(&self) -> u64 {
        self.networks.updates()
    }

    fn take_losses(&mut self) -> [f64; 2] {
        let [loss, count, q] = std::mem::take(&mut self.losses);
        [loss / count.max(1.0), q / count.max(1.0)]
    }

    fn not_finite(&self) -> Option<String> {
        self.networks.not_finite()
    }

    fn tensors(&self) -> Vec<NamedTensor<'_, f32>> {
        self.networks.tensors()
    }

    fn record(&self) -> Value {
        json!(Record {
            updates: self.networks.updates(),
            written: self.buffer.written_count(),
            buffer: self.log.clone(),
            rows: self.rows.clone(),
            diverging: self.diverging,
            losses: self.losses,
        })
    }

    fn restore(
        &mut self,
        tensors: &BTreeMap<String, Vec<f32>>,
        record: Value,
        _: u64,
        folder: &Path,
    ) -> Result<(), Error> {
        let record: Record =
            serde_json::from_value(record).map_err(|error| Error::Value(error.to_string()))?;
        // A row for each step, and one for the start of each episode, which has a step.
        let most_rows = self.all_steps.saturating_mul(2).saturating_add(self.rows.len() as u64);
        let limits = [
            ("updates", record.updates, self.all_updates),
            ("written", record.written, most_rows),
            ("diverging", record.diverging.into(), self.all_updates),
            ("rows", record.rows.iter().copied().max().unwrap_or(0), record.written),
        ];
        if let Some((name, found, most)) = limits.into_iter().find(|(_, found, most)| found > most) {
            return Err(Error::Value(format!("its field `{name}` is {found}; expected at most {most}")));
        }
        if record.rows.len() != self.rows.len() || !record.losses.iter().all(|x| x.is_finite()) {
            return Err(Error::Value(
                "its field `rows` or `losses` holds values that no run of these options has".to_owned(),
            ));
        }
        self.networks.set_tensors(tensors, record.updates)?;
        (self.rows, self.log) = (record.rows, record.buffer);
        (self.diverging, self.losses) = (record.diverging, record.losses);
        self.log.read(&mut self.buffer, record.written, folder)
    }

    fn save_rows(&mut self, folder: &Path) -> io::Result<()> {
        self.log.append(&self.buffer, folder)
    }

    fn remove_old_rows(&self, folder: &Path) -> io::Result<()> {
        self.log.remove_others(folder)
    }

    fn is_finite(&self) -> bool {
        self.buffer.is_finite()
    }

    fn break_weight(&mut self, tensor: &str) {
        self.networks.break_weight(tensor);
    }
}
