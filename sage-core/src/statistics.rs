//! Means with intervals, quantiles and distances between distributions.

/// An estimate with its 95 % interval and the number of values.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Estimate {
    /// The mean of the values.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
    /// Number of values.
    pub n: usize,
}

/// Arithmetic mean; `None` without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Quantile with linear interpolation, `share` in [0, 1]; `None` without values.
///
/// ```
/// use sage_core::statistics::quantile;
///
/// let times = [0.9, 1.2, 3.0];
/// assert_eq!(quantile(&times, 0.5), Some(1.2));
/// assert_eq!(quantile(&times, 0.75), Some(2.1));
/// assert_eq!(quantile(&[], 0.5), None);
/// ```
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut values = values.to_vec();
    let position = share.clamp(0.0, 1.0) * values.len().checked_sub(1)? as f64;
    let (_, low, above) = values.select_nth_unstable_by(position.floor() as usize, f64::total_cmp);
    let next = above.iter().copied().min_by(f64::total_cmp).filter(|_| position.fract() > 0.0);
    Some(*low + (next.unwrap_or(*low) - *low) * position.fract())
}

/// Median; `None` without values.
pub fn median(values: &[f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// Fraction with Wilson's 95 % interval; `None` without trials.
///
/// ```
/// use sage_core::statistics::wilson;
///
/// // 10 failures in 10 drives do not show that a driver always fails: 72 to 100 %.
/// let rate = wilson(10, 10).ok_or("no drives")?;
/// assert!(rate.value == 1.0 && (rate.low - 0.722).abs() < 1e-3);
/// assert_eq!(wilson(0, 0), None);
/// # Ok::<(), &str>(())
/// ```
pub fn wilson(successes: usize, trials: usize) -> Option<Estimate> {
    /// 97.5 % quantile of the normal distribution.
    const Z: f64 = 1.959_963_984_540_054;
    if trials == 0 || successes > trials {
        return None;
    }
    let n = trials as f64;
    let share = successes as f64 / n;
    let scale = 1.0 + Z * Z / n;
    let center = (share + Z * Z / (2.0 * n)) / scale;
    let half = Z / scale * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    // Rounding must not lead out of [0, 1].
    Some(Estimate { value: share, low: (center - half).max(0.0), high: (center + half).min(1.0), n: trials })
}

/// Spearman's rank correlation of paired values; equal values share their mean rank. 0 if all values of one
/// side are equal.
///
/// *Panics*: if the two slices differ in length.
pub fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "pairs need two equally long lists");
    let (a, b) = (ranks(a), ranks(b));
    let middle = (a.len() as f64 - 1.0) / 2.0;
    let product =
        |x: &[f64], y: &[f64]| -> f64 { x.iter().zip(y).map(|(x, y)| (x - middle) * (y - middle)).sum() };
    let size = (product(&a, &a) * product(&b, &b)).sqrt();
    if size > 0.0 { product(&a, &b) / size } else { 0.0 }
}

/// Kendall's τ-b of two lists of equal length: 1 if they order alike, −1 if they order oppositely; 0 if all values of one are
/// equal.
pub fn kendall_tau(a: &[f64], b: &[f64]) -> f64 {
    let (mut sum, mut apart) = (0.0, [0.0; 2]);
    for i in 0..a.len().min(b.len()) {
        for j in 0..i {
            let [x, y] = [(a[i], a[j]), (b[i], b[j])].map(|(p, q)| match p.partial_cmp(&q) {
                Some(std::cmp::Ordering::Less) => -1.0,
                Some(std::cmp::Ordering::Greater) => 1.0,
                _ => 0.0,
            });
            sum += x * y;
            apart = [apart[0] + f64::abs(x), apart[1] + f64::abs(y)];
        }
    }
    let scale = (apart[0] * apart[1]).sqrt();
    if scale > 0.0 { sum / scale } else { 0.0 }
}

/// Rank of each value from 0; equal values get the mean of their ranks.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for group in order.chunk_by(|a, b| values[*a] == values[*b]) {
        let mean = first as f64 + (group.len() as f64 - 1.0) / 2.0;
        group.iter().for_each(|&k| ranks[k] = mean);
        first += group.len();
    }
    ranks
}

