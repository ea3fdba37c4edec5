//! Training of the criticality network on roll-outs of candidates.
//!
//! The loss is the squared error, summed over a batch and both outputs. Every batch also holds auxiliary examples: other
//! vehicles of the roll-outs. Their loss is scaled by the ratio of the two numbers of examples.

use candle_core::{Device, Tensor};
use sage_backbones::{Error, nn::Groups, parameters::Scope, training::CheckpointFile};
use sage_core::seed::Rng;
use serde::{Deserialize, Serialize};

use super::{
    epochs::{Batch, Epoch, LoopOptions, Task, Trained, check_rate, train},
    split::split,
};
use crate::seal::networks::CriticalityNetwork;

/// Share of the scenes that are for validation.
const VALIDATION: f64 = 0.15;

/// Examples of the training.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CriticalityData {
    /// The examples.
    pub examples: Vec<CriticalityExample>,
}

/// One vehicle of one roll-out.
#[derive(Clone, Debug, PartialEq)]
pub struct CriticalityExample {
    /// Number of the scene. Training and validation share no scene.
    pub scene: u32,
    /// The ego's path relative to the vehicle, see [`crate::seal::networks::relative_path`].
    pub sequence: Vec<[f32; 3]>,
    /// What the roll-out showed, each in [0, 1]: collision, deviation of the ego.
    pub targets: [f32; 2],
    /// Whether the vehicle is another one than the adversary. Such examples are in no validation.
    pub is_auxiliary: bool,
}

/// Options of [`train_criticality`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CriticalityOptions {
    /// Seed of the initial weights, of the split and of the order.
    pub seed: u64,
    /// Maximum number of epochs.
    pub epochs: u32,
    /// Examples of a batch.
    pub batch: usize,
    /// Maximum number of auxiliary examples of a batch.
    pub auxiliaries: usize,
    /// Learning rate.
    pub rate: f64,
    /// Epochs without an improvement of the validation after which the training ends.
    pub patience: u32,
}

impl Default for CriticalityOptions {
    fn default() -> Self {
        Self { seed: 0, epochs: 50, batch: 64, auxiliaries: 64, rate: 1e-3, patience: 8 }
    }
}

/// Results of an epoch.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CriticalityRow {
    /// Number of the epoch, from 1.
    pub epoch: u32,
    /// Steps of the optimiser so far.
    pub steps: u64,
    /// Training loss for each example that is not auxiliary; the loss of auxiliary ones is included.
    pub training: f64,
    /// Validation: mean squared error of both outputs.
    pub validation: f64,
    /// Learning rate.
    pub rate: f64,
    /// Duration, seconds.
    pub seconds: f64,
    /// Validation: mean squared error of the collision score.
    pub collision: f64,
    /// Validation: mean squared error of the deviation score.
    pub deviation: f64,
}

/// Trains the criticality network; returns the tensors of [`CriticalityNetwork::new`].
///
/// *Errors*: [`Error::NothingToTrain`] for examples of fewer than two scenes, or if either part of the split has only
/// auxiliary ones; [`Error::NotFinite`], [`Error::Mismatch`] for a bad example, with its number; [`Error::Option`];
/// [`Error::Format`] and [`Error::Io`] for the checkpoint.
pub fn train_criticality(
    data: &CriticalityData,
    options: &CriticalityOptions,
    checkpoint: Option<&CheckpointFile>,
    on_epoch: &mut dyn FnMut(&CriticalityRow) -> bool,
) -> Result<Trained<CriticalityRow>, Error> {
    check_rate(options.rate)?;
    let mut task = CriticalityTask::new(data, options)?;
    let CriticalityOptions { seed, epochs, batch, patience, .. } = *options;
    train(&mut task, &LoopOptions { seed, epochs, batch, patience: Some(patience) }, checkpoint, on_epoch)
}

struct CriticalityTask<'d> {
    data: &'d CriticalityData,
    options: &'d CriticalityOptions,
    training: Vec<usize>,
    auxiliaries: Vec<usize>,
    validation: Vec<usize>,
    /// The auxiliary examples in the order of the epoch.
    order: Vec<usize>,
}

