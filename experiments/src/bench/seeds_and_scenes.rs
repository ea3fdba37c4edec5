//! Statistics of methods that are measured with several seeds on the same scenes.
//!
//! A resample of the hierarchical bootstrap draws the scenes once for all methods, so that differences are paired by
//! scene, and for each method its seeds.

use sage_core::{seed::Rng, statistics::quantile};

/// Resamples of an interval.
const RESAMPLES: usize = 4000;
/// Sum of the normal quantiles of a two-sided level of 0.05 and a power of 0.8.
const QUANTILES: f64 = 1.959_964 + 0.841_621;

/// A measure of a method: for each seed and scene, a weighted sum and its weight.
pub(crate) type Measured = Vec<Vec<[f64; 2]>>;

/// Mean over seeds with its interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SeedMean {
    pub(crate) mean: f64,
    /// Standard deviation over seeds; `None` with one seed.
    pub(crate) deviation: Option<f64>,
    pub(crate) low: f64,
    pub(crate) high: f64,
}

/// Difference of two methods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Difference {
    pub(crate) value: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    /// Two-sided p-value of the bootstrap, before any correction.
    pub(crate) p: f64,
    /// Seeds per method for a power of 0.8 at the 0.05 level, if this is the true difference and scenes are fixed.
    pub(crate) seeds_needed: Option<u64>,
}

/// Value of one seed over some scenes.
fn of_seed(seed: &[[f64; 2]], scenes: &[usize]) -> f64 {
    let [sum, weight] = scenes.iter().fold([0.0; 2], |[s, w], k| [s + seed[*k][0], w + seed[*k][1]]);
    sum / weight.max(f64::MIN_POSITIVE)
}

fn values(measured: &Measured) -> Vec<f64> {
    let all: Vec<usize> = (0..measured.first().map_or(0, Vec::len)).collect();
    measured.iter().map(|seed| of_seed(seed, &all)).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64]) -> Option<f64> {
    let middle = mean(values);
    let squares: f64 = values.iter().map(|x| (x - middle).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Mean of resampled seeds over given scenes.
fn resampled(measured: &Measured, scenes: &[usize], rng: &mut Rng) -> f64 {
    let n = measured.len();
    (0..n).map(|_| of_seed(&measured[rng.below(n)], scenes)).sum::<f64>() / n as f64
}

fn draw(count: usize, rng: &mut Rng) -> Vec<usize> {
    (0..count).map(|_| rng.below(count)).collect()
}

/// The mean of a method; `None` without seeds or scenes.
pub(crate) fn seed_mean(measured: &Measured, name: &str) -> Option<SeedMean> {
    let scenes = measured.first()?.len();
    let all = values(measured);
    let mut rng = Rng::new(0, name, "hierarchical bootstrap");
    let means: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let scenes = draw(scenes, &mut rng);
            resampled(measured, &scenes, &mut rng)
        })
        .collect();
    Some(SeedMean {
        mean: mean(&all),
        deviation: deviation(&all),
        low: quantile(&means, 0.025)?,
        high: quantile(&means, 0.975)?,
    })
}

/// `a` less `b`, on the same scenes; `None` without seeds or scenes.
pub(crate) fn difference(a: &Measured, b: &Measured, name: &str) -> Option<Difference> {
    let scenes = a.first()?.len();
    b.first().filter(|seed| seed.len() == scenes)?;
    let mut rng = Rng::new(0, name, "hierarchical bootstrap");
    let all: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let scenes = draw(scenes, &mut rng);
            resampled(a, &scenes, &mut rng) - resampled(b, &scenes, &mut rng)
        })
        .collect();
    let share = |is: fn(&f64) -> bool| all.iter().filter(|d| is(d)).count() as f64 / RESAMPLES as f64;
    let p = (2.0 * share(|d| *d <= 0.0).min(share(|d| *d >= 0.0))).clamp(1.0 / RESAMPLES as f64, 1.0);
    let (of_a, of_b) = (values(a), values(b));
    let value = mean(&of_a) - mean(&of_b);
    let variance = deviation(&of_a).zip(deviation(&of_b)).map(|(x, y)| x * x + y * y);
    let seeds_needed = variance
        .filter(|_| value != 0.0)
        .map(|variance| (QUANTILES.powi(2) * variance / value.powi(2)).ceil().max(2.0) as u64);
    Some(Difference { value, low: quantile(&all, 0.025)?, high: quantile(&all, 0.975)?, p, seeds_needed })
}

/// Holm's correction: p-values that may be compared with the level as they are.
pub(crate) fn holm(ps: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..ps.len()).collect();
    order.sort_by(|a, b| ps[*a].total_cmp(&ps[*b]));
    let (mut corrected, mut largest) = (vec![0.0; ps.len()], 0.0_f64);
    for (rank, k) in order.into_iter().enumerate() {
        largest = largest.max(((ps.len() - rank) as f64 * ps[k]).min(1.0));
        corrected[k] = largest;
    }
    corrected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holm_is_that_of_the_textbook() {
        assert_eq!(holm(&[0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02]);
        assert!(holm(&[]).is_empty());
    }

    #[test]
    fn scenes_that_both_methods_share_do_not_widen_their_difference() {
        let scene = |k: usize| if k.is_multiple_of(2) { 0.0 } else { 10.0 };
        let method = |shift: f64| -> Measured {
            (0..5)
                .map(|seed| (0..40).map(|k| [scene(k) + shift + 0.01 * f64::from(seed), 1.0]).collect())
                .collect()
        };
        let d = difference(&method(1.0), &method(0.0), "test").expect("seeds and scenes");
        assert!((d.value - 1.0).abs() < 1e-9 && d.low > 0.95 && d.high < 1.05, "{d:?}");
        assert_eq!(d.seeds_needed, Some(2));
        let m = seed_mean(&method(0.0), "test").expect("seeds and scenes");
        assert!(m.high - m.low > 2.0 && (m.mean - 5.02).abs() < 1e-9, "{m:?}");
    }

    #[test]
    fn equal_methods_differ_by_nothing() {
        let method: Measured =
            (0..4).map(|s| (0..30).map(|k| [f64::from(k * (s + 1) % 7), 1.0]).collect()).collect();
        let d = difference(&method, &method, "test").expect("seeds and scenes");
        assert!(
            d.value == 0.0 && d.p > 0.3 && d.low < 0.0 && d.high > 0.0 && d.seeds_needed.is_none(),
            "{d:?}"
        );
    }
}
