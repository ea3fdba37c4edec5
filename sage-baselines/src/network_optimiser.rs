//! A network's parameters in training, with Adam (Kingma and Ba, 2015).

use candle_core::{Device, Tensor};
use sage_backbones::{
    Error, Parameters,
    nn::{AdamW, AdamWConfig},
    parameters::Variables,
};

/// Constants of Adam.
pub(crate) fn adam() -> AdamWConfig {
    AdamWConfig { weight_decay: 0.0, ..AdamWConfig::default() }
}

/// Parameters in training and the optimiser's state.
pub(crate) struct Optimiser {
    parameters: Parameters,
    variables: Variables,
    adam: AdamW,
}

impl Optimiser {
    /// Trains the parameters that `trained` accepts.
    pub(crate) fn new(
        start: &Parameters,
        adam: AdamW,
        trained: impl Fn(&str) -> bool,
    ) -> Result<Self, Error> {
        let (parameters, variables) = copy(start)?.variables(trained)?;
        Ok(Self { parameters, variables, adam })
    }

    /// The parameters, whose results carry gradients. They share their storage with later steps.
    pub(crate) fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The optimiser's state.
    pub(crate) fn adam(&self) -> &AdamW {
        &self.adam
    }

    /// A copy of the present weights.
    pub(crate) fn weights(&self) -> Result<Parameters, Error> {
        copy(&self.parameters)
    }

    /// One step against the gradient of `loss`; returns the loss. `what` names the step in errors.
    ///
    /// *Errors*: [`Error::NotFinite`] for a loss or gradient that is not finite, with its tensor; nothing has changed
    /// then.
    pub(crate) fn step(&mut self, loss: &Tensor, rate: f64, what: impl Fn() -> String) -> Result<f64, Error> {
        let value = f64::from(loss.to_scalar::<f32>()?);
        if !value.is_finite() {
            return Err(Error::NotFinite(format!("{}: the loss is {value}", what())));
        }
        let store = loss.backward()?;
        let mut gradients = Vec::with_capacity(self.variables.len());
        for (name, variable) in self.variables.iter() {
            let Some(gradient) = store.get(variable) else { continue };
            let gradient = gradient.flatten_all()?.to_vec1::<f32>()?;
            if let Some(bad) = gradient.iter().find(|x| !x.is_finite()) {
                return Err(Error::NotFinite(format!("{}: the gradient of `{name}` holds {bad}", what())));
            }
            gradients.push((name, variable, gradient));
        }
        self.adam.begin_step();
        for (name, variable, gradient) in gradients {
            let mut values = variable.as_detached_tensor().flatten_all()?.to_vec1::<f32>()?;
            self.adam.update(name, &mut values, &gradient, rate);
            variable.set(&Tensor::from_vec(values, variable.shape(), &Device::Cpu)?)?;
        }
        Ok(value)
    }
}

fn copy(parameters: &Parameters) -> Result<Parameters, Error> {
    let copy = |(name, tensor): (&str, &Tensor)| Ok((name.to_owned(), tensor.detach().copy()?));
    parameters.iter().map(copy).collect()
}
