//! One training step: gradients of a batch, in parallel and in a fixed order, and the update of the weights.

use std::sync::atomic::{AtomicBool, Ordering};

use candle_core::{Tensor, Var};
use rayon::prelude::*;

use crate::{
    Error,
    backbone::{Backbone, Loss, ParameterGroup, Trainable},
    nn::{AdamW, AdamWConfig},
    parameters::{Parameters, Variables},
};

/// A network in training.
pub struct Trainer {
    network: Box<dyn Backbone>,
    variables: Variables,
    /// Which of the variables have had a gradient.
    reached: Vec<AtomicBool>,
    /// The optimiser's state.
    pub adam: AdamW,
}

/// The training interface of a backbone.
///
/// *Errors*: [`Error::NothingToTrain`] if it has no parameters to train.
pub fn trainable(network: &dyn Backbone) -> Result<&dyn Trainable, Error> {
    let nothing = || Error::NothingToTrain(format!("backbone `{}` has nothing to train", network.name()));
    network.trainable().ok_or_else(nothing)
}

/// Gradient of one item: one list of numbers per variable, in the order of the names.
pub struct Gradient {
    /// Loss: the sum of its terms.
    pub loss: f64,
    /// Terms of the loss by name.
    pub parts: Vec<(&'static str, f64)>,
    values: Vec<Vec<f32>>,
}

impl Trainer {
    /// A trainer of those parameters of a network that `trained` accepts.
    ///
    /// *Errors*: none on a CPU.
    pub fn new(
        network: &dyn Backbone,
        trained: impl Fn(&str) -> bool,
        config: AdamWConfig,
    ) -> Result<Self, Error> {
        let (parameters, variables) = network.parameters().variables(trained)?;
        let reached = variables.iter().map(|_| AtomicBool::new(false)).collect();
        let network = network.with_parameters(parameters)?;
        Ok(Self { network, variables, reached, adam: AdamW::new(config) })
    }

    /// The network, whose results carry gradients.
    pub fn network(&self) -> &dyn Backbone {
        &*self.network
    }

    /// The training interface of the network.
    ///
    /// *Errors*: [`Error::NothingToTrain`] if it has no parameters to train.
    pub fn trainable(&self) -> Result<&dyn Trainable, Error> {
        trainable(&*self.network)
    }

    /// The network without gradients. It shares the weights, so further steps change it too.
    ///
    /// *Errors*: none on a CPU.
    pub fn frozen(&self) -> Result<Box<dyn Backbone>, Error> {
        self.network.with_parameters(self.network.parameters().detached())
    }

    /// A copy of the present weights.
    ///
    /// *Errors*: none on a CPU.
    pub fn weights(&self) -> Result<Parameters, Error> {
        let copy = |(name, tensor): (&str, &Tensor)| Ok((name.to_owned(), tensor.detach().copy()?));
        self.network.parameters().iter().map(copy).collect()
    }

    /// Sets the trained parameters to given weights.
    ///
    /// *Errors*: a name that is missing or a shape that differs.
    pub fn set_weights(&self, weights: &Parameters) -> Result<(), Error> {
        for (name, variable) in self.variables.iter() {
            match weights.get(name) {
                Some(tensor) => variable.set(&tensor.to_device(variable.device())?.copy()?)?,
                None => return Err(Error::Mismatch(format!("the checkpoint has no tensor `{name}`"))),
            }
        }
        Ok(())
    }

    /// The variables.
    pub fn variables(&self) -> &Variables {
        &self.variables
    }

