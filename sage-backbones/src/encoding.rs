//! Encodings: the states that a network computes from the features of one target.

use std::{
    any::Any,
    collections::HashMap,
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

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

/// Number of models whose results an encoding keeps; then it forgets all of them.
const KEPT: usize = 256;

/// Identity of a model that keeps results with encodings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ModelId(u64);

impl ModelId {
    /// An identity that no other model of this process has.
    pub fn unique() -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self(NEXT.fetch_add(1, Ordering::Relaxed))
    }
}

/// States of one target, tagged with the network that can read them.
pub struct Encoding {
    features: Arc<Features>,
    network: &'static str,
    options: Value,
    states: Vec<Tensor>,
    described: OnceLock<Option<Tensor>>,
    kept: Mutex<HashMap<ModelId, Arc<dyn Any + Send + Sync>>>,
}

impl Encoding {
    /// States that only the network of the tag can read.
    pub fn new(network: NetworkTag, features: Arc<Features>, states: Vec<Tensor>) -> Self {
        let (network, options) = (network.name, network.options.clone());
        let (described, kept) = (OnceLock::new(), Mutex::default());
        Self { features, network, options, states, described, kept }
    }

    /// The encoded features.
    pub fn features(&self) -> &Features {
        &self.features
    }

    /// The encoded features, to encode them with another network.
    pub fn shared_features(&self) -> Arc<Features> {
        self.features.clone()
    }

    /// The states, for the network that computed them.
    ///
    /// *Errors*: [`Error::Mismatch`] if another network computed them.
    pub fn states_of<const N: usize>(&self, network: NetworkTag) -> Result<&[Tensor; N], Error> {
        let is_its_own = network == NetworkTag { name: self.network, options: &self.options };
        self.states.first_chunk().filter(|_| is_its_own).ok_or_else(|| {
            Error::Mismatch(format!(
                "this encoding was computed by another network, `{}`; encode the features again",
                self.network
            ))
        })
    }

    /// All states, without a check of the network.
    pub fn states(&self) -> &[Tensor] {
        &self.states
    }

    /// What a model computes from this encoding and needs in several of its methods. The first call computes
    /// it; a model keeps one value.
    ///
    /// *Errors*: those of `compute`.
    pub fn keep<T: Send + Sync + 'static>(
        &self,
        model: ModelId,
        compute: impl FnOnce() -> Result<T, Error>,
    ) -> Result<Arc<T>, Error> {
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock().get(&model).cloned();
        if let Some(found) = known.and_then(|found| found.downcast().ok()) {
            return Ok(found);
        }
        // Two threads may both compute it; the bits are the same.
        let computed = Arc::new(compute()?);
        let mut kept = lock();
        if kept.len() >= KEPT {
            kept.clear();
        }
        kept.insert(model, computed.clone());
        Ok(computed)
    }

    /// Inputs of the interaction head for all modes. The first call computes them with `compute`.
    ///
    /// *Errors*: those of `compute`.
    pub fn head_inputs(
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
