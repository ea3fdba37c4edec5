//! Mergers: from a set of experts and a mixture to a model.

use std::sync::Arc;

use sage_backbones::{MotionModel, Parameters, candle::Tensor};
use sage_core::generator::{Mixture, corner};

use crate::{Error, ExpertSet, TensorSet};

/// Builds a model from a set of experts.
///
/// Mergers of weights implement [`TensorMerger`] and thereby this trait. Mergers of outputs hold the
/// experts and implement this trait directly.
///
/// A merger by its name, and the mixtures that it takes:
///
/// ```
/// use sage_core::generator::Mixture;
/// use sage_merging::mergers;
///
/// let mergers = mergers()?;
/// let [within, beyond] = [0.5, 1.3].map(Mixture::between);
/// // Interpolation stays between the experts; extrapolation goes on beyond the adversarial one.
/// let range = mergers.build_default("linear")?.range();
/// assert!(range.check_weights(2, &within).is_ok() && range.check_weights(2, &beyond).is_err());
/// assert!(mergers.build_default("vector-extrapolation")?.range().check_weights(2, &beyond).is_ok());
/// // Those that mix weights give one network for each λ; others mix what the experts say.
/// assert!(mergers.build_default("linear")?.tensors().is_some());
/// assert!(mergers.build_default("logit")?.tensors().is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Merger: Send + Sync {
    /// Range of accepted mixtures.
    fn range(&self) -> Range;

    /// The model at a mixture within the range.
    ///
    /// *Errors*: experts that it cannot mix.
    fn model(&self, experts: &ExpertSet, at: &Mixture, seed: u64) -> Result<Arc<dyn MotionModel>, Error>;

    /// Whether the modes of its models are those of the prior: the same number, ends and trajectories.
    fn keeps_modes(&self) -> bool {
        true
    }

    /// The merger of weights, if it is one; [`merged_weights`] needs it.
    fn tensors(&self) -> Option<&dyn TensorMerger> {
        None
    }
}

impl dyn Merger + '_ {
    /// The model at a mixture.
    ///
    /// *Errors*: one that it refuses; those of [`Merger::model`].
    pub fn merge(&self, experts: &ExpertSet, at: &Mixture, seed: u64) -> Result<Arc<dyn MotionModel>, Error> {
        let at = at.among(experts.names().len());
        self.range().check(experts, &at)?;
        self.model(experts, &at, seed)
    }
}

/// Mixtures that a merger accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Weights of at least 0 that sum to 1.
    Simplex,
    /// The same with at most two experts of weight above 0.
    Edge,
    /// Finite weights that sum to 1, also outside the simplex.
    Affine,
    /// Any finite weights.
    Beyond,
}

impl Range {
    /// Checks that a mixture is within the range.
    ///
    /// *Errors*: a number of weights, a λ or weights that are out of range.
    pub fn check(self, experts: &ExpertSet, at: &Mixture) -> Result<(), Error> {
        self.check_weights(experts.names().len(), at)
    }

    /// The same check for a number of experts.
    ///
    /// *Errors*: a number of weights, a λ or weights that are out of range.
    pub fn check_weights(self, experts: usize, at: &Mixture) -> Result<(), Error> {
        let weights = at.weights();
        if weights.len() != experts {
            return Err(Error::WeightCount { weights: weights.len(), experts });
        }
        let refuse = |expected| Err(Error::Weights { weights: weights.to_vec(), expected });
        let sum: f64 = weights.iter().sum();
        match (self, at.lambda()) {
            (Self::Simplex | Self::Edge, Some(lambda)) if !(0.0..=1.0).contains(&lambda) => {
                Err(Error::BeyondExperts(lambda))
            }
            (Self::Simplex | Self::Edge, _) if !at.is_on_simplex() => {
                refuse("expected weights of 0 or more that sum to 1")
            }
            (Self::Edge, _) if weights.iter().filter(|weight| **weight > 0.0).count() > 2 => {
                refuse("this merger mixes two experts at a time")
            }
            (Self::Affine, _) if !(sum - 1.0).abs().le(&1e-9) => {
                refuse("expected finite weights that sum to 1")
            }
            (Self::Affine | Self::Beyond, _) if !weights.iter().all(|weight| weight.is_finite()) => {
                refuse("expected finite weights")
            }
            _ => Ok(()),
        }
    }
}

/// Mixes weights per tensor.
pub trait TensorMerger: Send + Sync {
    /// Range of accepted mixtures.
    fn range(&self) -> Range {
        Range::Simplex
    }

