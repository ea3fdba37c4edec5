//! Networks with one hidden layer of tanh, and their exact derivatives along a line of weights.

use nalgebra::{DMatrix, DVector};
use sage_core::seed::Rng;

use crate::random::{normal_matrix, normals};

/// Weights of `f(x) = V tanh(W x + b)`, or a direction of them.
#[derive(Clone, Debug)]
pub struct TanhNet {
    /// W, a row for each hidden unit.
    pub inner: DMatrix<f64>,
    /// b.
    pub offsets: DVector<f64>,
    /// V, a row for each output.
    pub outer: DMatrix<f64>,
}

/// Outputs and their first two derivatives along a direction, a column for each input.
#[derive(Clone, Debug)]
pub struct Along {
    /// f.
    pub output: DMatrix<f64>,
    /// f' = J δ.
    pub slope: DMatrix<f64>,
    /// f'' = δᵀ (∇² f) δ.
    pub bend: DMatrix<f64>,
}

impl TanhNet {
    /// Normal weights with a scale, divided by the root of the number of inputs of their layer.
    pub fn draw(rng: &mut Rng, [inputs, hidden, outputs]: [usize; 3], scale: f64) -> Self {
        Self {
            inner: normal_matrix(rng, hidden, inputs) * (scale / (inputs as f64).sqrt()),
            offsets: normals(rng, hidden) * scale,
            outer: normal_matrix(rng, outputs, hidden) * (scale / (hidden as f64).sqrt()),
        }
    }

    /// `self + share δ`.
    pub fn plus(&self, share: f64, delta: &Self) -> Self {
        Self {
            inner: &self.inner + share * &delta.inner,
            offsets: &self.offsets + share * &delta.offsets,
            outer: &self.outer + share * &delta.outer,
        }
    }

    fn hidden(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let mut z = &self.inner * inputs;
        for mut column in z.column_iter_mut() {
            column += &self.offsets;
        }
        z.map(f64::tanh)
    }

    /// Outputs, a column for each input.
    pub fn outputs(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        &self.outer * self.hidden(inputs)
    }

    /// Outputs with derivatives along a direction.
    pub fn along(&self, delta: &Self, inputs: &DMatrix<f64>) -> Along {
        let h = self.hidden(inputs);
        let mut dz = &delta.inner * inputs;
        for mut column in dz.column_iter_mut() {
            column += &delta.offsets;
        }
        let slope = h.zip_map(&dz, |h, dz| (1.0 - h * h) * dz);
        let bend = h.zip_map(&dz, |h, dz| -2.0 * h * (1.0 - h * h) * dz * dz);
        Along {
            output: &self.outer * &h,
            slope: &delta.outer * &h + &self.outer * &slope,
            bend: 2.0 * &delta.outer * slope + &self.outer * bend,
        }
    }

    /// Gradient of the loss `½ E‖f − y‖²`.
    pub fn gradient(&self, inputs: &DMatrix<f64>, targets: &DMatrix<f64>) -> Self {
        let h = self.hidden(inputs);
        let residual = (&self.outer * &h - targets) / inputs.ncols() as f64;
        let back = self.outer.tr_mul(&residual).zip_map(&h, |back, h| back * (1.0 - h * h));
        Self {
            inner: &back * inputs.transpose(),
            offsets: back.column_sum(),
            outer: residual * h.transpose(),
        }
    }

    /// Trained on the loss by gradient descent with momentum, which moves less for smaller residuals.
    pub fn trained(&self, inputs: &DMatrix<f64>, targets: &DMatrix<f64>, steps: usize, rate: f64) -> Self {
        const MOMENTUM: f64 = 0.9;
        let start = (self.clone(), 0.0 * self);
        let (net, _) = (0..steps).fold(start, |(net, speed), _| {
            let speed = (MOMENTUM * &speed).plus(-rate, &net.gradient(inputs, targets));
            (net.plus(1.0, &speed), speed)
        });
        net
    }

    /// `self − other`.
    pub fn minus(&self, other: &Self) -> Self {
        self.plus(-1.0, other)
    }

    /// Squared length of all weights.
    pub fn norm_squared(&self) -> f64 {
        self.inner.norm_squared() + self.offsets.norm_squared() + self.outer.norm_squared()
    }
}

impl std::ops::Mul<&TanhNet> for f64 {
    type Output = TanhNet;

    fn mul(self, net: &TanhNet) -> TanhNet {
        TanhNet { inner: self * &net.inner, offsets: self * &net.offsets, outer: self * &net.outer }
    }
}

/// Mean over inputs of `½‖f − y‖²`.
pub fn loss(outputs: &DMatrix<f64>, targets: &DMatrix<f64>) -> f64 {
    0.5 * (outputs - targets).norm_squared() / outputs.ncols() as f64
}

/// Mean over inputs of the product of two vectors.
pub fn expected(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    a.dot(b) / a.ncols() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_differences_and_training_lowers_the_loss() {
        let mut rng = Rng::new(0, "tanh", "test");
        let [net, delta] = [(); 2].map(|()| TanhNet::draw(&mut rng, [4, 6, 3], 1.0));
        let inputs = normal_matrix(&mut rng, 4, 20);
        let targets = normal_matrix(&mut rng, 3, 20);
        let along = net.along(&delta, &inputs);
        let step = 1e-4;
        let [before, after] = [-step, step].map(|share| net.plus(share, &delta).outputs(&inputs));
        let slope = (&after - &before) / (2.0 * step);
        let bend = (&after - 2.0 * &along.output + &before) / (step * step);
        assert!((slope - &along.slope).norm() < 1e-6 && (bend - &along.bend).norm() < 1e-5);
        let of_loss = (loss(&after, &targets) - loss(&before, &targets)) / (2.0 * step);
        let gradient = net.gradient(&inputs, &targets);
        let along_delta = gradient.inner.dot(&delta.inner)
            + gradient.offsets.dot(&delta.offsets)
            + gradient.outer.dot(&delta.outer);
        assert!((of_loss - along_delta).abs() < 1e-6);
        let trained = net.trained(&inputs, &targets, 200, 0.02);
        assert!(loss(&trained.outputs(&inputs), &targets) < 0.5 * loss(&along.output, &targets));
    }
}
