//! Tuned networks that encode for themselves.

use std::sync::Arc;

use candle_core::Tensor;

use crate::{
    Backbone, Error, MotionModel,
    encoding::{Encoding, ModelId},
    features::STRIDE,
    interaction_head::describe,
    smooth_path,
};

/// A network that encodes the features of the prior's encodings for itself, once each: its methods take encodings of the prior, as
/// those of a network whose encoder was not tuned.
pub struct OwnEncoder {
    id: ModelId,
    network: Box<dyn Backbone>,
    modes_of: Option<Arc<dyn Backbone>>,
}

impl OwnEncoder {
    /// The prior's modes, scored by a network of the same name and options. Ends and trajectories are the prior's, so preference
    /// tuning changes what is likely, never what a mode looks like.
    pub fn scoring(network: Box<dyn Backbone>, prior: Arc<dyn Backbone>) -> Self {
        Self { id: ModelId::unique(), network, modes_of: Some(prior) }
    }

    /// A network with modes of its own, which shares nothing with its prior ([`crate::backbone::Shared::Nothing`]).
    pub fn with_own_modes(network: Box<dyn Backbone>) -> Self {
        Self { id: ModelId::unique(), network, modes_of: None }
    }

    fn own(&self, shared: &Encoding) -> Result<Arc<Encoding>, Error> {
        shared.keep(self.id, || match &self.modes_of {
            Some(prior) => reencode(&*self.network, &**prior, shared),
            None => self.network.encode(shared.shared_features()),
        })
    }
}

/// The encoding of the same features by another network, for its scores. Inputs of an interaction head describe
/// the prior's trajectories.
///
/// *Errors*: those of the networks.
pub(crate) fn reencode(
    network: &dyn Backbone,
    prior: &dyn Backbone,
    shared: &Encoding,
) -> Result<Encoding, Error> {
    let described = shared.head_inputs(|| described(prior, shared))?.cloned();
    let own = network.encode(shared.shared_features())?;
    own.head_inputs(|| Ok(described))?;
    Ok(own)
}

/// Inputs of the interaction head for the prior's trajectories of all modes.
fn described(prior: &dyn Backbone, encoding: &Encoding) -> Result<Option<Tensor>, Error> {
    let modes: Vec<usize> = (0..prior.mode_ends(encoding)?.len()).collect();
    let points = smooth_path::every(&prior.trajectories(encoding, &modes)?, STRIDE)?.contiguous()?;
    Ok(describe(&points, encoding.features())?)
}

impl MotionModel for OwnEncoder {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        self.network.log_probs(&*self.own(encoding)?)
    }

    fn relative_log_probs(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        self.network.relative_log_probs(&*self.own(encoding)?, modes)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        match &self.modes_of {
            Some(prior) => prior.mode_ends(encoding),
            None => self.network.mode_ends(&*self.own(encoding)?),
        }
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        match &self.modes_of {
            Some(prior) => prior.trajectories(encoding, modes),
            None => self.network.trajectories(&*self.own(encoding)?, modes),
        }
    }

    fn log_probs_along(
        &self,
        encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        points: &Tensor,
    ) -> Result<Tensor, Error> {
        self.network.log_probs_along(&*self.own(encoding)?, log_probs, modes, points)
    }
}
