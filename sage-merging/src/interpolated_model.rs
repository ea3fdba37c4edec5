//! One network whose weights follow a mixture.

use sage_backbones::{Backbone, candle::Tensor, parameters::Variables};
use sage_core::generator::Mixture;

use crate::{Error, ExpertSet, Range, TensorMerger, TensorRule, expert_set::Moved};

/// A network at some mixture. Setting another one changes the tensors that fine-tuning moved, in place:
/// nothing is built anew, and what the network's frozen part made of a scene stays valid.
pub struct InterpolatedModel {
    network: Box<dyn Backbone>,
    variables: Variables,
    moved: Vec<Moved>,
    rule: Box<dyn TensorRule>,
    range: Range,
    experts: usize,
}

impl InterpolatedModel {
    /// A network at the prior's weights; [`InterpolatedModel::set`] mixes the experts.
    ///
    /// *Errors*: experts that the merger cannot mix.
    pub fn new(experts: &ExpertSet, merger: &dyn TensorMerger, seed: u64) -> Result<Self, Error> {
        let moved = experts.moved()?;
        let prior = experts.prior();
        let (tracked, variables) =
            prior.parameters().variables(|name| moved.iter().any(|moved| moved.name == name))?;
        // Detached tensors share the variables' storage: the network follows and records no graph.
        Ok(Self {
            network: prior.with_parameters(tracked.detached())?,
            variables,
            moved,
            rule: merger.prepare(experts, seed)?,
            range: merger.range(),
            experts: experts.names().len(),
        })
    }

    /// The network as it stands.
    pub fn network(&self) -> &dyn Backbone {
        &*self.network
    }

    /// Moves it to a mixture.
    ///
    /// *Errors*: [`Error::Mixture`] for one that the merger does not take.
    pub fn set(&mut self, at: &Mixture) -> Result<(), Error> {
        self.range.check_weights(self.experts, at)?;
        // Both are sorted by name.
        for ((_, variable), moved) in self.variables.iter().zip(&self.moved) {
            let mut out = vec![0.0; moved.prior.len()];
            self.rule.merge(&moved.set(), at.weights(), &mut out);
            variable.set(&Tensor::from_vec(out, variable.shape(), variable.device())?)?;
        }
        Ok(())
    }
}
