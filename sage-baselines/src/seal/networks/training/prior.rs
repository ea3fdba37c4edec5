//! Training of a skill prior by maximum likelihood of skills that are drawn from the windows' distributions.
//!
//! Skills are drawn anew for every batch. No gradient flows to the encoder.

use candle_core::{Device, Tensor};
use sage_backbones::{Error, parameters::Scope, training::CheckpointFile};
use sage_core::seed::Rng;
use serde::{Deserialize, Serialize};

use super::{
    epochs::{Batch, Epoch, LoopOptions, Task, Trained, check_rate, train},
    split::{Split, split},
};
use crate::seal::networks::{OBSERVATION, SKILL, SealOptions, SkillPrior, skill_windows::check_numbers};

/// Share of the roll-outs that are for validation.
const VALIDATION: f64 = 0.1;
/// Factor of the learning rate, once every [`DECAY_STEPS`] steps.
const DECAY: f64 = 0.999;
/// Steps between two changes of the learning rate.
const DECAY_STEPS: u64 = 250;

/// Encoded windows of driving.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PriorWindows {
    /// (n, [`SKILL`]): means of the skills.
    pub skills_mu: Vec<f32>,
    /// (n, [`SKILL`]): natural logarithms of their variances.
    pub skills_logvar: Vec<f32>,
    /// (n, [`OBSERVATION`]): the first observation of each window.
    pub observations: Vec<f32>,
    /// (n): the roll-out of each window. Training and validation share no roll-out.
    pub groups: Vec<u32>,
}

impl PriorWindows {
    /// *Errors*: [`Error::Mismatch`] if the lists belong to different numbers of windows, [`Error::NotFinite`] for a
    /// number that is not finite.
    pub fn check(&self) -> Result<(), Error> {
        let n = self.groups.len();
        check_numbers("means of skills", &self.skills_mu, n * SKILL)?;
        check_numbers("log variances of skills", &self.skills_logvar, n * SKILL)?;
        check_numbers("observations", &self.observations, n * OBSERVATION)
    }

    /// Skills drawn for some windows, and the windows' observations.
    fn draw(&self, windows: &[usize], rng: &mut Rng) -> candle_core::Result<[Tensor; 2]> {
        let mut skills = Vec::with_capacity(windows.len() * SKILL);
        let mut observations = Vec::with_capacity(windows.len() * OBSERVATION);
        for &window in windows {
            let own = window * SKILL..(window + 1) * SKILL;
            for (mu, logvar) in self.skills_mu[own.clone()].iter().zip(&self.skills_logvar[own]) {
                skills.push(mu + (0.5 * logvar).exp() * rng.normal() as f32);
            }
            observations.extend_from_slice(&self.observations[window * OBSERVATION..][..OBSERVATION]);
        }
        Ok([
            Tensor::from_vec(skills, (windows.len(), SKILL), &Device::Cpu)?,
            Tensor::from_vec(observations, (windows.len(), OBSERVATION), &Device::Cpu)?,
        ])
    }
}

/// Options of [`train_prior`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PriorOptions {
    /// Seed of the initial weights, of the split, of the order and of the draws.
    pub seed: u64,
    /// Width of the networks, 1 to 4096; 512 as published.
    pub hidden: usize,
    /// Maximum number of epochs.
    pub epochs: u32,
    /// Windows of a batch.
    pub batch: usize,
    /// Learning rate of the first step; it falls by 0.1 % every 250 steps.
    pub rate: f64,
    /// Epochs without an improvement after which the training ends, if any.
    pub patience: Option<u32>,
}

impl Default for PriorOptions {
    fn default() -> Self {
        let hidden = SealOptions::default().hidden;
        Self { seed: 0, hidden, epochs: 100, batch: 128, rate: 1e-3, patience: None }
    }
}

/// Results of an epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PriorRow {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Steps of the optimiser so far.
    pub steps: u64,
    /// Training: mean negative log-likelihood, nats.
    pub training: f64,
    /// Validation: the same, for draws that are the same in every epoch.
    pub validation: f64,
    /// Learning rate of the last step.
    pub rate: f64,
    /// Duration, seconds.
    pub seconds: f64,
}

/// Trains a prior; returns the tensors of [`SkillPrior::new`].
///
/// *Errors*: those of [`PriorWindows::check`]; [`Error::NothingToTrain`] for windows of fewer than two roll-outs;
/// [`Error::NotFinite`], [`Error::Option`]; [`Error::Format`] and [`Error::Io`] for the checkpoint.
pub fn train_prior(
    data: &PriorWindows,
    options: &PriorOptions,
    checkpoint: Option<&CheckpointFile>,
    on_epoch: &mut dyn FnMut(&PriorRow) -> bool,
) -> Result<Trained<PriorRow>, Error> {
    check_rate(options.rate)?;
    SealOptions { hidden: options.hidden }.check()?;
    data.check()?;
    let split = split(&data.groups, VALIDATION, options.seed, PriorTask::NAME)?;
    let PriorOptions { seed, epochs, batch, patience, .. } = *options;
    let mut task = PriorTask { data, options, split };
    train(&mut task, &LoopOptions { seed, epochs, batch, patience }, checkpoint, on_epoch)
}

