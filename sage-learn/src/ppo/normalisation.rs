//! Running mean and deviation of the observations, and of the size of returns.

use sage_sim::actor::Network;
use serde::{Deserialize, Serialize};

use super::super::kernels::Real;

/// Least deviation of an observation: numbers that hardly change are not blown up.
const LEAST_DEVIATION: f64 = 0.02;

/// Mean and spread of columns of numbers, over all rows so far (Chan et al. 1983).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Running {
    /// Rows so far.
    pub count: f64,
    /// Mean of each column.
    pub mean: Vec<f64>,
    /// Sum of the squared distances from the mean of each column.
    pub squares: Vec<f64>,
}

impl Running {
    /// Nothing yet.
    pub fn new(columns: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; columns], squares: vec![0.0; columns] }
    }

    /// Adds rows.
    pub fn add<T: Real>(&mut self, rows: &[T]) {
        let columns = self.mean.len();
        let count = (rows.len() / columns) as f64;
        if count == 0.0 {
            return;
        }
        let mut mean = vec![0.0; columns];
        for row in rows.chunks_exact(columns) {
            mean.iter_mut().zip(row).for_each(|(sum, x)| *sum += x.wide());
        }
        mean.iter_mut().for_each(|sum| *sum /= count);
        let mut squares = vec![0.0; columns];
        for row in rows.chunks_exact(columns) {
            for ((sum, x), mean) in squares.iter_mut().zip(row).zip(&mean) {
                *sum += (x.wide() - mean).powi(2);
            }
        }
        let all = self.count + count;
        let known = self.mean.iter_mut().zip(&mut self.squares);
        for ((mean, squares), (new_mean, new_squares)) in known.zip(mean.iter().zip(&squares)) {
            let gap = new_mean - *mean;
            *mean += gap * count / all;
            *squares += new_squares + gap * gap * self.count * count / all;
        }
        self.count = all;
    }

    /// Standard deviation of each column; 1 before any row.
    pub fn deviations(&self) -> Vec<f64> {
        if self.count == 0.0 {
            return vec![1.0; self.mean.len()];
        }
        self.squares.iter().map(|squares| (squares / self.count).sqrt()).collect()
    }

    /// Standard deviations by which observations are divided.
    fn scales(&self) -> Vec<f64> {
        self.deviations().into_iter().map(|deviation| deviation.max(LEAST_DEVIATION)).collect()
    }

    /// Writes `(row − mean)/deviation` of each row.
    pub fn normalise<T: Real>(&self, rows: &[T], to: &mut Vec<T>) {
        let factors: Vec<T> = self.scales().into_iter().map(|scale| T::of(1.0 / scale)).collect();
        let mean: Vec<T> = self.mean.iter().map(|mean| T::of(*mean)).collect();
        to.clear();
        to.reserve(rows.len());
        for row in rows.chunks_exact(mean.len()) {
            to.extend(row.iter().zip(&mean).zip(&factors).map(|((x, mean), factor)| (*x - *mean) * *factor));
        }
    }

    /// The network that does with observations as they are what this one does with normalised ones.
    pub fn folded<T: Real>(&self, network: &Network<T>) -> Network<T> {
        let mut folded = network.clone();
        let shape = *network.shape();
        let scales = self.scales();
        let (weights, rest) = folded.parameters_mut().split_at_mut(shape.hidden[0] * shape.inputs);
        for (row, bias) in weights.chunks_exact_mut(shape.inputs).zip(rest) {
            let mut shift = 0.0;
            for ((weight, scale), mean) in row.iter_mut().zip(&scales).zip(&self.mean) {
                let scaled = weight.wide() / scale;
                shift += scaled * mean;
                *weight = T::of(scaled);
            }
            *bias = T::of(bias.wide() - shift);
        }
        folded
    }

    /// Whether all numbers are finite and no spread is negative.
    pub fn is_sound(&self, columns: usize) -> bool {
        let finite = |numbers: &[f64]| numbers.len() == columns && numbers.iter().all(|x| x.is_finite());
        self.count >= 0.0
            && self.count.is_finite()
            && finite(&self.mean)
            && finite(&self.squares)
            && self.squares.iter().all(|x| *x >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use sage_core::seed::Rng;

    use super::*;
    use sage_sim::actor::Shape;
    use sage_sim::actor::SingleRow;

    #[test]
    fn parts_give_the_mean_and_deviation_of_the_whole() {
        let mut rng = Rng::new(1, "running", "test");
        let rows: Vec<f64> = (0..60).map(|k| rng.uniform(0.0, 1.0 + f64::from(k % 3))).collect();
        let mut parts = Running::new(3);
        [&rows[..3], &rows[3..33], &rows[33..]].into_iter().for_each(|part| parts.add(part));
        for column in 0..3 {
            let all: Vec<f64> = rows.iter().skip(column).step_by(3).copied().collect();
            let mean = all.iter().sum::<f64>() / 20.0;
            let variance = all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 20.0;
            assert!((parts.mean[column] - mean).abs() < 1e-12);
            assert!((parts.deviations()[column] - variance.sqrt()).abs() < 1e-12);
        }
    }

    #[test]
    fn the_folded_network_is_the_normalised_one() {
        let mut rng = Rng::new(2, "folded", "test");
        let shape = Shape { inputs: 101, hidden: [128, 128], outputs: 2 };
        let network = Network::<f32>::random(shape, &mut rng);
        // Constant columns, and columns of very different sizes.
        let rows: Vec<f32> =
            (0..101 * 300)
                .map(|k| {
                    if k % 101 < 7 {
                        0.5
                    } else {
                        rng.uniform(0.0, 0.02 + 0.0098 * f64::from(k % 101)) as f32
                    }
                })
                .collect();
        let mut running = Running::new(101);
        running.add(&rows);
        let folded = running.folded(&network);
        let mut normalised = Vec::new();
        running.normalise(&rows, &mut normalised);
        let mut memory = SingleRow::default();
        for (row, normalised) in rows.chunks_exact(101).zip(normalised.chunks_exact(101)) {
            let [mut a, mut b] = [[0.0_f32; 2]; 2];
            folded.forward_one(row, &mut memory, &mut a);
            network.forward_one(normalised, &mut memory, &mut b);
            for (a, b) in a.iter().zip(b) {
                assert!((a.tanh() - b.tanh()).abs() < 1e-6, "{a} and {b}");
            }
        }
    }
}
