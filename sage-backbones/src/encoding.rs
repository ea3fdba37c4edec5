//! Encodings: the states that a network computes from the features of one target.

use std::sync::{Arc, OnceLock};

use candle_core::Tensor;
use serde_json::Value;

use crate::{Error, features::Features};

/// Tag of an encoding. Only a network of the same name and options can read it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkTag<'n> {
    /// Name in the registry.
    pub name: &'static str,
    /// Options.
    pub options: &'n Value,
}

/// States of one target, tagged with the network that can read them.
pub struct Encoding {
    features: Arc<Features>,
    network: &'static str,
    options: Value,
    states: Vec<Tensor>,
    described: OnceLock<Option<Tensor>>,
}

impl Encoding {
    /// States that only the network of the tag can read.
    pub fn new(network: NetworkTag, features: Arc<Features>, states: Vec<Tensor>) -> Self {
        let (network, options) = (network.name, network.options.clone());
        Self { features, network, options, states, described: OnceLock::new() }
    }

    /// The encoded features.
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// The states, for the network that computed them.
    ///
    /// *Errors*: [`Error::Training`] if another network computed them.
    pub fn states_of<const N: usize>(&self, network: NetworkTag) -> Result<&[Tensor; N], Error> {
        let is_its_own = network == NetworkTag { name: self.network, options: &self.options };
        self.states.first_chunk().filter(|_| is_its_own).ok_or_else(|| {
            Error::Training(format!(
                "this encoding was computed by another network, `{}`; encode the features again",
                self.network
            ))
        })
    }

    /// All states, without a check of the network.
    pub fn states(&self) -> &[Tensor] {
        &self.states
    }

    /// Inputs of the interaction head for all modes. The first call computes them with `compute`.
    ///
    /// *Errors*: those of `compute`.
    pub fn described(
        &self,
        compute: impl FnOnce() -> Result<Option<Tensor>, Error>,
    ) -> Result<Option<&Tensor>, Error> {
        if self.described.get().is_none() {
            // Two threads may both compute it; the bits are the same.
            let _ = self.described.set(compute()?);
        }
        Ok(self.described.get().and_then(Option::as_ref))
    }
}
