//! What a goal's trajectory means for the ego and for everybody else: the part of the score that
//! fine-tuning steers by.
//!
//! It gives zero until it is fine-tuned, so that the base model knows nothing of it. What it sees is
//! what the target could know *now*: the map, the ego's futures as a network predicts them, the others
//! along their lanes, the shape of the path itself; never the logged future.

mod description;
mod eight;

use candle_core::{DType, Result, Tensor};

use crate::{
    backbone::indices,
    features::Features,
    nn::{Linear, Mlp},
    parameters::Scope,
};
use description::COLUMNS;

pub(crate) use description::describe;

/// Width of its layers.
const WIDTH: usize = 64;

pub(crate) struct SteeringBranch {
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl SteeringBranch {
    pub(crate) fn new(scope: &Scope) -> Result<Self> {
        Ok(Self {
            first: Mlp::new(&scope.at("first"), COLUMNS, WIDTH)?,
            second: Mlp::new(&scope.at("second"), WIDTH, WIDTH)?,
            last: Linear::zero(&scope.at("last"), WIDTH, 1)?,
        })
    }

    /// Whether it gives zero whatever it sees: nothing to compute then, unless it is in training.
    pub(crate) fn is_silent(&self) -> Result<bool> {
        let zero = |tensor: &Tensor| -> Result<bool> {
            let numbers = tensor.flatten_all()?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
            Ok(!tensor.is_variable() && numbers.iter().all(|x| *x == 0.0))
        };
        Ok(zero(&self.last.weight)? && zero(&self.last.bias)?)
    }

    /// What to add to the scores of described paths.
    ///
    /// *Shapes*: `rows` (n, columns) of [`describe`]; result (n).
    pub(crate) fn forward(&self, rows: &Tensor) -> Result<Tensor> {
        let x = self.second.forward(&self.first.forward(rows)?)?;
        self.last.forward(&x)?.squeeze(1)
    }

    /// Log-probabilities of some modes if they were driven along other places than those that
    /// `described` rows (modes) tell of.
    pub(crate) fn moved(
        &self,
        log_probs: &Tensor,
        modes: &[usize],
        described: &Tensor,
        places: &Tensor,
        features: &Features,
    ) -> Result<Tensor> {
        let index = indices(modes)?;
        let log_probs = log_probs.index_select(&index, 0)?;
        let Some(rows) = describe(places, features)? else { return Ok(log_probs) };
        let own = self.forward(&described.index_select(&index, 0)?)?;
        (log_probs - own)? + self.forward(&rows)?
    }
}
