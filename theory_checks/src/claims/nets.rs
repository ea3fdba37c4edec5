//! Random networks that several claims share.

use nalgebra::{DMatrix, DVector};
use sage_core::seed::Rng;

use crate::{mixing::Problem, random::normal_matrix, tanh_net::TanhNet};

/// Inputs, hidden units and outputs.
pub const SIZES: [usize; 3] = [4, 16, 3];

/// Inputs of the stored cases, which have one weight in each layer.
pub const POINTS: [f64; 3] = [-1.0, 0.5, 2.0];

/// `b tanh(a x)`.
pub fn one(a: f64, b: f64) -> TanhNet {
    TanhNet {
        inner: DMatrix::from_element(1, 1, a),
        offsets: DVector::zeros(1),
        outer: DMatrix::from_element(1, 1, b),
    }
}

/// `1.5 sin` of a random linear map of the inputs.
pub fn targets(rng: &mut Rng, inputs: &DMatrix<f64>) -> DMatrix<f64> {
    let map = normal_matrix(rng, SIZES[2], inputs.nrows());
    (map * inputs).map(|x| 1.5 * x.sin())
}

/// A random network and a random direction whose weights have the same distribution times a scale, with normal
/// inputs.
pub fn problem(rng: &mut Rng, sizes: [usize; 3], inputs: usize, scale: f64) -> Problem {
    let first = TanhNet::draw(rng, sizes, 1.0);
    let delta = TanhNet::draw(rng, sizes, scale);
    let inputs = normal_matrix(rng, sizes[0], inputs);
    let targets = targets(rng, &inputs);
    Problem { first, delta, inputs, targets }
}
