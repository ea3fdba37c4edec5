//! Norms and angles of preference vectors, the differences of the experts from their prior.
//!
//! Tensors that fine-tuning changed in no expert are left out: they would only lengthen the computation.

use crate::{Error, ExpertSet, task_arithmetic::task_vectors};

/// Scalar products of the preference vectors, in the order of the set.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Products over the whole model.
    products: Vec<Vec<f64>>,
    /// The same for each tensor.
    tensors: Vec<TensorGeometry>,
}

/// Scalar products within one tensor.
#[derive(Clone, Debug)]
pub struct TensorGeometry {
    /// Name of the tensor.
    pub name: String,
    /// Number of its values.
    pub size: usize,
    /// Scalar products of the preference vectors.
    pub products: Vec<Vec<f64>>,
}

impl Geometry {
    /// The geometry of a set.
    ///
    /// *Errors*: none on a CPU.
    pub fn of(experts: &ExpertSet) -> Result<Self, Error> {
        let count = experts.names().len();
        let mut products = vec![vec![0.0; count]; count];
        let mut tensors = Vec::new();
        for tuned in experts.tuned_tensors()? {
            let vectors = task_vectors(&tuned.set());
            let dot = |a: usize, b: usize| vectors[a].iter().zip(&vectors[b]).map(|(x, y)| x * y).sum();
            let own: Vec<Vec<f64>> = (0..count).map(|a| (0..count).map(|b| dot(a, b)).collect()).collect();
            for (row, own) in products.iter_mut().zip(&own) {
                row.iter_mut().zip(own).for_each(|(product, own)| *product += own);
            }
            tensors.push(TensorGeometry { name: tuned.name.clone(), size: tuned.prior.len(), products: own });
        }
        Ok(Self { products, tensors })
    }

    /// The geometry of vectors with known products.
    #[cfg(test)]
    pub(crate) fn of_products(products: Vec<Vec<f64>>) -> Self {
        Self { products, tensors: Vec::new() }
    }

    /// Scalar product of two preference vectors.
    pub fn product(&self, a: usize, b: usize) -> f64 {
        self.products[a][b]
    }

    /// Norm of a combination of preference vectors.
    pub fn norm(&self, weights: &[f64]) -> f64 {
        self.combined(weights, weights).max(0.0).sqrt()
    }

    /// Cosine of the angle between two combinations; NaN if one of them is 0.
    pub fn cosine(&self, a: &[f64], b: &[f64]) -> f64 {
        self.combined(a, b) / (self.norm(a) * self.norm(b))
    }

    fn combined(&self, a: &[f64], b: &[f64]) -> f64 {
        let row = |(x, row): (&f64, &Vec<f64>)| x * row.iter().zip(b).map(|(p, y)| p * y).sum::<f64>();
        a.iter().zip(&self.products).map(row).sum()
    }

    /// The tensors that fine-tuning changed.
    pub fn tensors(&self) -> &[TensorGeometry] {
        &self.tensors
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn norms_and_cosines_follow_from_the_products() {
        // Vectors (3, 0) and (1, 1).
        let geometry = Geometry { products: vec![vec![9.0, 3.0], vec![3.0, 2.0]], tensors: vec![] };
        assert_eq!(geometry.norm(&[1.0, 0.0]), 3.0);
        assert!((geometry.cosine(&[1.0, 0.0], &[0.0, 1.0]) - 0.5f64.sqrt()).abs() < 1e-15);
        // Half way lies (2, 0.5).
        assert!((geometry.norm(&[0.5, 0.5]) - 4.25f64.sqrt()).abs() < 1e-15);
        assert!((geometry.norm(&[1.0, -1.0]) - 5f64.sqrt()).abs() < 1e-15);
    }
}
