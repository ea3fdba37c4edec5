//! Two quadratic rewards with general Hessians.

use nalgebra::{DMatrix, DVector};
use sage_core::seed::Rng;

use crate::{
    Bounds, Preference,
    random::{normals, rotation, spectrum},
    reward::Curvature,
    root,
};

/// R_adv and R_real with these Hessians of −R and optima.
pub struct Quadratics {
    pub hessians: [DMatrix<f64>; 2],
    pub optima: [DVector<f64>; 2],
    pub curvatures: [Curvature; 2],
}

/// Numbers of a shape.
pub const SHAPE: usize = 7;

/// What a preference gets from the segment of the experts.
pub struct Segment {
    /// Best λ and gap by the formulas, and by search.
    pub formula: [f64; 2],
    pub direct: [f64; 2],
    /// Best λ before it is clipped to [0, 1].
    pub free: f64,
    /// Gap of the better of both experts alone.
    pub expert_gap: f64,
    /// Distance of the optimum from the line through the experts.
    pub off_line: f64,
    /// Distance D between the experts.
    pub distance: f64,
}

impl Quadratics {
    /// Spectra log-uniform in [1, κ] with both ends, random rotations, normal optima.
    pub fn draw(rng: &mut Rng, dimension: usize, condition: f64) -> Self {
        let hessians = [(); 2].map(|()| {
            let directions = rotation(rng, dimension);
            let spectrum = spectrum(rng, dimension, [1.0, condition]);
            let matrix = &directions * DMatrix::from_diagonal(&spectrum) * directions.transpose();
            0.5 * (&matrix + matrix.transpose())
        });
        let optima = [(); 2].map(|()| normals(rng, dimension));
        Self { hessians, optima, curvatures: [Curvature { m: 1.0, l: condition }; 2] }
    }

    /// Quadratics in the plane by the logarithms of four eigenvalues, the turn between both Hessians and the place of
    /// one optimum relative to the other.
    pub fn of_shape(shape: &[f64; SHAPE]) -> Self {
        let [a, b, c, d, turn, x, y] = *shape;
        let matrix = |eigenvalues: [f64; 2], turn: f64| {
            let (sin, cos) = turn.sin_cos();
            let axes = DMatrix::from_row_slice(2, 2, &[cos, -sin, sin, cos]);
            &axes * DMatrix::from_diagonal(&DVector::from_row_slice(&eigenvalues)) * axes.transpose()
        };
        // Rounding decides where Hessians are further from round.
        let eigenvalues = [[a, b], [c, d]].map(|pair| pair.map(|log| log.clamp(-7.0, 7.0).exp()));
        let curvatures = eigenvalues.map(|[p, q]| Curvature { m: p.min(q), l: p.max(q) });
        Self {
            hessians: [matrix(eigenvalues[0], 0.0), matrix(eigenvalues[1], turn)],
            optima: [DVector::from_row_slice(&[x, y]), DVector::zeros(2)],
            curvatures,
        }
    }

    fn hessian(&self, weight: f64) -> DMatrix<f64> {
        weight * &self.hessians[0] + (1.0 - weight) * &self.hessians[1]
    }

    /// The optimum of a preference; `None` if the Hessian cannot be inverted.
    pub fn optimum(&self, weight: f64) -> Option<DVector<f64>> {
        let pull = weight * &self.hessians[0] * &self.optima[0]
            + (1.0 - weight) * &self.hessians[1] * &self.optima[1];
        Some(self.hessian(weight).cholesky()?.solve(&pull))
    }

    /// Bounds of the gap for experts at a distance.
    pub fn bounds(&self, at: Preference, distance: f64) -> Bounds {
        Bounds::of(at, self.curvatures, distance)
    }

    /// The segment by the formulas, with an error in place of the formula if injected (0: h_1 and h_2 exchanged;
    /// 1: λ = c_1), and by search; `None` if a Hessian cannot be inverted.
    pub fn segment(&self, at: Preference, injected: Option<usize>) -> Option<Segment> {
        let [c1, c2] = at.coefficients();
        let (first, second) = (self.optimum(at.beta)?, self.optimum(1.0 - at.beta)?);
        let (hat, own) = (self.optimum(at.mu)?, self.hessian(at.mu));
        let way = &first - &second;
        let [of_first, of_second] = [at.beta, 1.0 - at.beta].map(|weight| self.hessian(weight) * &way);
        let [mut h1, mut h2] = [&of_first, &of_second].map(|h| way.dot(h));
        if injected == Some(0) {
            (h1, h2) = (h2, h1);
        }
        let free = if injected == Some(1) { c1 } else { c1 * h1 / (c1 * h1 + c2 * h2) };
        let lambda = free.clamp(0.0, 1.0);
        let gradient = c1 * (1.0 - lambda) * &of_first - c2 * lambda * &of_second;
        let formula = [lambda, 0.5 * gradient.dot(&own.clone().cholesky()?.solve(&gradient))];
        let point = |lambda: f64| &second + lambda * &way;
        let best = root(|lambda| (&own * (&hat - point(lambda))).dot(&way));
        let loss = |theta: &DVector<f64>| {
            let missed = theta - &hat;
            0.5 * missed.dot(&(&own * &missed))
        };
        let aside = &hat - &second;
        let along = aside.dot(&way) / way.norm_squared();
        Some(Segment {
            formula,
            direct: [best, loss(&point(best))],
            free,
            expert_gap: loss(&first).min(loss(&second)),
            off_line: (aside - along * &way).norm(),
            distance: way.norm(),
        })
    }
}
