//! Principal components of a prior and its experts: the plane that shows most of their distances.

use nalgebra::{DMatrix, SymmetricEigen};
use sage_merging::Geometry;

/// The first two principal components of prior and experts, weighted equally.
pub(crate) struct Components {
    /// Products of the preference vectors.
    products: DMatrix<f64>,
    /// Mean of the points, as weights of the experts.
    mean: Vec<f64>,
    /// The axes, as weights of the experts.
    axes: [Vec<f64>; 2],
    /// Share of the squared distances from the mean along each axis.
    pub(crate) shares: [f64; 2],
}

impl Components {
    /// The components of a number of experts and their prior; `None` if the points have no two directions.
    pub(crate) fn of(geometry: &Geometry, experts: usize) -> Option<Self> {
        let products = DMatrix::from_fn(experts, experts, |a, b| geometry.product(a, b));
        let count = experts + 1;
        let mean = vec![1.0 / count as f64; experts];
        // The points minus their mean, as weights of the experts: the prior first, then each expert.
        let centred = DMatrix::from_fn(count, experts, |point, expert| {
            f64::from(u8::from(point == expert + 1)) - mean[expert]
        });
        let eigen = SymmetricEigen::new(&centred * &products * centred.transpose());
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let total: f64 = eigen.eigenvalues.iter().map(|value| value.max(0.0)).sum();
        let axis = |k: usize| -> Option<(Vec<f64>, f64)> {
            let value = eigen.eigenvalues[*order.get(k)?];
            if value <= 1e-12 * total.max(f64::MIN_POSITIVE) {
                return None;
            }
            let vector = eigen.eigenvectors.column(order[k]) / value.sqrt();
            // The sign of an axis is arbitrary: the point farthest along it is on its positive side.
            let along = &centred * &products * (centred.transpose() * &vector);
            let farthest = along.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
            let weights = centred.transpose() * vector * farthest.signum();
            Some((weights.iter().copied().collect(), value / total))
        };
        let ((first, a), (second, b)) = (axis(0)?, axis(1)?);
        Some(Self { products, mean, axes: [first, second], shares: [a, b] })
    }

    /// Coordinates of a model at weights of the experts: the prior plus the weighted preference vectors.
    pub(crate) fn coordinates(&self, weights: &[f64]) -> [f64; 2] {
        let from_mean: Vec<f64> =
            weights.iter().zip(&self.mean).map(|(weight, mean)| weight - mean).collect();
        let dot = |axis: &Vec<f64>| {
            let row = |a: usize| -> f64 { (0..axis.len()).map(|b| self.products[(a, b)] * axis[b]).sum() };
            (0..axis.len()).map(|a| from_mean[a] * row(a)).sum()
        };
        [dot(&self.axes[0]), dot(&self.axes[1])]
    }
}
