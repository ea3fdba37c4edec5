//! Goal scores.

use candle_core::{Module, Result, Tensor};

use super::Shape;
use crate::{
    interaction_head::InteractionHead,
    nn::{Attention, Mlp, ResCat},
    parameters::Scope,
};

pub(super) struct Scorer {
    goal: [Mlp; 3],
    attention: Attention,
    decoder: ResCat,
    interaction: Option<InteractionHead>,
}

impl Scorer {
    pub(super) fn new(scope: &Scope, shape: &Shape) -> Result<Self> {
        let width = shape.hidden;
        let layers = scope.at("goals_2D_point_sub_graph").at("layers");
        Ok(Self {
            goal: [
                Mlp::new(&layers.at(0), shape.goal_columns, width / 2)?,
                Mlp::new(&layers.at(1), width, width / 2)?,
                Mlp::new(&layers.at(2), width, width)?,
            ],
            attention: Attention::across(&scope.at("goals_2D_cross_attention"), width, width)?,
            decoder: ResCat::new(&scope.at("goals_2D_decoder"), 3 * width, width, 1)?,
            interaction: shape
                .interaction
                .then(|| InteractionHead::new(&scope.at("steering")))
                .transpose()?,
        })
    }

    pub(super) fn interaction(&self) -> Option<&InteractionHead> {
        self.interaction.as_ref()
    }

    /// *Shapes*: `goals` (n, columns), `elements` (P, hidden), `target` (1, hidden); result (n).
    pub(super) fn forward(&self, goals: &Tensor, elements: &Tensor, target: &Tensor) -> Result<Tensor> {
        let [first, second, third] = &self.goal;
        let half = target.narrow(1, 0, target.dim(1)? / 2)?;
        let u = first.forward(goals)?;
        // The published order is [u ; half]: the weight's columns for `half` come last.
        let u = second.forward_rows_then(&u, &half)?;
        let u = third.forward_rows_then(&u, &half)?;
        let attended = self.attention.forward(&u, elements)?;
        self.decoder.forward_parts(&[target], &[&u, &attended])?.squeeze(1)
    }
}
