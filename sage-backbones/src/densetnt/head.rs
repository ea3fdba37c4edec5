//! Trajectory decoder of a goal.
//!
//! The published head regresses free waypoints, which jitter at 10 Hz. The other head gives smooth
//! trajectories ([`smooth_path`]) that end on their goals.

use candle_core::{Module, Result, Tensor};
use sage_core::motion::HORIZON;
use serde::{Deserialize, Serialize};

use super::Shape;
use crate::{
    nn::{Attention, Mlp, ResCat},
    parameters::Scope,
    smooth_path,
};

/// How a goal is decoded to a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadKind {
    /// 80 free positions, as published.
    Waypoints,
    /// A polynomial velocity that starts at the present velocity and leads to the goal.
    Bernstein,
}

pub(super) struct Head {
    kind: HeadKind,
    goal: [Mlp; 3],
    attention: Attention,
    decoder: ResCat,
}

impl Head {
    pub(super) fn new(scope: &Scope, shape: &Shape) -> Result<Self> {
        let width = shape.hidden;
        let layers = scope.at("goals_2D_mlps");
        let outputs = match shape.head {
            HeadKind::Waypoints => 2 * HORIZON,
            HeadKind::Bernstein => smooth_path::CHANGES,
        };
        Ok(Self {
            kind: shape.head,
            goal: [
                Mlp::new(&layers.at(0), shape.goal_columns, width)?,
                Mlp::new(&layers.at(1), width, width)?,
                Mlp::new(&layers.at(2), width, width)?,
            ],
            attention: Attention::across(&scope.at("tnt_cross_attention"), width, width)?,
            decoder: ResCat::new(&scope.at("tnt_decoder"), 3 * width, width, outputs)?,
        })
    }

    /// Points of the trajectories at every `stride`-th step.
    ///
    /// *Shapes*: `rows` (n, columns) describe goals at `ends`; `elements` (P, hidden); `target` (1, hidden);
    /// result (n, 80 / `stride`, 2), target frame.
    pub(super) fn forward(
        &self,
        rows: &Tensor,
        ends: &[[f32; 2]],
        elements: &Tensor,
        target: &Tensor,
        velocity: [f32; 2],
        stride: usize,
    ) -> Result<Tensor> {
        let mut t = rows.clone();
        for layer in &self.goal {
            t = layer.forward(&t)?;
        }
        let attended = self.attention.forward(&t, elements)?;
        let out = self.decoder.forward_parts(&[target], &[&t, &attended])?;
        match self.kind {
            HeadKind::Waypoints => smooth_path::every(&out.reshape((ends.len(), HORIZON, 2))?, stride),
            HeadKind::Bernstein => smooth_path::places(&out, ends, velocity[0], stride),
        }
    }
}