impl<'d> CriticalityTask<'d> {
    fn new(data: &'d CriticalityData, options: &'d CriticalityOptions) -> Result<Self, Error> {
        let examples = &data.examples;
        for (k, example) in examples.iter().enumerate() {
            if example.sequence.is_empty() {
                return Err(Error::Mismatch(format!("example {k}: its sequence has no frames")));
            }
            let mut numbers = example.sequence.as_flattened().iter().chain(&example.targets);
            if let Some(bad) = numbers.find(|x| !x.is_finite()) {
                return Err(Error::NotFinite(format!("example {k} holds {bad}")));
            }
        }
        let scenes: Vec<u32> = examples.iter().map(|example| example.scene).collect();
        let parts = split(&scenes, VALIDATION, options.seed, Self::NAME)?;
        let is_auxiliary = |index: &usize| examples[*index].is_auxiliary;
        let (auxiliaries, training) = parts.training.into_iter().partition(is_auxiliary);
        let (_, validation): (Vec<usize>, Vec<usize>) = parts.validation.into_iter().partition(is_auxiliary);
        if validation.is_empty() {
            let problem = format!("{}: all validation examples are auxiliary", Self::NAME);
            return Err(Error::NothingToTrain(problem));
        }
        Ok(Self { data, options, training, auxiliaries, validation, order: Vec::new() })
    }

    /// The auxiliary examples of a batch: equal shares of as many as the option allows.
    fn share(&self, batch: &Batch) -> &[usize] {
        let used = self.order.len().min(self.options.auxiliaries.saturating_mul(batch.count));
        let bound = |k: usize| k * used / batch.count.max(1);
        &self.order[bound(batch.number)..bound(batch.number + 1)]
    }

    /// Scores and targets.
    ///
    /// *Shapes*: results (examples, 2).
    fn scores(
        &self,
        network: &CriticalityNetwork,
        examples: impl Iterator<Item = usize> + Clone,
    ) -> candle_core::Result<[Tensor; 2]> {
        let chosen = || examples.clone().map(|index| &self.data.examples[index]);
        let groups = Groups::of_lengths(chosen().map(|example| example.sequence.len()));
        let mut rows = Vec::with_capacity(3 * groups.rows());
        chosen().for_each(|example| rows.extend_from_slice(example.sequence.as_flattened()));
        let rows = Tensor::from_vec(rows, (groups.rows(), 3), &Device::Cpu)?;
        let targets: Vec<f32> = chosen().flat_map(|example| example.targets).collect();
        let targets = Tensor::from_vec(targets, (groups.len(), 2), &Device::Cpu)?;
        Ok([network.forward_rows(&rows, &groups)?, targets])
    }
}

