//! A tuned network whose encoder was tuned too.

use std::sync::Arc;

use candle_core::{Device, Tensor};

use crate::{
    Backbone, Error, MotionModel,
    encoding::{Encoding, ModelId},
    features::{FORECAST_STEPS, STRIDE},
    interaction_head::describe,
};

/// A network that scores the prior's modes by its own encoding. Ends and trajectories of the modes are the
/// prior's, so preference tuning changes what is likely, never what a mode looks like.
///
/// Its methods take encodings of the prior, as those of a network whose encoder was not tuned. It encodes the
/// features again, once per encoding.
pub struct OwnEncoder {
    id: ModelId,
    network: Box<dyn Backbone>,
    prior: Arc<dyn Backbone>,
}

impl OwnEncoder {
    /// The prior's modes, scored by a network of the same name and options.
    pub fn new(network: Box<dyn Backbone>, prior: Arc<dyn Backbone>) -> Self {
        Self { id: ModelId::unique(), network, prior }
    }

    fn own(&self, shared: &Encoding) -> Result<Arc<Encoding>, Error> {
        shared.keep(self.id, || reencode(&*self.network, &*self.prior, shared))
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
    let every: Vec<u32> = (1..=FORECAST_STEPS).map(|step| (step * STRIDE - 1) as u32).collect();
    let every = Tensor::from_vec(every, FORECAST_STEPS, &Device::Cpu)?;
    let points = prior.trajectories(encoding, &modes)?.index_select(&every, 1)?.contiguous()?;
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
        self.prior.mode_ends(encoding)
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        self.prior.trajectories(encoding, modes)
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
