//! Savitzky–Golay filter: each value, or its derivative, from the polynomial nearest to a window of the series.
//!
//! Within a window's reach of an end, the polynomial of the first or last window counts.

/// Largest order of the polynomial.
const MOST: usize = 3;

/// A filter: weights of the window's values for each place in the window.
pub(crate) struct Filter {
    window: usize,
    /// `rows[k]` gives the result at the window's value `k`.
    rows: Vec<Vec<f64>>,
    /// The same, by the window's values: `columns[k][place]` is `rows[place][k]`.
    columns: Vec<Vec<f64>>,
}

impl Filter {
    /// A filter of a window, with polynomials of an order up to 3, that gives a derivative (0 for the value itself) with
    /// respect to the index.
    pub(crate) fn new(window: usize, order: usize, derivative: usize) -> Self {
        let order = order.min(MOST).min(window.saturating_sub(1));
        let middle = 0.5 * (window as f64 - 1.0);
        let at = |k: usize| k as f64 - middle;
        // Polynomials that are orthonormal on the window, by their coefficients.
        let mut basis: Vec<[f64; MOST + 1]> = Vec::new();
        for power in 0..=order {
            let mut next = [0.0; MOST + 1];
            next[power] = 1.0;
            for known in &basis {
                let shared: f64 = (0..window).map(|k| value(&next, at(k), 0) * value(known, at(k), 0)).sum();
                (0..=MOST).for_each(|i| next[i] -= shared * known[i]);
            }
            let norm = (0..window).map(|k| value(&next, at(k), 0).powi(2)).sum::<f64>().sqrt();
            basis.push(next.map(|c| c / norm));
        }
        let weight = |place: usize, k: usize| {
            basis.iter().map(|p| value(p, at(place), derivative) * value(p, at(k), 0)).sum()
        };
        let rows: Vec<Vec<f64>> =
            (0..window).map(|place| (0..window).map(|k| weight(place, k)).collect()).collect();
        let columns = (0..window).map(|k| rows.iter().map(|row| row[k]).collect()).collect();
        Self { window, rows, columns }
    }

    /// The filtered series; empty if the series is shorter than the window.
    pub(crate) fn apply(&self, series: &[f64]) -> Vec<f64> {
        let Some(last) = series.len().checked_sub(self.window) else { return Vec::new() };
        if last == 0 {
            return self.apply_once(series);
        }
        let result = |k: usize| {
            let start = k.saturating_sub(self.window / 2).min(last);
            let window = &series[start..start + self.window];
            self.rows[k - start].iter().zip(window).map(|(weight, y)| weight * y).sum()
        };
        (0..series.len()).map(result).collect()
    }

    /// The filtered series of the length of the window. All sums grow together, each in the same order as alone: one
    /// after the other, each addition would wait for the one before it.
    fn apply_once(&self, series: &[f64]) -> Vec<f64> {
        let mut sums = vec![-0.0; self.window];
        for (column, y) in self.columns.iter().zip(series) {
            for (sum, weight) in sums.iter_mut().zip(column) {
                *sum += weight * y;
            }
        }
        sums
    }
}

/// A derivative of a polynomial at a point.
fn value(coefficients: &[f64; MOST + 1], x: f64, derivative: usize) -> f64 {
    (derivative..=MOST)
        .map(|power| {
            let factor: f64 = (0..derivative).map(|i| (power - i) as f64).product();
            coefficients[power] * factor * x.powi((power - derivative) as i32)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn polynomials_of_the_order_come_back_with_their_derivatives() {
        let series: Vec<f64> = (0..20).map(f64::from).map(|x| 1.0 - 0.3 * x + 0.02 * x * x * x).collect();
        let derivatives: [fn(f64) -> f64; 3] =
            [|x| 1.0 - 0.3 * x + 0.02 * x * x * x, |x| -0.3 + 0.06 * x * x, |x| 0.12 * x];
        for window in [5, 8, 15, 20] {
            for (order, exact) in derivatives.iter().enumerate() {
                let found = Filter::new(window, 3, order).apply(&series);
                for (k, found) in found.iter().enumerate() {
                    assert_relative_eq!(*found, exact(k as f64), epsilon = 1e-8);
                }
            }
        }
    }

    #[test]
    fn a_series_of_one_window_gets_the_sums_of_the_rows() {
        let filter = Filter::new(41, 2, 1);
        let series: Vec<f64> = (0..41).map(|k| (0.7 * f64::from(k)).sin()).collect();
        let rows = filter.rows.iter();
        let sums: Vec<f64> = rows.map(|row| row.iter().zip(&series).map(|(w, y)| w * y).sum()).collect();
        assert_eq!(filter.apply(&series), sums);
    }

    #[test]
    fn weights_are_the_published_ones() {
        // The classic table of five points: smoothing, slope, and curvature.
        let row = |order, derivative| Filter::new(5, order, derivative).rows[2].clone();
        let near = |found: Vec<f64>, by: f64, expected: [f64; 5]| {
            found.iter().zip(expected).for_each(|(a, b)| assert_relative_eq!(*a, b / by, epsilon = 1e-12));
        };
        near(row(2, 0), 35.0, [-3.0, 12.0, 17.0, 12.0, -3.0]);
        near(row(2, 1), 10.0, [-2.0, -1.0, 0.0, 1.0, 2.0]);
        near(row(3, 2), 7.0, [2.0, -1.0, -2.0, -1.0, 2.0]);
        assert!(Filter::new(5, 2, 0).apply(&[1.0; 4]).is_empty());
    }
}
