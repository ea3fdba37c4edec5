//! PPO as a learner: batches of the newest steps, several passes over each, then they are forgotten.
//!
//! Every environment drives a horizon of steps before the next one has its turn, so a batch is a row of short stretches.
//! Observations are normalised by their running mean and deviation, which are folded into the first layer of the
//! policy that drives and is written; rewards are divided by the running deviation of the discounted return.
//!
//! With a teacher it imitates first and learns from experience later, as in kickstarting (Schmitt et al. 2018, arXiv
//! 1803.03835), with squared differences of actions in place of a divergence, for the teacher is no distribution.

mod actor_critic;
mod advantage;
mod normalisation;
mod options;
mod tensors;

use std::{collections::BTreeMap, path::Path};

use sage_core::seed::Rng;
use sage_sim::{
    Error,
    actor::{Network, SingleRow, action_of, aims_of},
    observation::LENGTH,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use actor_critic::{ActorCritic, Minibatch, StepReport, Taught};
pub use advantage::{After, advantages};
pub use normalisation::Running;
pub use options::PpoOptions;

use self::actor_critic::log_density;
use super::{DrivenStep, Learner, NamedTensor};
use crate::batch_passes::Activations;

/// Sizes of observation and action.
const SIZES: [usize; 2] = [LENGTH, 2];
/// Mean size of the critic's values that no sound critic reaches: rewards have the size of the deviation of returns.
const DIVERGED: f64 = 1000.0;

/// The steps of a batch so far.
#[derive(Clone, Debug, Default)]
struct Batch {
    observations: Vec<f32>,
    actions: Vec<f32>,
    log_densities: Vec<f64>,
    rewards: Vec<f64>,
    after: Vec<After>,
    /// Observations behind the cuts.
    cuts: Vec<f32>,
    /// Discounted returns up to each step.
    returns: Vec<f64>,
    /// Teacher's actions before the share of the last one, if there is a teacher.
    taught: Vec<f32>,
}

/// What an action was drawn from.
#[derive(Clone, Debug)]
struct Drawn {
    observation: [f32; LENGTH],
    action: [f32; 2],
    log_density: f64,
}

/// Everything of a learner but tensors, for a checkpoint.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    updates: u64,
    observations: Running,
    returns: Running,
    discounted: Vec<f64>,
    losses: [f64; 3],
}

/// PPO in a training.
pub struct Ppo {
    seed: u64,
    /// Batches of the whole training.
    batches: u64,
    networks: ActorCritic<f32>,
    /// The actor for observations as they are.
    driving: Network<f32>,
    observations: Running,
    returns: Running,
    /// Discounted return of each episode in progress.
    discounted: Vec<f64>,
    batch: Batch,
    drawn: Option<Drawn>,
    noise: Rng,
    memory: SingleRow<f32>,
    values_at: Activations<f32>,
    minibatch: Minibatch<f32>,
    /// Sums since the last call of `take_losses`: loss of the critic, its count, mean size of values.
    losses: [f64; 3],
}

impl Ppo {
    /// A learner for a number of batches.
    ///
    /// *Errors*: as [`PpoOptions::check`].
    pub fn new(options: PpoOptions, batches: u64, seed: u64) -> Result<Self, Error> {
        let (rows, environments) = (options.minibatch, options.environments);
        let networks = ActorCritic::new(options, SIZES, seed)?;
        let observations = Running::new(LENGTH);
        Ok(Self {
            seed,
            batches,
            driving: observations.folded(networks.actor()),
            values_at: Activations::new(rows, networks.critic().shape()),
            networks,
            observations,
            returns: Running::new(1),
            discounted: vec![0.0; environments],
            batch: Batch::default(),
            drawn: None,
            noise: Rng::new(seed, "", "exploration"),
            memory: SingleRow::default(),
            minibatch: Minibatch::default(),
            losses: [0.0; 3],
        })
    }

    /// Batches so far.
    fn done(&self) -> u64 {
        let options = self.networks.options();
        self.networks.steps() / (options.epochs * options.batch() / options.minibatch) as u64
    }

    /// Share of the training that a number of batches is.
    fn share(&self, done: u64) -> f64 {
        done as f64 / self.batches.max(1) as f64
    }

