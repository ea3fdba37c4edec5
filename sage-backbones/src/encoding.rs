//! What a network made of one target's surroundings.

use std::sync::{Arc, OnceLock};

use candle_core::Tensor;
use serde_json::Value;

use crate::{Error, features::Features};

/// What marks encodings as a network's own: only one of the same name and options reads them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NetworkTag<'n> {
    /// Name in the registry.
    pub name: &'static str,
    /// Options.
    pub options: &'n Value,
}

/// States of one target's surroundings, tagged with the network that can read them.
pub struct Encoding {
    features: Arc<Features>,
    network: &'static str,
    options: Value,
    states: Vec<Tensor>,
    described: OnceLock<Option<Tensor>>,
}

impl Encoding {
    /// States that only the network of a tag knows to read.
    pub fn new(network: NetworkTag, features: Arc<Features>, states: Vec<Tensor>) -> Self {
        let (network, options) = (network.name, network.options.clone());
        Self { features, network, options, states, described: OnceLock::new() }
    }

    /// What was encoded.
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// The states, for the network that made them.
    ///
    /// *Errors*: [`Error::Training`] if another one did.
    pub fn states_of<const N: usize>(&self, network: NetworkTag) -> Result<&[Tensor; N], Error> {
        let is_its_own = network == NetworkTag { name: self.network, options: &self.options };
        self.states.first_chunk().filter(|_| is_its_own).ok_or_else(|| {
            Error::Training(format!(
                "this encoding was made by another network, `{}`; encode the features again",
                self.network
            ))
        })
    }

    /// All states, whoever made them.
    pub fn states(&self) -> &[Tensor] {
        &self.states
    }

    /// What a steering branch sees of all modes, made by `make` when it is first asked for.
    ///
    /// *Errors*: those of `make`.
    pub fn described(
        &self,
        make: impl FnOnce() -> Result<Option<Tensor>, Error>,
    ) -> Result<Option<&Tensor>, Error> {
        if self.described.get().is_none() {
            // Two threads may both make it: the bits are the same.
            let _ = self.described.set(make()?);
        }
        Ok(self.described.get().and_then(Option::as_ref))
    }
}
