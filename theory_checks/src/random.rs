//! Random vectors and matrices.

use nalgebra::{DMatrix, DVector};
use sage_core::seed::Rng;

/// A vector of standard normal numbers.
pub fn normals(rng: &mut Rng, dimension: usize) -> DVector<f64> {
    DVector::from_fn(dimension, |_, _| rng.normal())
}

/// A matrix of standard normal numbers.
pub fn normal_matrix(rng: &mut Rng, rows: usize, columns: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |_, _| rng.normal())
}

/// A random orthogonal matrix: Q of the QR decomposition of a normal matrix.
pub fn rotation(rng: &mut Rng, dimension: usize) -> DMatrix<f64> {
    normal_matrix(rng, dimension, dimension).qr().q()
}

/// 10 to the power of a uniform number.
pub fn log_uniform(rng: &mut Rng, exponents: [f64; 2]) -> f64 {
    10f64.powf(rng.uniform(exponents[0], exponents[1]))
}

/// Numbers log-uniform in [low, high] that include both ends, or `high` alone in one dimension.
pub fn spectrum(rng: &mut Rng, dimension: usize, [low, high]: [f64; 2]) -> DVector<f64> {
    DVector::from_fn(dimension, |k, _| match k {
        0 => high,
        1 => low,
        _ => low * (high / low).powf(rng.unit()),
    })
}
