//! Training of GOOSE's encoder by the gradient that the training of the actor passes on.
//!
//! Each step has three parts: [`EncoderTraining::encode`] the drives of a batch; compute the gradient of a loss with
//! respect to [`Encoded::hidden`] elsewhere; [`EncoderTraining::step`]. Equal inputs give equal bits at any number of
//! threads, also after a resumption from [`EncoderTraining::state`].

use candle_core::{DType, Device, Tensor};
use sage_backbones::{
    Error, Parameters,
    nn::{AdamW, Gru, Moments, Sequences},
    parameters::{ParameterSpec, Scope},
};

use super::{FEATURES, Features, HIDDEN};
use crate::network_optimiser::{Optimiser, adam};

/// Name of the network in errors.
const NAME: &str = "the encoder of GOOSE";
/// Prefixes of tensors of Adam's state: mean gradients and mean squared gradients.
const MOMENTS: [&str; 2] = ["m", "v"];

/// The encoder in training, with Adam: β 0.9 and 0.999, ε 1e-8, no weight decay.
pub struct EncoderTraining {
    optimiser: Optimiser,
    rate: f64,
    /// Its weights are the variables, so that its results have gradients.
    traced: Gru,
    /// Its weights share the storage of the variables.
    fixed: Gru,
    /// Number of changes of the weights.
    version: u64,
}

/// Encodings of a batch, with what a gradient needs.
pub struct Encoded {
    numbers: Vec<f32>,
    /// (n, [`HIDDEN`]), with its graph.
    hidden: Tensor,
    /// That of the weights.
    version: u64,
}

impl Encoded {
    /// The encodings, n × [`HIDDEN`], in the order in which the sequences were given.
    pub fn hidden(&self) -> &[f32] {
        &self.numbers
    }
}

fn network(scope: &Scope) -> candle_core::Result<Gru> {
    Gru::new(scope, FEATURES, HIDDEN)
}

impl EncoderTraining {
    /// An encoder of random weights; `rate` is the learning rate.
    ///
    /// *Errors*: [`Error::Option`] for a rate that is not above 0 and finite.
    pub fn new(seed: u64, rate: f64) -> Result<Self, Error> {
        if !(rate > 0.0 && rate.is_finite()) {
            return Err(Error::Option(format!("the rate of {NAME} is {rate}; expected a number above 0")));
        }
        let start = Parameters::start(&Scope::list(network)?, seed)?;
        Self::of(&start, AdamW::new(adam()), rate, 0)
    }

    fn of(weights: &Parameters, adam: AdamW, rate: f64, version: u64) -> Result<Self, Error> {
        let optimiser = Optimiser::new(weights, adam, |_| true)?;
        let traced = network(&Scope::of(optimiser.parameters()))?;
        let fixed = network(&Scope::of(&optimiser.parameters().detached()))?;
        Ok(Self { optimiser, rate, traced, fixed, version })
    }

    /// Encodes sequences, with what a gradient needs.
    ///
    /// *Errors*: [`Error::Mismatch`] for no sequence, and for a sequence without steps.
    pub fn encode(&self, sequences: &[&[Features]]) -> Result<Encoded, Error> {
        let hidden = self.traced.forward(Sequences::new(sequences)?)?;
        Ok(Encoded { numbers: hidden.flatten_all()?.to_vec1()?, hidden, version: self.version })
    }

    /// The numbers of [`EncoderTraining::encode`], without what a gradient needs.
    ///
    /// *Errors*: as [`EncoderTraining::encode`].
    pub fn encode_fixed(&self, sequences: &[&[Features]]) -> Result<Vec<f32>, Error> {
        Ok(self.fixed.forward(Sequences::new(sequences)?)?.flatten_all()?.to_vec1()?)
    }

    /// One step of Adam against `sum(gradient · hidden)`. `gradient` has the shape of [`Encoded::hidden`].
    ///
    /// *Errors*: [`Error::NotFinite`] for a gradient that is not finite, with its tensor; [`Error::Mismatch`] for a
    /// gradient of another size, and for encodings of weights that have changed since. Nothing has changed then.
    pub fn step(&mut self, encoded: &Encoded, gradient: &[f32]) -> Result<(), Error> {
        if encoded.version != self.version {
            return Err(Error::Mismatch(format!("{NAME}: the weights have changed since the encoding")));
        }
        let expected = encoded.numbers.len();
        if gradient.len() != expected {
            let found = gradient.len();
            return Err(Error::Mismatch(format!(
                "{NAME}: a gradient of {found} numbers; expected {expected}"
            )));
        }
        let what = || format!("{NAME}, step {}", self.optimiser.adam().steps + 1);
        if let Some(at) = gradient.iter().position(|x| !x.is_finite()) {
            let (row, bad) = (at / HIDDEN, gradient[at]);
            return Err(Error::NotFinite(format!(
                "{}: the gradient of the encoding `hidden` holds {bad} for sequence {row}",
                what()
            )));
        }
        let gradient = Tensor::from_slice(gradient, encoded.hidden.shape(), &Device::Cpu)?;
        let (loss, what) = ((&encoded.hidden * gradient)?.sum_all()?, what());
        self.optimiser.step(&loss, self.rate, || what.clone())?;
        self.version += 1;
        Ok(())
    }