    /// Learns from a full batch and forgets it.
    fn update(&mut self) -> Result<(), Error> {
        let options = self.networks.options().clone();
        let done = self.done();
        let batch = std::mem::take(&mut self.batch);
        self.observations.add(&batch.observations);
        self.returns.add(&batch.returns);
        let size = self.returns.deviations()[0].max(1e-8);
        let rewards: Vec<f64> = batch.rewards.iter().map(|reward| reward / size).collect();
        let (mut normalised, mut cuts) = (Vec::new(), Vec::new());
        self.observations.normalise(&batch.observations, &mut normalised);
        self.observations.normalise(&batch.cuts, &mut cuts);
        let (mut values, mut cut_values) = (Vec::new(), Vec::new());
        self.networks.values(&normalised, &mut self.values_at, &mut values);
        self.networks.values(&cuts, &mut self.values_at, &mut cut_values);
        let discounts = [options.gamma, options.gae_lambda];
        let advantages = advantages(&rewards, &values, &batch.after, &cut_values, discounts);
        let share = self.share(done);
        let rate = options.rate * (1.0 - share);
        let has_teacher = batch.taught.len() == batch.actions.len();
        self.minibatch.taught.weight =
            if has_teacher { imitation_weight(share, options.taught) } else { 0.0 };
        let mut order: Vec<usize> = (0..rewards.len()).collect();
        for epoch in 0..options.epochs {
            Rng::new(self.seed, &format!("{done} {epoch}"), "minibatches").shuffle(&mut order);
            for rows in order.chunks_exact(options.minibatch) {
                let to = &mut self.minibatch;
                to.observations.clear();
                to.actions.clear();
                to.taught.actions.clear();
                for row in rows {
                    to.observations.extend_from_slice(&normalised[row * LENGTH..][..LENGTH]);
                    to.actions.extend_from_slice(&batch.actions[row * 2..][..2]);
                    to.taught.actions.extend(batch.taught.get(row * 2..row * 2 + 2).into_iter().flatten());
                }
                let picked = |all: &[f64], to: &mut Vec<f64>| {
                    to.clear();
                    to.extend(rows.iter().map(|row| all[*row]));
                };
                picked(&batch.log_densities, &mut to.log_densities);
                picked(&advantages, &mut to.advantages);
                to.returns.clear();
                to.returns.extend(rows.iter().map(|row| advantages[*row] + values[*row]));
                let report = self.networks.step(to, rate);
                self.check(&report)?;
                let [loss, count, value] = &mut self.losses;
                *loss += report.critic_loss;
                *count += 1.0;
                *value += report.mean_abs_value;
            }
        }
        self.driving = self.observations.folded(self.networks.actor());
        Ok(())
    }

    fn check(&self, report: &StepReport) -> Result<(), Error> {
        let at = self.networks.steps();
        if !(report.actor_loss.is_finite() && report.critic_loss.is_finite()) {
            let tensor =
                self.not_finite().map_or(String::new(), |name| format!("; tensor `{name}` is not finite"));
            return Err(Error::Value(format!("update {at}: the loss is not finite{tensor}")));
        }
        if report.mean_abs_value > DIVERGED {
            return Err(Error::Value(format!(
                "update {at}: the training diverges; the critic's mean |V| is {:.3e} deviations of the return; lower the learning rate",
                report.mean_abs_value
            )));
        }
        Ok(())
    }
}

impl Learner for Ppo {
    fn turn(&self) -> u64 {
        self.networks.options().horizon as u64
    }

    fn staggers(&self) -> bool {
        true
    }

    fn may_be_saved(&self) -> bool {
        self.batch.rewards.is_empty()
    }

    fn is_taught(&self, steps: u64) -> bool {
        let options = self.networks.options();
        // The steps of a batch are all taught, or none is.
        let done = steps / options.batch() as u64;
        imitation_weight(self.share(done), options.taught) > 0.0
    }

    fn begin(&mut self, slot: usize, _: &[f32; LENGTH]) {
        self.discounted[slot] = 0.0;
    }

    fn act(&mut self, _: usize, steps: u64, observation: &[f32; LENGTH]) -> [f32; 2] {
        if steps.is_multiple_of(self.turn()) {
            self.noise = Rng::new(self.seed, &steps.to_string(), "exploration");
        }
        let mut mean = [0.0; 2];
        self.driving.forward_one(observation, &mut self.memory, &mut mean);
        let deviations = self.networks.deviations();
        let action = [0, 1].map(|k| (f64::from(mean[k]) + deviations[k] * self.noise.normal()) as f32);
        let logs: Vec<f64> = deviations.iter().map(|x| x.ln()).collect();
        let precisions: Vec<f64> = deviations.iter().map(|x| x.recip()).collect();
        let log_density = log_density(&action, &mean, &logs, &precisions);
        self.drawn = Some(Drawn { observation: *observation, action, log_density });
        action_of(action, observation, self.networks.options().kept as f32)
    }