/// 1-Wasserstein distance of two samples with equal weights: ∫ |F_a − F_b|.
///
/// 0 if either sample is empty, as in the published code.
///
/// ```
/// use sage_core::statistics::wasserstein;
///
/// // Speeds that are all 2 m/s higher are at a distance of 2 m/s, however many samples there are.
/// assert_eq!(wasserstein(&[8.0, 9.0, 13.0], &[10.0, 11.0, 15.0]), 2.0);
/// assert_eq!(wasserstein(&[8.0, 8.0], &[8.0]), 0.0);
/// ```
pub fn wasserstein(a: &[f64], b: &[f64]) -> f64 {
    if a.is_empty() || b.is_empty() {
        return 0.0;
    }
    let sorted = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted
    };
    let (a, b) = (sorted(a), sorted(b));
    let (mut i, mut j) = (0, 0);
    let mut total = 0.0;
    let mut previous = a[0].min(b[0]);
    while i < a.len() || j < b.len() {
        let next = match (a.get(i), b.get(j)) {
            (Some(&x), Some(&y)) => x.min(y),
            (Some(&x), None) => x,
            (None, Some(&y)) => y,
            (None, None) => break,
        };
        let gap = (i as f64 / a.len() as f64 - j as f64 / b.len() as f64).abs();
        total += gap * (next - previous);
        previous = next;
        while a.get(i).is_some_and(|&x| x <= next) {
            i += 1;
        }
        while b.get(j).is_some_and(|&y| y <= next) {
            j += 1;
        }
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Rng;
    use approx::assert_relative_eq;

    #[test]
    fn rank_correlation_depends_on_ranks_alone() {
        let x = [0.0, 1.0, 2.0, 3.0];
        assert!((rank_correlation(&x, &[0.1, 0.2, 5.0, 9.0]) - 1.0).abs() < 1e-12);
        assert!((rank_correlation(&x, &[3.0, 2.0, 1.0, 0.0]) + 1.0).abs() < 1e-12);
        // One tie: 4.5 / sqrt(5 · 4.5).
        assert!((rank_correlation(&x, &[0.0, 1.0, 1.0, 2.0]) - 0.948_683_298_050_513_8).abs() < 1e-12);
        assert_eq!(rank_correlation(&x, &[1.0; 4]), 0.0);
    }

    #[test]
    fn wasserstein_of_equal_sizes_is_the_mean_gap_of_sorted_values() {
        let mut rng = Rng::new(1, "wasserstein", "test");
        for _ in 0..200 {
            let n = 1 + rng.below(30);
            let mut sample = |shift: f64| -> Vec<f64> { (0..n).map(|_| shift + rng.normal()).collect() };
            let (a, b) = (sample(0.0), sample(1.0));
            let (mut x, mut y) = (a.clone(), b.clone());
            x.sort_by(f64::total_cmp);
            y.sort_by(f64::total_cmp);
            let closed = x.iter().zip(&y).map(|(p, q)| (p - q).abs()).sum::<f64>() / n as f64;
            assert_relative_eq!(wasserstein(&a, &b), closed, max_relative = 1e-12);
            assert_relative_eq!(wasserstein(&a, &b), wasserstein(&b, &a), max_relative = 1e-12);
        }
    }

    #[test]
    fn wasserstein_does_not_change_when_a_sample_is_repeated() {
        let a = [0.0, 1.0, 5.0];
        let b = [2.0, 2.0, 7.0, -1.0];
        let thrice: Vec<f64> = a.iter().copied().cycle().take(9).collect();
        assert_relative_eq!(wasserstein(&a, &b), wasserstein(&thrice, &b), max_relative = 1e-12);
        // Shifted by 3 as a whole: the distance is exactly 3.
        let moved: Vec<f64> = a.iter().map(|x| x + 3.0).collect();
        assert_relative_eq!(wasserstein(&a, &moved), 3.0);
        assert_eq!(wasserstein(&a, &[]), 0.0);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(quantile(&[0.0, 10.0], 0.25), Some(2.5));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn kendall_tau_matches_the_published_example() {
        // SciPy's documentation of `kendalltau`: -0.4714045207910316.
        let tau = kendall_tau(&[12.0, 2.0, 1.0, 12.0, 2.0], &[1.0, 4.0, 7.0, 1.0, 0.0]);
        assert!((tau + 0.471_404_520_791_031_6).abs() < 1e-12, "{tau}");
        assert_eq!(kendall_tau(&[1.0, 2.0, 3.0], &[10.0, 20.0, 30.0]), 1.0);
        assert_eq!(kendall_tau(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), -1.0);
        assert_eq!(kendall_tau(&[1.0, 1.0], &[3.0, 2.0]), 0.0);
    }

    #[test]
    fn wilson_matches_the_published_example() {
        // 10 of 10: the interval is [n / (n + z²), 1].
        let e = wilson(10, 10).unwrap();
        assert_relative_eq!(e.low, 10.0 / (10.0 + 1.959_963_984_540_054f64.powi(2)), max_relative = 1e-12);
        assert_relative_eq!(e.high, 1.0, max_relative = 1e-12);
        assert_eq!(wilson(0, 0), None);
    }
}
