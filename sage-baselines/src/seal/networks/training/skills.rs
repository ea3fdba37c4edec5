//! Training of skills: a variational auto-encoder of windows of driving.
//!
//! The loss is the sum of squared errors of the actions plus a small share of the Kullback–Leibler divergence of the
//! skill's distribution from the standard normal one. The decoder sees the recorded observation of each step.

use candle_core::{Device, Tensor};
use sage_backbones::{Error, parameters::Scope, training::CheckpointFile};
use sage_core::seed::Rng;
use serde::{Deserialize, Serialize};

use super::{
    epochs::{Batch, Epoch, LoopOptions, Task, Trained, check_rate, train},
    plateau,
    split::{Split, split},
};
use crate::seal::networks::{ACTION, SKILL, SkillDecoder, SkillEncoder, SkillWindows, WINDOW};

/// Share of the roll-outs that are for validation.
const VALIDATION: f64 = 0.1;

/// Options of [`train_skills`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SkillOptions {
    /// Seed of the initial weights, of the split, of the order and of the noise.
    pub seed: u64,
    /// Maximum number of epochs.
    pub epochs: u32,
    /// Windows of a batch, at least 2.
    pub batch: usize,
    /// Learning rate of the first epoch; it is halved on a plateau of the validation.
    pub rate: f64,
    /// Weight of the divergence in the loss, ≥ 0.
    pub divergence: f64,
    /// Epochs without an improvement after which the rate is halved.
    pub plateau: u32,
    /// Epochs after a change of the rate that do not count as a plateau.
    pub cooldown: u32,
    /// Epochs without an improvement after which the training ends, if any.
    pub patience: Option<u32>,
}

impl Default for SkillOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            epochs: 100,
            batch: 128,
            rate: 1e-4,
            divergence: 1e-8,
            plateau: 10,
            cooldown: 10,
            patience: None,
        }
    }
}

/// Results of an epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SkillRow {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Steps of the optimiser so far.
    pub steps: u64,
    /// Mean training loss of a window.
    pub training: f64,
    /// Validation: mean over windows of the sum of squared action errors, with the mean skill and running statistics.
    pub validation: f64,
    /// Learning rate.
    pub rate: f64,
    /// Duration, seconds.
    pub seconds: f64,
    /// Validation: share of the variance of steering that is explained, R²; none if steering is constant.
    pub steering: Option<f64>,
    /// The same for throttle.
    pub throttle: Option<f64>,
}

/// Trains encoder and decoder; returns the tensors of [`SkillEncoder::new`] under `encoder` and those of
/// [`SkillDecoder::new`] under `decoder`.
///
/// *Errors*: those of [`SkillWindows::check`]; [`Error::NothingToTrain`] for windows of fewer than two roll-outs;
/// [`Error::NotFinite`], [`Error::Option`]; [`Error::Format`] and [`Error::Io`] for the checkpoint.
pub fn train_skills(
    data: &SkillWindows,
    options: &SkillOptions,
    checkpoint: Option<&CheckpointFile>,
    on_epoch: &mut dyn FnMut(&SkillRow) -> bool,
) -> Result<Trained<SkillRow>, Error> {
    check_rate(options.rate)?;
    if !(options.divergence >= 0.0 && options.divergence.is_finite()) {
        let problem = format!("the weight of the divergence is {}; expected 0 or more", options.divergence);
        return Err(Error::Option(problem));
    }
    data.check()?;
    let split = split(&data.groups, VALIDATION, options.seed, SkillTask::NAME)?;
    let SkillOptions { seed, epochs, batch, patience, .. } = *options;
    let mut task = SkillTask { data, options, split };
    train(&mut task, &LoopOptions { seed, epochs, batch, patience }, checkpoint, on_epoch)
}

struct SkillTask<'d> {
    data: &'d SkillWindows,
    options: &'d SkillOptions,
    split: Split,
}

/// Encoder and decoder.
struct Skills {
    encoder: SkillEncoder,
    decoder: SkillDecoder,
}

impl Skills {
    /// Actions of all steps with the same skill.
    fn decode(
        &self,
        observations: &Tensor,
        skills: &Tensor,
        is_training: bool,
    ) -> candle_core::Result<Tensor> {
        self.decoder.forward(observations, &Tensor::cat(&[skills; WINDOW], 0)?, is_training)
    }
}