impl Task for CriticalityTask<'_> {
    type Network = CriticalityNetwork;
    type Row = CriticalityRow;
    const NAME: &'static str = "criticality network";

    fn network(&self, scope: &Scope) -> candle_core::Result<CriticalityNetwork> {
        CriticalityNetwork::new(scope)
    }

    fn examples(&self) -> &[usize] {
        &self.training
    }

    fn begin_epoch(&mut self, epoch: u32) {
        self.order.clone_from(&self.auxiliaries);
        let purpose = format!("auxiliaries of epoch {epoch}");
        Rng::new(self.options.seed, Self::NAME, &purpose).shuffle(&mut self.order);
    }

    fn rate(&self, _: &[CriticalityRow], _: u64) -> f64 {
        self.options.rate
    }

    fn loss(&self, network: &CriticalityNetwork, batch: &Batch) -> candle_core::Result<Tensor> {
        let share = self.share(batch);
        let [scores, targets] = self.scores(network, batch.examples.iter().chain(share).copied())?;
        let weight = batch.examples.len() as f32 / share.len().max(1) as f32;
        let mut weights = vec![1.0; batch.examples.len()];
        weights.resize(batch.examples.len() + share.len(), weight);
        let count = weights.len();
        let weights = Tensor::from_vec(weights, (count, 1), &Device::Cpu)?;
        (scores - targets)?.sqr()?.broadcast_mul(&weights)?.sum_all()
    }

    fn row(&self, network: &CriticalityNetwork, epoch: &Epoch) -> Result<CriticalityRow, Error> {
        let mut squares = [0.0; 2];
        for chunk in self.validation.chunks(self.options.batch) {
            let [scores, targets] = self.scores(network, chunk.iter().copied())?;
            for row in (scores - targets)?.to_vec2::<f32>()? {
                for (sum, error) in squares.iter_mut().zip(row) {
                    *sum += f64::from(error) * f64::from(error);
                }
            }
        }
        let [collision, deviation] = squares.map(|sum| sum / self.validation.len() as f64);
        Ok(CriticalityRow {
            epoch: epoch.number,
            steps: epoch.steps,
            training: epoch.training,
            validation: (collision + deviation) / 2.0,
            rate: epoch.rate,
            seconds: epoch.clock.elapsed().as_secs_f64(),
            collision,
            deviation,
        })
    }

    fn validation(row: &CriticalityRow) -> f64 {
        row.validation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seal::networks::training::epochs::assert_resumes;

    /// Straight passes at some distance, of which the scores are functions.
    fn data(count: u32) -> CriticalityData {
        let example = |k: u32| {
            let mut rng = Rng::new(u64::from(k), "example", "test");
            let (nearest, frames) = (rng.uniform(0.0, 20.0), 20 + rng.below(10));
            let at = |frame: usize| [frame as f32 - 10.0, nearest as f32, 1.0];
            CriticalityExample {
                scene: k / 4,
                sequence: (0..frames).map(at).collect(),
                targets: [(-nearest / 8.0).exp() as f32, if nearest < 6.0 { 0.9 } else { 0.1 }],
                is_auxiliary: k.is_multiple_of(3),
            }
        };
        CriticalityData { examples: (0..count).map(example).collect() }
    }

    #[test]
    fn scores_are_learned() {
        let options = CriticalityOptions { epochs: 25, batch: 16, ..Default::default() };
        let trained = train_criticality(&data(480), &options, None, &mut |_| false).unwrap();
        // The variance of the first target is 0.08, that of the second 0.13.
        let best = &trained.rows[trained.best_epoch as usize - 1];
        assert!(best.collision < 0.01 && best.deviation < 0.03, "{best:?}");
        let network = CriticalityNetwork::new(&Scope::of(&trained.parameters)).unwrap();
        let data = data(500);
        let scores = network.scores(&[data.examples[490].sequence.clone()]).unwrap()[0];
        assert!((scores[0] - f64::from(data.examples[490].targets[0])).abs() < 0.25);
    }

    #[test]
    fn a_stopped_training_resumes_with_the_same_bits() {
        let options = CriticalityOptions { epochs: 4, batch: 16, ..Default::default() };
        let data = data(120);
        assert_resumes(4, |checkpoint, on_epoch| {
            train_criticality(&data, &options, checkpoint, on_epoch).unwrap()
        });
    }

    #[test]
    fn batches_share_the_auxiliary_examples_and_bad_data_are_refused() {
        let (data, options) = (data(120), CriticalityOptions { auxiliaries: 3, ..Default::default() });
        let mut task = CriticalityTask::new(&data, &options).unwrap();
        task.begin_epoch(1);
        let share = |number, count| {
            let batch = Batch { epoch: 1, number, count, examples: &[] };
            task.share(&batch).to_vec()
        };
        assert_eq!((0..4).flat_map(|k| share(k, 4)).collect::<Vec<_>>(), task.order[..12]);
        let lengths: Vec<usize> = (0..30).map(|k| share(k, 30).len()).collect();
        assert_eq!(lengths.iter().sum::<usize>(), task.order.len());
        assert!(lengths.iter().all(|n| [1, 2].contains(n)));

        let refused = |change: fn(&mut CriticalityData)| {
            let mut data = data.clone();
            change(&mut data);
            train_criticality(&data, &options, None, &mut |_| false).unwrap_err().to_string()
        };
        assert_eq!(refused(|data| data.examples[3].targets[1] = f32::NAN), "example 3 holds NaN");
        assert!(refused(|data| data.examples[5].sequence.clear()).contains("example 5"));
        assert!(refused(|data| data.examples.truncate(3)).contains("groups"));
        assert!(
            refused(|data| data.examples.iter_mut().for_each(|e| e.is_auxiliary = true))
                .contains("auxiliary")
        );
    }
}
