//! The loop of all trainings here: shuffled batches, a validation after each epoch, the best epoch's weights, an early
//! stop, and a checkpoint from which a stopped training resumes with the same bits.

use std::time::Instant;

use candle_core::Tensor;
use sage_backbones::{
    Error, Parameters,
    nn::{AdamW, is_running},
    parameters::{ParameterSpec, Scope},
    training::CheckpointFile,
};
use sage_core::seed::Rng;
use serde::{Serialize, de::DeserializeOwned};

use crate::network_optimiser::{Optimiser, adam};

/// Prefix of the best epoch's weights in a checkpoint.
const BEST: &str = "best/";

/// Result of a training.
#[derive(Clone, Debug)]
pub struct Trained<Row> {
    /// Weights of the epoch with the lowest validation loss.
    pub parameters: Parameters,
    /// Results of all epochs.
    pub rows: Vec<Row>,
    /// The epoch of `parameters`, from 1.
    pub best_epoch: u32,
    /// Whether the training was stopped by its caller and has epochs left.
    pub is_stopped: bool,
}

/// What differs between the trainings.
pub(super) trait Task {
    /// The network.
    type Network;
    /// Results of an epoch.
    type Row: Clone + Serialize + DeserializeOwned;
    /// Name of the network in errors and of its random numbers.
    const NAME: &'static str;

    /// The network of given tensors.
    fn network(&self, scope: &Scope) -> candle_core::Result<Self::Network>;

    /// Indices of the training examples.
    fn examples(&self) -> &[usize];

    /// Called before the batches of an epoch, numbered from 1.
    fn begin_epoch(&mut self, _epoch: u32) {}

    /// Learning rate of the next step, after finished epochs and `steps` steps in total.
    fn rate(&self, rows: &[Self::Row], steps: u64) -> f64;

    /// Loss of a batch: the sum over its examples.
    fn loss(&self, network: &Self::Network, batch: &Batch) -> candle_core::Result<Tensor>;

    /// Validates the network and returns the results of an epoch.
    fn row(&self, network: &Self::Network, epoch: &Epoch) -> Result<Self::Row, Error>;

    /// Validation loss in the results of an epoch.
    fn validation(row: &Self::Row) -> f64;
}

/// A batch of examples.
pub(super) struct Batch<'e> {
    /// Number of the epoch, from 1.
    pub(super) epoch: u32,
    /// Number of the batch in its epoch, from 0.
    pub(super) number: usize,
    /// Number of batches in the epoch.
    pub(super) count: usize,
    /// Indices of the examples.
    pub(super) examples: &'e [usize],
}

/// The training part of an epoch.
pub(super) struct Epoch {
    /// Its number, from 1.
    pub(super) number: u32,
    /// Steps of the optimiser so far.
    pub(super) steps: u64,
    /// Mean loss per example.
    pub(super) training: f64,
    /// Learning rate of the last step.
    pub(super) rate: f64,
    /// Start of the epoch.
    pub(super) clock: Instant,
}

/// Options of the loop.
pub(super) struct LoopOptions {
    pub(super) seed: u64,
    pub(super) epochs: u32,
    pub(super) batch: usize,
    /// Epochs without an improvement after which the training ends.
    pub(super) patience: Option<u32>,
}

impl LoopOptions {
    fn check(&self) -> Result<(), Error> {
        if self.epochs == 0 || self.batch < 2 {
            let Self { epochs, batch, .. } = self;
            return Err(Error::Option(format!(
                "{epochs} epochs with batches of {batch}; expected at least 1 and 2"
            )));
        }
        Ok(())
    }

    /// Whether a training with these validation losses has ended.
    fn has_ended(&self, validations: &[f64]) -> bool {
        let without = validations.len().saturating_sub(1 + best(validations));
        validations.len() >= self.epochs as usize
            || self.patience.is_some_and(|patience| without >= (patience as usize).max(1))
    }
}

/// Whether a learning rate is one.
pub(super) fn check_rate(rate: f64) -> Result<(), Error> {
    if rate > 0.0 && rate.is_finite() {
        return Ok(());
    }
    Err(Error::Option(format!("the learning rate is {rate}; expected a positive number")))
}