impl Task for SkillTask<'_> {
    type Network = Skills;
    type Row = SkillRow;
    const NAME: &'static str = "skills";

    fn network(&self, scope: &Scope) -> candle_core::Result<Skills> {
        Ok(Skills {
            encoder: SkillEncoder::new(&scope.at("encoder"))?,
            decoder: SkillDecoder::new(&scope.at("decoder"))?,
        })
    }

    fn examples(&self) -> &[usize] {
        &self.split.training
    }

    fn rate(&self, rows: &[SkillRow], _: u64) -> f64 {
        let SkillOptions { rate, plateau, cooldown, .. } = *self.options;
        plateau::rate(rate, plateau, cooldown, rows.iter().map(|row| row.validation))
    }

    fn loss(&self, network: &Skills, batch: &Batch) -> candle_core::Result<Tensor> {
        let [observations, actions] = self.data.steps(batch.examples)?;
        let [mu, logvar] = network.encoder.posterior(&observations, &actions, true)?;
        let purpose = format!("noise of epoch {}, batch {}", batch.epoch, batch.number);
        let mut rng = Rng::new(self.options.seed, Self::NAME, &purpose);
        let noise: Vec<f32> = (0..batch.examples.len() * SKILL).map(|_| rng.normal() as f32).collect();
        let noise = Tensor::from_vec(noise, mu.shape(), &Device::Cpu)?;
        let skills = (&mu + ((&logvar * 0.5)?.exp()? * noise)?)?;
        let errors = (network.decode(&observations, &skills, true)? - actions)?.sqr()?.sum_all()?;
        // Divergence: ½ Σ (μ² + σ² − 1 − ln σ²).
        let divergence = (((mu.sqr()? + logvar.exp()?)? - &logvar)? - 1.0)?.sum_all()?;
        errors + (divergence * (0.5 * self.options.divergence))?
    }

    fn row(&self, network: &Skills, epoch: &Epoch) -> Result<SkillRow, Error> {
        let [mut errors, mut sums, mut squares] = [[0.0; ACTION]; 3];
        for chunk in self.split.validation.chunks(self.options.batch) {
            let [observations, actions] = self.data.steps(chunk)?;
            let [mu, _] = network.encoder.posterior(&observations, &actions, false)?;
            let decoded = network.decode(&observations, &mu, false)?.to_vec2::<f32>()?;
            for (decoded, action) in decoded.into_iter().zip(actions.to_vec2::<f32>()?) {
                for k in 0..ACTION {
                    let [decoded, action] = [decoded[k], action[k]].map(f64::from);
                    errors[k] += (decoded - action) * (decoded - action);
                    sums[k] += action;
                    squares[k] += action * action;
                }
            }
        }
        let windows = self.split.validation.len() as f64;
        let explained = |k: usize| {
            let deviation = squares[k] - sums[k] * sums[k] / (windows * WINDOW as f64);
            // What is left of equal actions is a rounding error.
            (deviation > 1e-9 * squares[k]).then(|| 1.0 - errors[k] / deviation)
        };
        Ok(SkillRow {
            epoch: epoch.number,
            steps: epoch.steps,
            training: epoch.training,
            validation: errors.iter().sum::<f64>() / windows,
            rate: epoch.rate,
            seconds: epoch.clock.elapsed().as_secs_f64(),
            steering: explained(0),
            throttle: explained(1),
        })
    }

    fn validation(row: &SkillRow) -> f64 {
        row.validation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seal::networks::{OBSERVATION, training::epochs::assert_resumes};

    /// Windows whose throttle follows the observation, and whose steering is an intention that no observation shows.
    fn windows(count: usize) -> SkillWindows {
        let mut windows = SkillWindows::default();
        for k in 0..count {
            let mut rng = Rng::new(k as u64, "window", "test");
            let steering = rng.uniform(-0.8, 0.8) as f32;
            for _ in 0..WINDOW {
                let observation: Vec<f32> = (0..OBSERVATION).map(|_| rng.unit() as f32).collect();
                windows.actions.extend([steering, (3.0 * (observation[3] - observation[8])).tanh()]);
                windows.observations.extend(observation);
            }
            windows.groups.push(k as u32 / 3);
        }
        windows
    }

    #[test]
    fn skills_explain_what_observations_do_not_show() {
        let options = SkillOptions { epochs: 12, batch: 32, rate: 4e-3, ..Default::default() };
        let windows = windows(480);
        let trained = train_skills(&windows, &options, None, &mut |_| false).unwrap();
        let best = &trained.rows[trained.best_epoch as usize - 1];
        assert!(best.steering > Some(0.7) && best.throttle > Some(0.5), "{best:?}");
        let scope = Scope::of(&trained.parameters);
        let encoder = SkillEncoder::new(&scope.at("encoder")).unwrap();
        assert_eq!(encoder.encode(&windows).unwrap().len(), 480);
        let constant = |row: &SkillRow| row.steering.is_none();
        let still = SkillWindows { actions: vec![0.1; windows.actions.len()], ..windows };
        let options = SkillOptions { epochs: 1, ..options };
        assert!(constant(&train_skills(&still, &options, None, &mut |_| false).unwrap().rows[0]));
    }

    #[test]
    fn a_stopped_training_resumes_with_the_same_bits() {
        let options = SkillOptions { epochs: 3, batch: 16, rate: 1e-3, plateau: 0, ..Default::default() };
        let windows = windows(49);
        assert_resumes(3, |checkpoint, on_epoch| {
            train_skills(&windows, &options, checkpoint, on_epoch).unwrap()
        });
    }
}
