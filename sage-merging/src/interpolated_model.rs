//! The interpolated model: one network whose weights follow a mixture.

use sage_backbones::{Backbone, candle::Tensor, parameters::Variables, training::Tunes};
use sage_core::generator::Mixture;

use crate::{Error, ExpertSet, Range, TensorMerger, TensorRule, expert_set::TunedTensor};

/// A network at a mixture. Setting another mixture changes the tensors that fine-tuning changed, in place.
/// No network is built again, and encodings by the network's frozen part stay valid.
pub struct InterpolatedModel {
    network: Box<dyn Backbone>,
    variables: Variables,
    tuned: Vec<TunedTensor>,
    rule: Box<dyn TensorRule>,
    range: Range,
    experts: usize,
}

impl InterpolatedModel {
    /// A network at the prior's weights; [`InterpolatedModel::set`] mixes the experts.
    ///
    /// *Errors*: experts that the merger cannot mix, or that have their own encoders.
    pub fn new(experts: &ExpertSet, merger: &dyn TensorMerger, seed: u64) -> Result<Self, Error> {
        if experts.tunes() != Tunes::Scores {
            return Err(Error::OwnEncoders);
        }
        let tuned = experts.tuned_tensors()?;
        let prior = experts.prior();
        let (tracked, variables) =
            prior.parameters().variables(|name| tuned.iter().any(|tuned| tuned.name == name))?;
        // Detached tensors share the variables' storage: the network follows them and records no graph.
        Ok(Self {
            network: prior.with_parameters(tracked.detached())?,
            variables,
            tuned,
            rule: merger.prepare(experts, seed)?,
            range: merger.range(),
            experts: experts.names().len(),
        })
    }

    /// The network at the current mixture.
    pub fn network(&self) -> &dyn Backbone {
        &*self.network
    }

    /// Sets the mixture.
    ///
    /// *Errors*: one that the merger refuses.
    pub fn set(&mut self, at: &Mixture) -> Result<(), Error> {
        let at = at.among(self.experts);
        self.range.check_weights(self.experts, &at)?;
        // Both are sorted by name.
        for ((_, variable), tuned) in self.variables.iter().zip(&self.tuned) {
            let mut out = vec![0.0; tuned.prior.len()];
            self.rule.merge(&tuned.set(), at.weights(), &mut out);
            variable.set(&Tensor::from_vec(out, variable.shape(), variable.device())?)?;
        }
        Ok(())
    }
}