    /// Loss and gradient of one item. `what` names the item in errors.
    ///
    /// *Errors*: [`Error::NotFinite`] for a loss or gradient that is not finite, with its tensor.
    pub fn gradient(&self, loss: &Loss, what: &str) -> Result<Gradient, Error> {
        for (name, value) in &loss.parts {
            if !value.is_finite() {
                return Err(Error::NotFinite(format!("{what}: the loss `{name}` is {value}")));
            }
        }
        let store = loss.total.backward()?;
        let numbers = |((name, variable), reached): ((&str, &Var), &AtomicBool)| -> Result<Vec<f32>, Error> {
            let Some(gradient) = store.get(variable) else { return Ok(vec![0.0; variable.elem_count()]) };
            reached.store(true, Ordering::Relaxed);
            let values = gradient.flatten_all()?.to_vec1::<f32>()?;
            match values.iter().find(|x| !x.is_finite()) {
                Some(bad) => Err(Error::NotFinite(format!("{what}: the gradient of `{name}` holds {bad}"))),
                None => Ok(values),
            }
        };
        let values = self.variables.iter().zip(&self.reached).map(numbers).collect::<Result<_, _>>()?;
        Ok(Gradient { loss: loss.parts.iter().map(|part| part.1).sum(), parts: loss.parts.clone(), values })
    }

    /// Checks that each variable has had a gradient, but for those that need not have one
    /// ([`ParameterGroup::Interaction`], [`ParameterGroup::WithoutEffect`]).
    ///
    /// *Errors*: [`Error::NothingToTrain`] with the first that has had none.
    pub fn check_reached(&self) -> Result<(), Error> {
        let needs = |name: &str| {
            let group = self.network.parameter_group(name);
            !matches!(group, ParameterGroup::Interaction | ParameterGroup::WithoutEffect)
        };
        for ((name, _), reached) in self.variables.iter().zip(&self.reached) {
            if needs(name) && !reached.load(Ordering::Relaxed) {
                return Err(Error::NothingToTrain(format!(
                    "no gradient has come to tensor `{name}` of backbone `{}`: the loss does not depend on it, or an operation drops \
                     gradients, as the fused layer norm and softmax of candle-nn do",
                    self.network.name()
                )));
            }
        }
        Ok(())
    }

    /// Gradients of many items on all threads, in the order of the items.
    ///
    /// *Errors*: that of the first item, in their order, that fails.
    pub fn gradients<I: Sync>(
        &self,
        items: &[I],
        gradient: impl Fn(&I) -> Result<Gradient, Error> + Send + Sync,
    ) -> Result<Vec<Gradient>, Error> {
        let all: Vec<Result<Gradient, Error>> = items.par_iter().with_max_len(1).map(gradient).collect();
        all.into_iter().collect()
    }

    /// Updates the weights by the mean gradient, clipped to the norm `clip`; returns the norm before
    /// clipping.
    ///
    /// *Errors*: none on a CPU.
    pub fn update(&mut self, gradients: &[Gradient], rate: f64, clip: f64) -> Result<f64, Error> {
        let share = 1.0 / gradients.len().max(1) as f32;
        let count = self.variables.len();
        let mean = |k: usize| {
            let mut sum = gradients[0].values[k].clone();
            for gradient in &gradients[1..] {
                for (total, x) in sum.iter_mut().zip(&gradient.values[k]) {
                    *total += x;
                }
            }
            sum.iter_mut().for_each(|x| *x *= share);
            sum
        };
        let means: Vec<Vec<f32>> = if gradients.is_empty() { vec![] } else { (0..count).map(mean).collect() };
        let squares = means.iter().flatten().map(|x| f64::from(*x) * f64::from(*x));
        let norm = squares.sum::<f64>().sqrt();
        let factor = if norm > clip { (clip / norm) as f32 } else { 1.0 };
        self.adam.begin_step();
        for ((name, variable), mut gradient) in self.variables.iter().zip(means) {
            gradient.iter_mut().for_each(|x| *x *= factor);
            let mut values = variable.as_detached_tensor().flatten_all()?.to_vec1::<f32>()?;
            self.adam.update(name, &mut values, &gradient, rate);
            variable.set(&Tensor::from_vec(values, variable.shape(), variable.device())?)?;
        }
        Ok(norm)
    }
}
