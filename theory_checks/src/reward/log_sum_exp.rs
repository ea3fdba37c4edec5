//! `R(θ) = −[m/2 ‖x‖² + k log Σ_i exp(a_i·x + b_i)]` with `x = θ − t`.

use nalgebra::{DMatrix, DVector};
use sage_core::seed::Rng;

use super::{Concave, Curvature};
use crate::random::{normal_matrix, normals};

/// The logarithm of a sum of exponentials, with a quadratic.
#[derive(Clone, Debug)]
pub struct LogSumExp {
    curvature: Curvature,
    /// k, so that the curvature is at most L.
    weight: f64,
    /// a_i row by row.
    rows: DMatrix<f64>,
    offsets: DVector<f64>,
    center: DVector<f64>,
}

impl LogSumExp {
    /// A random member with between 3 and 20 exponentials.
    pub fn draw(rng: &mut Rng, curvature: Curvature, center: DVector<f64>) -> Self {
        let dimension = center.len();
        let count = dimension.clamp(3, 20);
        let rows = normal_matrix(rng, count, dimension) / (dimension as f64).sqrt();
        let pairs = (0..count).flat_map(|i| (0..i).map(move |j| (i, j)));
        // The variance of a_i·v under any probabilities is at most a quarter of the square of its range.
        let widest =
            pairs.map(|(i, j)| (rows.row(i) - rows.row(j)).norm_squared()).fold(f64::MIN_POSITIVE, f64::max);
        let weight = 4.0 * (curvature.l - curvature.m) / widest;
        Self { curvature, weight, rows, offsets: normals(rng, count), center }
    }

    /// The logarithm of the sum, and the share of each exponential.
    fn softmax(&self, x: &DVector<f64>) -> (f64, DVector<f64>) {
        let logits = &self.rows * x + &self.offsets;
        let most = logits.max();
        let shares = logits.map(|logit| (logit - most).exp());
        let sum = shares.sum();
        (most + sum.ln(), shares / sum)
    }
}

impl Concave for LogSumExp {
    fn dimension(&self) -> usize {
        self.center.len()
    }

    fn curvature(&self) -> Curvature {
        self.curvature
    }

    fn value(&self, theta: &DVector<f64>) -> f64 {
        let x = theta - &self.center;
        -(0.5 * self.curvature.m * x.norm_squared() + self.weight * self.softmax(&x).0)
    }

    fn gradient(&self, theta: &DVector<f64>) -> DVector<f64> {
        let x = theta - &self.center;
        let (_, shares) = self.softmax(&x);
        -(self.curvature.m * x + self.weight * self.rows.tr_mul(&shares))
    }

    fn hessian(&self, theta: &DVector<f64>) -> DMatrix<f64> {
        let (_, shares) = self.softmax(&(theta - &self.center));
        let mean = self.rows.tr_mul(&shares);
        let mut scaled = self.rows.clone();
        for (mut row, share) in scaled.row_iter_mut().zip(&shares) {
            row *= *share;
        }
        let mut hessian = self.weight * (self.rows.tr_mul(&scaled) - &mean * mean.transpose());
        for k in 0..self.dimension() {
            hessian[(k, k)] += self.curvature.m;
        }
        hessian
    }
}
