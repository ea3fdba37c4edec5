//! Smoothing of a series of points: `(I + λ DᵀD)⁻¹` with third differences `D` that start from zeros.

use sage_core::geometry::Point;

/// Half the width of the band.
const BAND: usize = 3;
/// Coefficients of a third difference, the latest value first.
const DIFFERENCE: [f64; BAND + 1] = [1.0, -3.0, 3.0, -1.0];

/// The factors of the matrix.
pub(crate) struct Smoothing {
    /// Lower factor: `lower[k][j]` belongs to row `k` and column `k − 1 − j`.
    lower: Vec<[f64; BAND]>,
    diagonal: Vec<f64>,
}

impl Smoothing {
    /// For series of a length, with a weight λ of the squared third differences.
    pub(crate) fn new(length: usize, lambda: f64) -> Self {
        // Row k of D has the entries of DIFFERENCE at k, k − 1, k − 2, k − 3.
        let entry = |row: usize, column: usize| -> f64 {
            let shared = (row.max(column)..=(row.min(column) + BAND).min(length - 1))
                .map(|k| DIFFERENCE[k - row] * DIFFERENCE[k - column]);
            lambda * shared.sum::<f64>() + if row == column { 1.0 } else { 0.0 }
        };
        let (mut lower, mut diagonal) = (vec![[0.0; BAND]; length], vec![0.0; length]);
        for row in 0..length {
            for j in (0..BAND.min(row)).rev() {
                let column = row - 1 - j;
                let mut value = entry(row, column);
                for between in row.saturating_sub(BAND)..column {
                    if column - between <= BAND {
                        value -= lower[row][row - 1 - between]
                            * lower[column][column - 1 - between]
                            * diagonal[between];
                    }
                }
                lower[row][j] = value / diagonal[column];
            }
            let mut value = entry(row, row);
            for j in 0..BAND.min(row) {
                value -= lower[row][j] * lower[row][j] * diagonal[row - 1 - j];
            }
            diagonal[row] = value;
        }
        Self { lower, diagonal }
    }

    /// Smooths a series.
    pub(crate) fn apply(&self, series: &mut [Point]) {
        for i in 0..2 {
            for row in 0..series.len() {
                for j in 0..BAND.min(row) {
                    series[row][i] -= self.lower[row][j] * series[row - 1 - j][i];
                }
            }
            series.iter_mut().zip(&self.diagonal).for_each(|(point, by)| point[i] /= by);
            for row in (0..series.len()).rev() {
                let value = series[row][i];
                for j in 0..BAND.min(row) {
                    series[row - 1 - j][i] -= self.lower[row][j] * value;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn it_solves_its_equation() {
        let (length, lambda) = (30, 50.0);
        let series: Vec<Point> = (0..length).map(|k| [(k as f64 * 0.7).sin(), f64::from(k == 12)]).collect();
        let mut smooth = series.clone();
        Smoothing::new(length as usize, lambda).apply(&mut smooth);
        // (I + λ DᵀD) x, row by row.
        for i in 0..2 {
            let x = |k: i32| if k < 0 { 0.0 } else { smooth[k as usize][i] };
            let third = |k: i32| x(k) - 3.0 * x(k - 1) + 3.0 * x(k - 2) - x(k - 3);
            for k in 0..length {
                let transposed: f64 =
                    (0..=3).filter(|n| k + n < length).map(|n| DIFFERENCE[n as usize] * third(k + n)).sum();
                assert_relative_eq!(x(k) + lambda * transposed, series[k as usize][i], epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn a_strong_one_leaves_no_kink() {
        let mut series: Vec<Point> = (0..80).map(|k| [f64::from(k == 40), 0.0]).collect();
        Smoothing::new(80, 1e6).apply(&mut series);
        let jerk =
            |k: usize| series[k][0] - 3.0 * series[k - 1][0] + 3.0 * series[k - 2][0] - series[k - 3][0];
        let greatest = series.iter().map(|p| p[0].abs()).fold(0.0, f64::max);
        assert!((3..80).all(|k| jerk(k).abs() < 0.01 * greatest), "{greatest}");
    }
}
