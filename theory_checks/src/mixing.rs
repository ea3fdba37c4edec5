//! Weight mixing against output mixing under the squared error, with the steps of the paper's derivation.
//!
//! θ_α = (1 − α) θ_1 + α θ_2, δ = θ_2 − θ_1, `L_w` is the loss of `f_w = f(θ_α)`, `L_e` that of
//! `f_e = (1 − α) f(θ_1) + α f(θ_2)`, `r = f_w − y`, `k = α(1 − α)/2`.

use nalgebra::DMatrix;

use crate::tanh_net::{TanhNet, expected, loss};

/// Two networks with the same architecture, with inputs and targets.
#[derive(Clone, Debug)]
pub struct Problem {
    /// θ_1.
    pub first: TanhNet,
    /// δ.
    pub delta: TanhNet,
    /// A column for each input.
    pub inputs: DMatrix<f64>,
    /// A column for each target.
    pub targets: DMatrix<f64>,
}

/// The comparison at an α. Expectations are over the inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mixing {
    /// α.
    pub alpha: f64,
    /// L_w.
    pub weight: f64,
    /// L_e.
    pub output: f64,
    /// `(1 − α) L(θ_1) + α L(θ_2)`.
    pub chord: f64,
    /// Step 1: `E[(f_w − f_e) r]`.
    pub linear: f64,
    /// `E‖f_w − f_e‖²`.
    pub apart: f64,
    /// `E‖J δ‖²`, J at θ_α.
    pub jacobian: f64,
    /// `E[r f'']` at θ_α: the residual-weighted curvature of the outputs.
    pub curvature: f64,
    /// `E‖f(θ_2) − f(θ_1)‖²`.
    pub distance: f64,
}

impl Problem {
    /// The comparison at an α.
    pub fn at(&self, alpha: f64) -> Mixing {
        let along = self.first.plus(alpha, &self.delta).along(&self.delta, &self.inputs);
        let [start, end] = [0.0, 1.0].map(|t| self.first.plus(t, &self.delta).outputs(&self.inputs));
        let mixed = (1.0 - alpha) * &start + alpha * &end;
        let residual = &along.output - &self.targets;
        let apart = &along.output - &mixed;
        let ends = [&start, &end].map(|outputs| loss(outputs, &self.targets));
        Mixing {
            alpha,
            weight: loss(&along.output, &self.targets),
            output: loss(&mixed, &self.targets),
            chord: (1.0 - alpha) * ends[0] + alpha * ends[1],
            linear: expected(&apart, &residual),
            apart: expected(&apart, &apart),
            jacobian: expected(&along.slope, &along.slope),
            curvature: expected(&residual, &along.bend),
            distance: expected(&(&end - &start), &(&end - &start)),
        }
    }

    /// The same with targets that θ_α meets.
    #[must_use]
    pub fn without_residual(&self, alpha: f64) -> Self {
        let targets = self.first.plus(alpha, &self.delta).outputs(&self.inputs);
        Self { targets, ..self.clone() }
    }
}

impl Mixing {
    /// `L_w − L_e`: negative where weight mixing is better.
    pub fn difference(&self) -> f64 {
        self.weight - self.output
    }

    /// `α (1 − α)/2`.
    pub fn k(&self) -> f64 {
        0.5 * self.alpha * (1.0 - self.alpha)
    }

    /// `L''` along the path: the Gauss–Newton part and the curvature of the outputs.
    pub fn bend(&self) -> f64 {
        self.jacobian + self.curvature
    }

    /// Step 2: f'' is taken at θ_α.
    pub fn frozen(&self) -> f64 {
        -self.k() * self.curvature
    }

    /// The formula as printed: `−k (L'' − E‖Δf‖²)`.
    pub fn printed(&self) -> f64 {
        -self.k() * (self.bend() - self.distance)
    }
}