    /// Computes quantities of all tensors together, such as a threshold.
    ///
    /// *Errors*: experts that it cannot mix.
    fn prepare(&self, experts: &ExpertSet, seed: u64) -> Result<Box<dyn TensorRule>, Error>;
}

/// The rule by which a prepared [`TensorMerger`] mixes one tensor.
///
/// It is applied to tensors that fine-tuning changed in some expert; the others stay the prior's. It gets numbers and no
/// network.
pub trait TensorRule: Send + Sync {
    /// Writes a tensor at a mixture, given by its weights.
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]);
}

impl<T: TensorMerger> Merger for T {
    fn range(&self) -> Range {
        TensorMerger::range(self)
    }

    fn model(&self, experts: &ExpertSet, at: &Mixture, seed: u64) -> Result<Arc<dyn MotionModel>, Error> {
        let weights = merged_weights(self, experts, at, seed)?;
        experts.model(weights)
    }

    fn tensors(&self) -> Option<&dyn TensorMerger> {
        Some(self)
    }
}

/// All weights at a mixture.
///
/// *Errors*: one out of range; experts that cannot be mixed.
///
/// The weights at λ = 1 are those of the adversarial expert:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_backbones::{Backbone, backbones};
/// use sage_merging::{ADVERSARIAL, ExpertSet, REALISTIC, merged_weights, mergers};
/// use serde_json::json;
///
/// let prior: Arc<dyn Backbone> = backbones()?.build("densetnt", &json!({"hidden": 8}))?.into();
/// let expert = |name: &str| (name.to_owned(), prior.parameters().clone());
/// let experts = ExpertSet::new(prior.clone(), vec![expert(REALISTIC), expert(ADVERSARIAL)])?;
///
/// let linear = mergers()?.build_default("linear")?;
/// let linear = linear.tensors().ok_or("it mixes no weights")?;
/// let merged = merged_weights(linear, &experts, &experts.between(1.0)?, 0)?;
/// assert_eq!(merged.hash()?, experts.expert(ADVERSARIAL)?.hash()?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn merged_weights(
    merger: &dyn TensorMerger,
    experts: &ExpertSet,
    at: &Mixture,
    seed: u64,
) -> Result<Parameters, Error> {
    let at = at.among(experts.names().len());
    merger.range().check(experts, &at)?;
    let rule = merger.prepare(experts, seed)?;
    let mut weights = experts.prior().parameters().clone();
    for tuned in experts.tuned_tensors()? {
        let mut out = vec![0.0; tuned.prior.len()];
        rule.merge(&tuned.set(), at.weights(), &mut out);
        if let Some(value) = out.iter().find(|value| !value.is_finite()) {
            let (tensor, weights) = (tuned.name.to_string(), at.weights().to_vec());
            return Err(Error::NotFinite { tensor, value: *value, weights });
        }
        weights.insert(&*tuned.name, Tensor::from_vec(out, tuned.shape.as_slice(), weights.device())?);
    }
    Ok(weights)
}

/// Mixes a tensor value by value, for mergers whose corners are the experts and that keep a value on which all
/// experts agree. At a corner the
/// result is the expert's own values, and a value that all experts share is unchanged. `mix` gets one value
/// of each expert and the prior's.
///
/// ```
/// use sage_merging::{TensorSet, mix_numbers};
///
/// let experts = [vec![1.0, 5.0], vec![3.0, 5.0]];
/// let tensor = TensorSet { name: "head.weight", prior: &[2.0, 0.0], experts: &experts };
/// let mixed = |lambda: f64| {
///     let (at, mut out) = ([1.0 - lambda, lambda], [0.0; 2]);
///     mix_numbers(&tensor, &at, &mut out, |values, _| {
///         values.iter().zip(at).map(|(value, weight)| f64::from(*value) * weight).sum()
///     });
///     out
/// };
/// // At λ = 1 the adversarial expert, bit for bit; a value on which the experts agree stays.
/// assert_eq!((mixed(0.25), mixed(1.0)), ([1.5, 5.0], [3.0, 5.0]));
/// ```
pub fn mix_numbers(tensor: &TensorSet, at: &[f64], out: &mut [f32], mix: impl Fn(&[f32], f32) -> f64) {
    if let Some(corner) = corner(at) {
        out.copy_from_slice(&tensor.experts[corner]);
        return;
    }
    let mut numbers = vec![0.0; tensor.experts.len()];
    for (k, out) in out.iter_mut().enumerate() {
        for (number, expert) in numbers.iter_mut().zip(tensor.experts) {
            *number = expert[k];
        }
        let first = numbers[0];
        let is_shared = numbers.iter().all(|number| *number == first);
        *out = if is_shared { first } else { mix(&numbers, tensor.prior[k]) as f32 };
    }
}