/// Index of the lowest validation loss, the first of equals.
fn best(validations: &[f64]) -> usize {
    (1..validations.len()).fold(0, |best, k| if validations[k] < validations[best] { k } else { best })
}

/// State after an epoch.
struct State<Row> {
    optimiser: Optimiser,
    best: Parameters,
    rows: Vec<Row>,
}

/// Trains until the last epoch, the early stop, or until `on_epoch` returns true after an epoch.
///
/// *Errors*: [`Error::Option`], [`Error::NothingToTrain`], [`Error::NotFinite`]; [`Error::Format`] for a checkpoint
/// that is damaged or of another run; [`Error::Io`].
pub(super) fn train<T: Task>(
    task: &mut T,
    options: &LoopOptions,
    checkpoint: Option<&CheckpointFile>,
    on_epoch: &mut dyn FnMut(&T::Row) -> bool,
) -> Result<Trained<T::Row>, Error> {
    options.check()?;
    if task.examples().len() < 2 {
        let problem = format!("{}: {} training examples", T::NAME, task.examples().len());
        return Err(Error::NothingToTrain(problem));
    }
    let specs = Scope::list(|scope| task.network(scope))?;
    let resumed = checkpoint.map(|checkpoint| resume(checkpoint, &specs)).transpose()?.flatten();
    let mut state = match resumed {
        Some(state) => state,
        None => {
            let start = Parameters::start(&specs, options.seed)?;
            let optimiser = optimiser(&start, AdamW::new(adam()))?;
            State { optimiser, best: start, rows: Vec::new() }
        }
    };
    let traced = task.network(&Scope::of(state.optimiser.parameters()))?;
    let frozen = task.network(&Scope::of(&state.optimiser.parameters().detached()))?;
    let mut is_stopped = false;
    loop {
        let validations: Vec<f64> = state.rows.iter().map(T::validation).collect();
        let has_ended = options.has_ended(&validations);
        if has_ended || is_stopped {
            let best_epoch = best(&validations) as u32 + 1;
            let State { best: parameters, rows, .. } = state;
            return Ok(Trained { parameters, rows, best_epoch, is_stopped: !has_ended });
        }
        let epoch = epoch(task, &traced, &mut state, options)?;
        let row = task.row(&frozen, &epoch)?;
        let validation = T::validation(&row);
        if !validation.is_finite() {
            let problem = format!("{}, epoch {}: the validation loss is {validation}", T::NAME, epoch.number);
            return Err(Error::NotFinite(problem));
        }
        if validations.iter().all(|earlier| validation < *earlier) {
            state.best = state.optimiser.weights()?;
        }
        state.rows.push(row.clone());
        if let Some(checkpoint) = checkpoint {
            save(checkpoint, &state)?;
        }
        is_stopped = on_epoch(&row);
    }
}

/// One pass over the training examples in a random order.
fn epoch<T: Task>(
    task: &mut T,
    network: &T::Network,
    state: &mut State<T::Row>,
    options: &LoopOptions,
) -> Result<Epoch, Error> {
    let clock = Instant::now();
    let number = state.rows.len() as u32 + 1;
    task.begin_epoch(number);
    let mut order = task.examples().to_vec();
    Rng::new(options.seed, T::NAME, &format!("order of epoch {number}")).shuffle(&mut order);
    // A batch norm cannot train on a single example, which the last batch may hold.
    let batches: Vec<&[usize]> = order.chunks(options.batch).filter(|batch| batch.len() > 1).collect();
    let (mut total, mut rate) = (0.0, 0.0);
    for (k, examples) in batches.iter().enumerate() {
        rate = task.rate(&state.rows, state.optimiser.adam().steps);
        let batch = Batch { epoch: number, number: k, count: batches.len(), examples };
        let loss = task.loss(network, &batch)?;
        let what = || format!("{}, epoch {number}, batch {}", T::NAME, k + 1);
        total += state.optimiser.step(&loss, rate, what)?;
    }
    let seen: usize = batches.iter().map(|batch| batch.len()).sum();
    let steps = state.optimiser.adam().steps;
    Ok(Epoch { number, steps, training: total / seen as f64, rate, clock })
}

