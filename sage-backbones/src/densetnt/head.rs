//! From a goal to a trajectory.
//!
//! Waypoints as published are free numbers and jitter at 10 Hz. The Bernstein head gives ten
//! coefficients of the velocity along each axis instead: the first is the present velocity, and
//! their mean is the way to the goal over the time, so that every path starts as the car drives,
//! ends on its goal and is smooth between. The network moves what is left over from a plain ramp.

use candle_core::{Device, Result, Tensor};
use sage_core::motion::{DT, HORIZON};
use serde::{Deserialize, Serialize};

use super::Shape;
use crate::{
    nn::{Attention, Mlp, ResCat},
    parameters::Scope,
};

/// Coefficients of the velocity along one axis.
const COEFFICIENTS: usize = 10;
/// What the network moves of them: all but the first.
const FREE: usize = COEFFICIENTS - 1;
/// Size of a change that the network asks for with 1, m/s.
const UNIT: f64 = 4.0;
/// Seconds to the goal.
const T: f64 = HORIZON as f64 * DT;

/// How a goal becomes a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadKind {
    /// 80 free positions, as published.
    Waypoints,
    /// A polynomial velocity that starts as the car drives and leads to the goal.
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
            HeadKind::Bernstein => 2 * FREE,
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

    /// *Shapes*: `rows` (n, columns) describe goals at `ends`; result (n, 80, 2), target frame.
    pub(super) fn forward(
        &self,
        rows: &Tensor,
        ends: &[[f32; 2]],
        elements: &Tensor,
        target: &Tensor,
        velocity: [f32; 2],
    ) -> Result<Tensor> {
        let mut t = rows.clone();
        for layer in &self.goal {
            t = layer.forward(&t)?;
        }
        let seen = self.attention.forward(&t, elements)?;
        let out = self.decoder.forward_parts(&[target], &[&t, &seen])?;
        match self.kind {
            HeadKind::Waypoints => out.reshape((ends.len(), HORIZON, 2)),
            HeadKind::Bernstein => bernstein(&out, ends, velocity),
        }
    }
}

/// Paths of changes (n, 18): nine along x, then nine along y.
pub(crate) fn bernstein(changes: &Tensor, ends: &[[f32; 2]], velocity: [f32; 2]) -> Result<Tensor> {
    let (n, dtype) = (ends.len(), changes.dtype());
    let constant = |values: Vec<f64>, shape: (usize, usize)| {
        Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(dtype)
    };
    let basis = constant(basis(), (COEFFICIENTS, HORIZON))?;
    // Takes the mean away, so that no change moves the end.
    let centre = constant(centring(), (FREE, COEFFICIENTS))?;
    let mut axes = Vec::with_capacity(2);
    for axis in 0..2 {
        let base: Vec<f64> = ends.iter().flat_map(|end| ramp(end, f64::from(velocity[0]), axis)).collect();
        let change = changes.narrow(1, axis * FREE, FREE)?.matmul(&centre)?;
        let coefficients = (constant(base, (n, COEFFICIENTS))? + (change * UNIT)?)?;
        axes.push(coefficients.matmul(&basis)?);
    }
    Tensor::stack(&axes, 2)
}

/// Velocity coefficients that lead straight from the present velocity (along x) to an end. Along x
/// the velocity changes evenly, or falls faster at first where an even change would go into reverse.
fn ramp(end: &[f32; 2], speed: f64, axis: usize) -> [f64; COEFFICIENTS] {
    let mean = f64::from(end[axis]) / T;
    let start = if axis == 0 { speed } else { 0.0 };
    let share = |k: usize| k as f64 / FREE as f64;
    let ratio = if start > 0.1 { mean / start } else { 1.0 };
    let power = if (0.0..0.5).contains(&ratio) { (1.0 / ratio.max(0.02) - 1.0).min(20.0) } else { 1.0 };
    let mut coefficients = [0.0; COEFFICIENTS];
    for (k, c) in coefficients.iter_mut().enumerate() {
        *c = start * (1.0 - share(k)).powf(power);
    }
    let missing = mean * COEFFICIENTS as f64 - coefficients.iter().sum::<f64>();
    let total: f64 = (0..COEFFICIENTS).map(share).sum();
    for (k, c) in coefficients.iter_mut().enumerate() {
        *c += missing * share(k) / total;
    }
    coefficients
}

/// Positions at the 80 steps for one unit of each velocity coefficient (10, 80): the integrals of
/// the Bernstein polynomials of degree 9 over 8 s.
fn basis() -> Vec<f64> {
    let degree = COEFFICIENTS as i32;
    let binomial = |k: i32| (0..k).fold(1.0, |b, j| b * f64::from(degree - j) / f64::from(j + 1));
    let mut out = Vec::with_capacity(COEFFICIENTS * HORIZON);
    for k in 0..degree {
        for step in 1..=HORIZON {
            let s = step as f64 / HORIZON as f64;
            let above = |j: i32| binomial(j) * s.powi(j) * (1.0 - s).powi(degree - j);
            out.push(T / f64::from(degree) * (k + 1..=degree).map(above).sum::<f64>());
        }
    }
    out
}

/// (9, 10): from nine changes to ten coefficients, the first untouched, the rest without their mean.
fn centring() -> Vec<f64> {
    let mut out = vec![0.0; FREE * COEFFICIENTS];
    for row in 0..FREE {
        for column in 0..FREE {
            let own = if row == column { 1.0 } else { 0.0 };
            out[row * COEFFICIENTS + column + 1] = own - 1.0 / FREE as f64;
        }
    }
    out
}