struct PriorTask<'d> {
    data: &'d PriorWindows,
    options: &'d PriorOptions,
    split: Split,
}

impl Task for PriorTask<'_> {
    type Network = SkillPrior;
    type Row = PriorRow;
    const NAME: &'static str = "skill prior";

    fn network(&self, scope: &Scope) -> candle_core::Result<SkillPrior> {
        SkillPrior::new(scope, self.options.hidden)
    }

    fn examples(&self) -> &[usize] {
        &self.split.training
    }

    fn rate(&self, _: &[PriorRow], steps: u64) -> f64 {
        self.options.rate * DECAY.powf((steps / DECAY_STEPS) as f64)
    }

    fn loss(&self, network: &SkillPrior, batch: &Batch) -> candle_core::Result<Tensor> {
        let purpose = format!("draws of epoch {}, batch {}", batch.epoch, batch.number);
        let mut rng = Rng::new(self.options.seed, Self::NAME, &purpose);
        let [skills, observations] = self.data.draw(batch.examples, &mut rng)?;
        network.log_prob(&skills, &observations)?.sum_all()?.neg()
    }

    fn row(&self, network: &SkillPrior, epoch: &Epoch) -> Result<PriorRow, Error> {
        let mut rng = Rng::new(self.options.seed, Self::NAME, "draws of the validation");
        let mut total = 0.0;
        for chunk in self.split.validation.chunks(self.options.batch) {
            let [skills, observations] = self.data.draw(chunk, &mut rng)?;
            let log_probs = network.log_prob(&skills, &observations)?.to_vec1::<f32>()?;
            total -= log_probs.into_iter().map(f64::from).sum::<f64>();
        }
        Ok(PriorRow {
            epoch: epoch.number,
            steps: epoch.steps,
            training: epoch.training,
            validation: total / self.split.validation.len() as f64,
            rate: epoch.rate,
            seconds: epoch.clock.elapsed().as_secs_f64(),
        })
    }

    fn validation(row: &PriorRow) -> f64 {
        row.validation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seal::networks::training::epochs::assert_resumes;

    /// Narrow distributions whose means are given by the observation.
    fn windows(count: usize) -> PriorWindows {
        let mut windows = PriorWindows::default();
        for k in 0..count {
            let mut rng = Rng::new(k as u64, "window", "test");
            let observation: Vec<f32> = (0..OBSERVATION).map(|_| rng.unit() as f32).collect();
            windows.skills_mu.extend(observation[..SKILL].iter().map(|x| 2.0 * x + 1.0));
            windows.skills_logvar.extend([-4.0; SKILL]);
            windows.observations.extend(observation);
            windows.groups.push(k as u32 / 5);
        }
        windows
    }

    #[test]
    fn a_prior_is_learned() {
        let options = PriorOptions { hidden: 32, epochs: 20, batch: 32, rate: 3e-3, ..Default::default() };
        let trained = train_prior(&windows(1000), &options, None, &mut |_| false).unwrap();
        // Without the observation: means uniform over 2, so a standard deviation of 0.59 in each of 8 columns, 7.1 nats.
        let best = &trained.rows[trained.best_epoch as usize - 1];
        assert!(best.validation < 3.5, "{best:?}");
        let prior = SkillPrior::new(&Scope::of(&trained.parameters), 32).unwrap();
        let mut observation = [0.5; OBSERVATION];
        observation[2] = 0.9;
        let skill = prior.sample(&[0.0; SKILL], &observation).unwrap();
        assert!((skill[2] - 2.8).abs() < 0.5 && (skill[3] - 2.0).abs() < 0.5, "{skill:?}");
    }

    #[test]
    fn a_stopped_training_resumes_with_the_same_bits() {
        let options = PriorOptions { hidden: 8, epochs: 4, batch: 16, ..Default::default() };
        let windows = windows(100);
        assert_resumes(4, |checkpoint, on_epoch| {
            train_prior(&windows, &options, checkpoint, on_epoch).unwrap()
        });
    }

    #[test]
    fn checkpoints_of_other_runs_and_networks_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("checkpoint.safetensors");
        let train = |identity: &str, hidden| {
            let header = sage_backbones::parameters::Header::default();
            let checkpoint = CheckpointFile { file: &file, identity: serde_json::json!(identity), header };
            let options = PriorOptions { hidden, epochs: 1, batch: 16, ..Default::default() };
            train_prior(&windows(40), &options, Some(&checkpoint), &mut |_| false)
        };
        train("first", 8).unwrap();
        assert!(train("second", 8).unwrap_err().to_string().contains("another folder"));
        let error = train("first", 4).unwrap_err().to_string();
        assert!(error.contains("[8]") && error.contains("remove it to start again"), "{error}");
        std::fs::write(&file, b"no weights").unwrap();
        assert!(train("first", 8).unwrap_err().to_string().contains("remove it to start again"));
    }

    #[test]
    fn lists_of_different_lengths_are_refused() {
        let mut windows = windows(20);
        windows.skills_logvar.pop();
        let error = train_prior(&windows, &PriorOptions::default(), None, &mut |_| false).unwrap_err();
        assert_eq!(error.to_string(), "log variances of skills: 159 numbers, expected 160");
    }
}