/// Writes the weights, the best epoch's weights and the optimiser's state.
fn save<Row: Clone + Serialize + DeserializeOwned>(
    checkpoint: &CheckpointFile,
    state: &State<Row>,
) -> Result<(), Error> {
    let mut all = state.optimiser.weights()?;
    for (name, tensor) in state.best.iter() {
        all.insert(format!("{BEST}{name}"), tensor.clone());
    }
    checkpoint.write(&state.rows, &all, state.optimiser.adam())
}

/// Trains all parameters but the running statistics of batch norms, which the network updates itself.
fn optimiser(start: &Parameters, adam: AdamW) -> Result<Optimiser, Error> {
    Optimiser::new(start, adam, |name| !is_running(name))
}

/// The state in a checkpoint, if there is one.
fn resume<Row: Serialize + DeserializeOwned>(
    checkpoint: &CheckpointFile,
    specs: &[ParameterSpec],
) -> Result<Option<State<Row>>, Error> {
    let Some((rows, all, adam)) = checkpoint.read(adam())? else { return Ok(None) };
    let (mut weights, mut best) = (Parameters::default(), Parameters::default());
    for (name, tensor) in all.iter() {
        match name.strip_prefix(BEST) {
            Some(name) => best.insert(name, tensor.clone()),
            None => weights.insert(name, tensor.clone()),
        }
    }
    for parameters in [&weights, &best] {
        if let Some(problem) = parameters.mismatches(specs).first() {
            return Err(checkpoint.unfit(problem));
        }
    }
    Ok(Some(State { optimiser: optimiser(&weights, adam)?, best, rows }))
}

/// Asserts that equal trainings give equal bits, also when stopped after any epoch and resumed. `train` runs a training
/// of `epochs` epochs.
#[cfg(test)]
pub(super) fn assert_resumes<Row>(
    epochs: u32,
    train: impl Fn(Option<&CheckpointFile>, &mut dyn FnMut(&Row) -> bool) -> Trained<Row>,
) {
    let hash = |trained: &Trained<Row>| trained.parameters.hash().unwrap();
    let whole = train(None, &mut |_| false);
    assert_eq!(hash(&whole), hash(&train(None, &mut |_| false)));
    assert!(!whole.is_stopped && whole.rows.len() == epochs as usize);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("checkpoint.safetensors");
    let header = sage_backbones::parameters::Header::default();
    let checkpoint = CheckpointFile { file: &file, identity: serde_json::json!("one run"), header };
    for last in 1..epochs {
        let mut epoch = 0;
        let stopped = train(Some(&checkpoint), &mut |_| {
            epoch += 1;
            epoch == last
        });
        assert!(stopped.is_stopped && stopped.rows.len() == last as usize);
        let resumed = train(Some(&checkpoint), &mut |_| false);
        assert_eq!((hash(&resumed), resumed.best_epoch), (hash(&whole), whole.best_epoch));
        // A finished training returns its result again.
        assert_eq!(hash(&train(Some(&checkpoint), &mut |_| panic!("no epoch is left"))), hash(&whole));
        std::fs::remove_file(&file).unwrap();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trainings_end_after_the_last_epoch_or_the_patience() {
        let options = |patience| LoopOptions { seed: 0, epochs: 4, batch: 2, patience };
        assert!(!options(None).has_ended(&[1.0, 2.0, 2.0]) && options(None).has_ended(&[4.0, 3.0, 2.0, 1.0]));
        assert!(
            !options(Some(2)).has_ended(&[2.0, 1.0, 1.0]) && options(Some(2)).has_ended(&[1.0, 1.0, 2.0])
        );
        assert!(!options(Some(0)).has_ended(&[]) && !options(Some(0)).has_ended(&[1.0]));
        assert!(LoopOptions { batch: 1, ..options(None) }.check().is_err());
        assert!([0.0, -1.0, f64::NAN, f64::INFINITY].into_iter().all(|rate| check_rate(rate).is_err()));
    }
}