    /// Copies of the weights: `weight_ih`, `weight_hh`, `bias_ih`, `bias_hh`.
    ///
    /// *Errors*: none on a CPU.
    pub fn weights(&self) -> Result<Parameters, Error> {
        self.optimiser.weights()
    }

    /// The weights with Adam's state (`m.weight_ih`, `v.weight_ih`, …), and the number of steps so far.
    ///
    /// *Errors*: none on a CPU.
    pub fn state(&self) -> Result<(Parameters, u64), Error> {
        let (mut state, adam) = (self.weights()?, self.optimiser.adam());
        for (name, tensor) in self.weights()?.iter() {
            let moments = adam.moments.get(name).map(|moments| [&moments.first, &moments.second]);
            for (k, prefix) in MOMENTS.iter().enumerate() {
                let moment = match moments {
                    Some(moments) => Tensor::from_slice(moments[k], tensor.shape(), &Device::Cpu)?,
                    None => tensor.zeros_like()?,
                };
                state.insert(format!("{prefix}.{name}"), moment);
            }
        }
        Ok((state, adam.steps))
    }

    /// Continues from the state of another training, with the rate of this one.
    ///
    /// *Errors*: [`Error::Weights`] with each tensor that is missing, of another shape or type, or not part of the
    /// state; nothing has changed then.
    pub fn set_state(&mut self, state: &Parameters, steps: u64) -> Result<(), Error> {
        let specs = Scope::list(network)?;
        let moments = MOMENTS.iter().flat_map(|prefix| {
            specs
                .iter()
                .map(move |spec| ParameterSpec { name: format!("{prefix}.{}", spec.name), ..spec.clone() })
        });
        let mut all: Vec<ParameterSpec> = specs.iter().cloned().chain(moments).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        let mut problems = state.mismatches(&all);
        let others = state.iter().filter(|(_, tensor)| tensor.dtype() != DType::F32);
        problems.extend(others.map(|(name, tensor)| {
            format!("tensor `{}` holds {:?}, expected F32", name.escape_debug(), tensor.dtype())
        }));
        if !problems.is_empty() {
            return Err(Error::Weights { what: format!("the state of {NAME}"), problems });
        }
        let numbers = |name: String| -> Result<Vec<f32>, Error> {
            let tensor =
                state.get(&name).ok_or_else(|| Error::Mismatch(format!("tensor `{name}` is missing")))?;
            Ok(tensor.flatten_all()?.to_vec1()?)
        };
        let mut adam = AdamW { steps, ..AdamW::new(adam()) };
        let mut weights = Parameters::default();
        for ParameterSpec { name, shape, .. } in &specs {
            let [first, second] = MOMENTS.map(|prefix| numbers(format!("{prefix}.{name}")));
            adam.moments.insert(name.clone(), Moments { first: first?, second: second? });
            weights.insert(name, Tensor::from_vec(numbers(name.clone())?, shape.as_slice(), &Device::Cpu)?);
        }
        *self = Self::of(&weights, adam, self.rate, self.version + 1)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::seed::Rng;

    fn drives(lengths: &[usize]) -> Vec<Vec<Features>> {
        let mut rng = Rng::new(2, "drives", "test");
        let mut drive =
            |steps: usize| (0..steps).map(|_| [(); FEATURES].map(|()| rng.normal() as f32)).collect();
        lengths.iter().map(|steps| drive(*steps)).collect()
    }

    fn slices(drives: &[Vec<Features>]) -> Vec<&[Features]> {
        drives.iter().map(Vec::as_slice).collect()
    }

    fn training() -> EncoderTraining {
        EncoderTraining::new(3, 1e-3).unwrap()
    }

    /// One step against half the squared encodings.
    fn step(training: &mut EncoderTraining, drives: &[Vec<Features>]) {
        let encoded = training.encode(&slices(drives)).unwrap();
        let gradient = encoded.hidden().to_vec();
        training.step(&encoded, &gradient).unwrap();
    }

    fn bits(training: &EncoderTraining) -> (String, u64) {
        let (state, steps) = training.state().unwrap();
        (state.hash().unwrap(), steps)
    }

    #[test]
    fn encodings_become_smaller_against_their_own_gradient() {
        let (mut training, drives) = (training(), drives(&[3, 19, 1, 7]));
        let size = |training: &EncoderTraining| -> f32 {
            training.encode_fixed(&slices(&drives)).unwrap().iter().map(|x| x * x).sum()
        };
        let before = size(&training);
        for _ in 0..50 {
            step(&mut training, &drives);
        }
        assert!(size(&training) < 0.2 * before, "{before} {}", size(&training));
    }

    #[test]
    fn both_encodings_are_equal_and_in_the_order_of_the_sequences() {
        let (mut training, drives) = (training(), drives(&[3, 19, 1, 7]));
        step(&mut training, &drives);
        let encoded = training.encode(&slices(&drives)).unwrap();
        assert_eq!(encoded.hidden().len(), 4 * HIDDEN);
        assert_eq!(encoded.hidden(), training.encode_fixed(&slices(&drives)).unwrap());
        for (row, drive) in encoded.hidden().chunks_exact(HIDDEN).zip(&drives) {
            let alone = training.encode_fixed(&[drive]).unwrap();
            assert!(row.iter().zip(alone).all(|(x, y)| (x - y).abs() < 1e-6));
        }
    }

    #[test]
    fn a_resumed_training_gives_the_same_bits() {
        let drives = drives(&[3, 19, 1, 7]);
        for before in [0, 2] {
            let mut training = training();
            (0..before).for_each(|_| step(&mut training, &drives));
            let (state, steps) = training.state().unwrap();
            let mut resumed = EncoderTraining::new(9, 1e-3).unwrap();
            resumed.set_state(&state, steps).unwrap();
            assert_eq!(bits(&resumed), bits(&training));
            for training in [&mut training, &mut resumed] {
                (0..3).for_each(|_| step(training, &drives));
            }
            assert_eq!(bits(&resumed), bits(&training));
            assert_eq!(bits(&resumed).1, before + 3);
        }
    }

    #[test]
    fn unfit_states_are_refused_by_name_and_change_nothing() {
        let (state, steps) = training().state().unwrap();
        let mut own = training();
        let mut refused = |state: &Parameters| {
            let before = bits(&own);
            let error = own.set_state(state, steps).unwrap_err();
            assert_eq!(bits(&own), before);
            error.to_string()
        };
        let without: Parameters = state
            .iter()
            .filter(|(name, _)| *name != "v.bias_hh")
            .map(|(n, t)| (n.to_owned(), t.clone()))
            .collect();
        let message = refused(&without);
        assert!(message.contains("v.bias_hh") && message.contains("missing"), "{message}");
        let mut with = |name: &str, tensor: Tensor| {
            let mut changed = state.clone();
            changed.insert(name, tensor);
            let message = refused(&changed);
            assert!(message.contains(name), "{message}");
            message
        };
        let ones = Tensor::ones(3 * HIDDEN, DType::F32, &Device::Cpu).unwrap();
        assert!(with("m.bias_ih", ones.narrow(0, 0, 5).unwrap()).contains("[5]"));
        assert!(with("bias_ih", ones.to_dtype(DType::F64).unwrap()).contains("F64"));
        assert!(with("more", ones.clone()).contains("not part"));
    }

    #[test]
    fn unfit_gradients_and_encodings_are_refused_and_change_nothing() {
        let (mut training, drives) = (training(), drives(&[2, 4]));
        let before = bits(&training);
        let encoded = training.encode(&slices(&drives)).unwrap();
        let mut gradient = vec![1.0; 2 * HIDDEN];
        gradient[HIDDEN + 3] = f32::NAN;
        let message = training.step(&encoded, &gradient).unwrap_err().to_string();
        assert!(message.contains("`hidden`") && message.contains("NaN for sequence 1"), "{message}");
        let overflow = training.step(&encoded, &vec![f32::MAX; 2 * HIDDEN]);
        assert!(matches!(overflow, Err(Error::NotFinite(_))), "{overflow:?}");
        assert!(matches!(training.step(&encoded, &gradient[1..]), Err(Error::Mismatch(_))));
        assert!(matches!(training.encode(&[]), Err(Error::Mismatch(_))));
        assert!(matches!(training.encode_fixed(&[&drives[0], &[]]), Err(Error::Mismatch(_))));
        assert_eq!(bits(&training), before);
        gradient.fill(1.0);
        training.step(&encoded, &gradient).unwrap();
        let message = training.step(&encoded, &gradient).unwrap_err().to_string();
        assert!(message.contains("changed since"), "{message}");
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(EncoderTraining::new(1, rate), Err(Error::Option(_))));
        }
    }

    /// The matrix products take their number of threads from the environment of the process.
    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        const CHILD: &str = "SAGE_TEST_GOOSE_BITS";
        const NAME: &str = "goose::networks::training::tests::bits_do_not_depend_on_the_number_of_threads";
        if std::env::var_os(CHILD).is_some() {
            let lengths: Vec<usize> = (0..128).map(|k| 19 - k % 7).collect();
            let (mut training, drives) = (training(), drives(&lengths));
            (0..3).for_each(|_| step(&mut training, &drives));
            println!("{CHILD}={}", bits(&training).0);
            return;
        }
        let of = |threads: &str| {
            let mut child = std::process::Command::new(std::env::current_exe().unwrap());
            child.args(["--exact", NAME, "--nocapture"]).envs([(CHILD, "1"), ("RAYON_NUM_THREADS", threads)]);
            let output = String::from_utf8(child.output().unwrap().stdout).unwrap();
            let at = output.find(CHILD).unwrap_or_else(|| panic!("no bits in `{output}`"));
            output[at..].lines().next().unwrap().to_owned()
        };
        assert_eq!(of("1"), of("2"));
    }
}
