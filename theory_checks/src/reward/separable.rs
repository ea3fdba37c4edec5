//! Rewards that are sums over rotated coordinates: `R(θ) = −Σ_j φ_j(u_j)` with `u = Q (θ − t)`.

use nalgebra::{DMatrix, DVector};
use sage_core::seed::Rng;

use super::{Concave, Curvature};
use crate::random::{normals, rotation, spectrum};

/// What φ is. Curvatures lie in [m, L].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// `e_j u²/2` with e_j in [m, L].
    Quadratic,
    /// `m/2 u² + (L − m) log cosh u`.
    LogCosh,
    /// `m/2 u² + 4 (L − m) log(1 + exp(u − b_j))`, whose optimum is not at 0.
    Softplus,
    /// `m/2 u² + (L − m) (√(1 + u²) − 1)`.
    PseudoHuber,
}

/// A sum over rotated coordinates.
#[derive(Clone, Debug)]
pub struct Separable {
    shape: Shape,
    curvature: Curvature,
    rotation: DMatrix<f64>,
    center: DVector<f64>,
    /// `e_j` of the quadratic, `b_j` of softplus.
    parameters: DVector<f64>,
}

/// φ and its first two derivatives.
type Derivatives = [f64; 3];

impl Separable {
    /// A reward from all its parts; `parameters` are `e_j` of the quadratic or `b_j` of softplus.
    pub fn new(
        shape: Shape,
        curvature: Curvature,
        rotation: DMatrix<f64>,
        center: DVector<f64>,
        parameters: DVector<f64>,
    ) -> Self {
        Self { shape, curvature, rotation, center, parameters }
    }

    /// A random member.
    pub fn draw(shape: Shape, rng: &mut Rng, curvature: Curvature, center: DVector<f64>) -> Self {
        let dimension = center.len();
        let rotation = rotation(rng, dimension);
        let parameters = match shape {
            Shape::Quadratic => spectrum(rng, dimension, [curvature.m, curvature.l]),
            Shape::Softplus => normals(rng, dimension),
            Shape::LogCosh | Shape::PseudoHuber => DVector::zeros(dimension),
        };
        Self { shape, curvature, rotation, center, parameters }
    }

    /// A quadratic with one curvature in all directions.
    pub fn isotropic(curvature: f64, center: DVector<f64>) -> Self {
        let dimension = center.len();
        Self {
            shape: Shape::Quadratic,
            curvature: Curvature { m: curvature, l: curvature },
            rotation: DMatrix::identity(dimension, dimension),
            parameters: DVector::from_element(dimension, curvature),
            center,
        }
    }

    fn coordinates(&self, theta: &DVector<f64>) -> DVector<f64> {
        &self.rotation * (theta - &self.center)
    }

    fn derivatives(&self, coordinate: usize, u: f64) -> Derivatives {
        let (m, more) = (self.curvature.m, self.curvature.l - self.curvature.m);
        let [value, slope, bend] = match self.shape {
            Shape::Quadratic => {
                let e = self.parameters[coordinate];
                return [0.5 * e * u * u, e * u, e];
            }
            Shape::LogCosh => {
                let tanh = u.tanh();
                // log cosh u without overflow.
                let value = u.abs() + (-2.0 * u.abs()).exp().ln_1p() - std::f64::consts::LN_2;
                [value, tanh, 1.0 - tanh * tanh]
            }
            Shape::Softplus => {
                let z = u - self.parameters[coordinate];
                let sigmoid = 1.0 / (1.0 + (-z).exp());
                let value = z.max(0.0) + (-z.abs()).exp().ln_1p();
                [4.0 * value, 4.0 * sigmoid, 4.0 * sigmoid * (1.0 - sigmoid)]
            }
            Shape::PseudoHuber => {
                let root = (1.0 + u * u).sqrt();
                [root - 1.0, u / root, root.powi(-3)]
            }
        };
        [0.5 * m * u * u + more * value, m * u + more * slope, m + more * bend]
    }

    /// One of the derivatives at every coordinate.
    fn each(&self, theta: &DVector<f64>, order: usize) -> DVector<f64> {
        let u = self.coordinates(theta);
        DVector::from_fn(u.len(), |k, _| self.derivatives(k, u[k])[order])
    }
}

impl Concave for Separable {
    fn dimension(&self) -> usize {
        self.center.len()
    }

    fn curvature(&self) -> Curvature {
        self.curvature
    }

    fn value(&self, theta: &DVector<f64>) -> f64 {
        -self.each(theta, 0).sum()
    }

    fn gradient(&self, theta: &DVector<f64>) -> DVector<f64> {
        -self.rotation.tr_mul(&self.each(theta, 1))
    }

    fn hessian(&self, theta: &DVector<f64>) -> DMatrix<f64> {
        let bends = self.each(theta, 2);
        let mut scaled = self.rotation.clone();
        for mut column in scaled.column_iter_mut() {
            column.component_mul_assign(&bends);
        }
        self.rotation.transpose() * scaled
    }
}
