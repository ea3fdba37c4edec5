//! Interaction head: a term of each goal score that depends on how the goal's trajectory interacts with the
//! ego, the other agents and the road edges.
//!
//! Its output is zero until fine-tuning, so the prior does not depend on it. Its inputs are known *now*: the
//! map, forecasts of the ego and of the other agents, and the trajectory. It never reads the logged future.

mod description;
mod trajectory_batch;

use candle_core::{DType, Module, Result, Tensor};

use crate::{
    backbone::of_modes,
    features::Features,
    nn::{Linear, Mlp},
    parameters::Scope,
};
use description::COLUMNS;

pub(crate) use description::describe;

/// Width of its layers.
const WIDTH: usize = 64;

/// The layers of the interaction head.
pub(crate) struct InteractionHead {
    first: Mlp,
    second: Mlp,
    last: Linear,
}

impl InteractionHead {
    pub(crate) fn new(scope: &Scope) -> Result<Self> {
        Ok(Self {
            first: Mlp::new(&scope.at("first"), COLUMNS, WIDTH)?,
            second: Mlp::new(&scope.at("second"), WIDTH, WIDTH)?,
            last: Linear::zero(&scope.at("last"), WIDTH, 1)?,
        })
    }

    /// Whether its output is zero for every input, so that it can be skipped; false while it is trained.
    pub(crate) fn is_zero(&self) -> Result<bool> {
        let zero = |tensor: &Tensor| -> Result<bool> {
            let numbers = tensor.flatten_all()?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
            Ok(!tensor.is_variable() && numbers.iter().all(|x| *x == 0.0))
        };
        Ok(zero(&self.last.weight)? && zero(&self.last.bias)?)
    }

    /// Terms to add to the goal scores.
    ///
    /// *Shapes*: `rows` (n, columns) of [`describe`]; result (n).
    pub(crate) fn forward(&self, rows: &Tensor) -> Result<Tensor> {
        let x = self.second.forward(&self.first.forward(rows)?)?;
        self.last.forward(&x)?.squeeze(1)
    }

    /// Log-probabilities of some modes with `points` in place of the modes' own trajectories.
    ///
    /// *Shapes*: `log_probs` (all modes); `described` (all modes, columns), rows of [`describe`] for the
    /// modes' own trajectories; `points` (n, 20, 2); result (n).
    pub(crate) fn along(
        &self,
        log_probs: &Tensor,
        modes: &[usize],
        described: &Tensor,
        points: &Tensor,
        features: &Features,
    ) -> Result<Tensor> {
        let log_probs = of_modes(log_probs, modes)?;
        let Some(rows) = describe(points, features)? else { return Ok(log_probs) };
        let own = self.forward(&of_modes(described, modes)?)?;
        (log_probs - own)? + self.forward(&rows)?
    }
}