    fn learn(&mut self, step: &DrivenStep) -> Result<(), Error> {
        let Some(Drawn { observation, action, log_density }) = self.drawn.take() else { return Ok(()) };
        let (options, batch) = (self.networks.options(), &mut self.batch);
        let is_last = (batch.rewards.len() + 1).is_multiple_of(options.horizon);
        let size = options.batch();
        let discounted = &mut self.discounted[step.slot];
        *discounted = options.gamma * *discounted + f64::from(step.reward);
        batch.returns.push(*discounted);
        batch.observations.extend_from_slice(&observation);
        batch.actions.extend_from_slice(&action);
        batch.log_densities.push(log_density);
        batch.rewards.push(f64::from(step.reward));
        let aims = |action| aims_of(action, &observation, options.kept as f32);
        batch.taught.extend(step.taught.map(aims).into_iter().flatten());
        batch.after.push(if step.is_terminal {
            After::End
        } else if step.is_over || is_last {
            batch.cuts.extend_from_slice(step.next);
            After::Cut(batch.cuts.len() / LENGTH - 1)
        } else {
            After::Next
        });
        if batch.rewards.len() == size { self.update() } else { Ok(()) }
    }

    fn actor(&self) -> Network<f32> {
        self.driving.clone()
    }

    fn has_learnt(&self, _: u64) -> bool {
        self.networks.steps() > 0
    }

    fn updates(&self) -> u64 {
        self.networks.steps()
    }

    fn take_losses(&mut self) -> [f64; 2] {
        let [loss, count, value] = std::mem::take(&mut self.losses);
        [loss / count.max(1.0), value / count.max(1.0)]
    }

    fn not_finite(&self) -> Option<String> {
        let is_bad = |tensor: &NamedTensor<f32>| tensor.numbers.iter().any(|x| !x.is_finite());
        self.networks.tensors().into_iter().find(is_bad).map(|tensor| tensor.name)
    }

    fn tensors(&self) -> Vec<NamedTensor<'_, f32>> {
        self.networks.tensors()
    }

    fn record(&self) -> Value {
        json!(Record {
            updates: self.networks.steps(),
            observations: self.observations.clone(),
            returns: self.returns.clone(),
            discounted: self.discounted.clone(),
            losses: self.losses,
        })
    }

    fn restore(
        &mut self,
        tensors: &BTreeMap<String, Vec<f32>>,
        record: Value,
        steps: u64,
        _: &Path,
    ) -> Result<(), Error> {
        let record: Record =
            serde_json::from_value(record).map_err(|error| Error::Value(error.to_string()))?;
        let options = self.networks.options();
        let (batch, minibatches) = (options.batch() as u64, options.batch() / options.minibatch);
        let expected = (steps / batch).saturating_mul((options.epochs * minibatches) as u64);
        if !steps.is_multiple_of(batch) || record.updates != expected {
            return Err(Error::Value(format!(
                "its field `updates` is {} after {steps} steps; expected {expected} after whole batches of {batch}",
                record.updates
            )));
        }
        let numbers = record.discounted.iter().chain(&record.losses);
        let is_sound = record.observations.is_sound(LENGTH)
            && record.returns.is_sound(1)
            && record.discounted.len() == self.discounted.len()
            && numbers.into_iter().all(|x| x.is_finite());
        if !is_sound {
            return Err(Error::Value(
                "its normalisation holds numbers that no run of these options has".to_owned(),
            ));
        }
        self.networks.set_tensors(tensors, record.updates)?;
        let Record { observations, returns, discounted, losses, .. } = record;
        self.driving = observations.folded(self.networks.actor());
        (self.observations, self.returns) = (observations, returns);
        (self.discounted, self.losses) = (discounted, losses);
        Ok(())
    }

    fn is_finite(&self) -> bool {
        let Batch { observations, actions, .. } = &self.batch;
        observations.iter().chain(actions).all(|x| x.is_finite())
    }

    fn break_weight(&mut self, tensor: &str) {
        self.networks.break_weight(tensor);
        self.driving = self.observations.folded(self.networks.actor());
    }
}

/// Weight of the imitation after a share of the training.
fn imitation_weight(share: f64, taught: f64) -> f64 {
    if share < taught { 1.0 - share / taught } else { 0.0 }
}
