//! Estimates from rows: means, shares, medians and differences with 95 % intervals.
//!
//! Shares, means and differences of methods with several training seeds have intervals from the components of variance of seeds
//! and scenes. All others are bootstrapped: methods with one seed, medians, and distances of samples that are pooled over scenes
//! ([`Pool`]). A resample draws the scenes, once for all that is compared, so that differences are paired by scene, and for
//! distances of pooled samples also the training seeds of each method.

use rayon::prelude::*;
use sage_core::{
    metric::{Aggregate, TwoSamples},
    seed::Rng,
    statistics::{self, Estimate, quantile},
};

mod components;
#[cfg(test)]
mod coverage;
mod pooled;
mod stopping;
mod student;
#[cfg(test)]
mod tests;

pub use pooled::Pool;
pub use stopping::{HALF_WIDTH, LEAST_SEEDS, MOST_SEEDS, adds_a_seed};

use components::{Spread, Values};

/// Resamples of an interval.
pub const RESAMPLES: usize = 4000;
/// Sum of the normal quantiles of a two-sided level of 0.05 and a power of 0.8.
const QUANTILES: f64 = 1.959_964 + 0.841_621;

/// Values of a metric: for each training seed and each scene a weighted sum and its weight. A scene in which nothing
/// was measured has weight 0. All seeds have the same scenes.
///
/// ```
/// use sage_bench::estimate::Samples;
/// use sage_core::metric::Aggregate;
///
/// // In three scenes the driver had a contact in one; in a fourth nothing was measured.
/// let samples = Samples::of([Some(1.0), Some(0.0), None, Some(0.0)]);
/// let rate = samples.estimate(Aggregate::Share, "contact").ok_or("nothing was measured")?;
/// assert_eq!(rate.n, 3);
/// assert!((rate.value - 1.0 / 3.0).abs() < 1e-12 && rate.low < 0.07 && rate.high > 0.79);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// By seed, then by scene.
    pub seeds: Vec<Vec<[f64; 2]>>,
    /// Names of the seeds, by which differences are paired; empty if they have none.
    pub training_seeds: Vec<u64>,
    /// All values of each scene, for a median: those of agents, seeds and checkpoints.
    pub values: Vec<Vec<f64>>,
    /// Number of values, where scenes have several agents; otherwise that of scenes is reported.
    pub agents: Option<usize>,
    /// The samples of each seed, for a distance of pooled samples; empty for other metrics.
    pub pools: Vec<Pool>,
}

/// Difference of two methods on the same scenes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Value of the first less that of the second, and its interval.
    pub estimate: Estimate,
    /// Scenes in which the first is larger, and in which the second is; only with one seed each.
    pub larger: Option<[usize; 2]>,
    /// Two-sided p-value before any correction: of a t test with several seeds, of the bootstrap with one.
    pub p: f64,
    /// Seeds per method for a power of 0.8 at the 0.05 level, if this is the true difference, scenes are fixed and seeds
    /// are paired or not as these are.
    pub seeds_needed: Option<u64>,
}

fn sums(seed: &[[f64; 2]], scenes: impl Iterator<Item = usize>) -> [f64; 2] {
    scenes.fold([0.0; 2], |[sum, weight], k| [sum + seed[k][0], weight + seed[k][1]])
}

fn ratio([sum, weight]: [f64; 2]) -> f64 {
    sum / weight.max(f64::MIN_POSITIVE)
}

fn deviation(values: &[f64]) -> Option<f64> {
    let middle = statistics::mean(values)?;
    let squares: f64 = values.iter().map(|x| (x - middle).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Values of all resamples: each draws as many scenes as there are.
fn resampled(scenes: &[usize], rng: &mut Rng, mut of: impl FnMut(&[usize], &mut Rng) -> f64) -> Vec<f64> {
    let mut drawn = scenes.to_vec();
    let resample = |_| {
        drawn.iter_mut().for_each(|k| *k = scenes[rng.below(scenes.len())]);
        of(&drawn, rng)
    };
    (0..RESAMPLES).map(resample).collect()
}

/// A quantity of some scenes with its interval; `None` without scenes. `name` seeds the bootstrap. All draws are made
/// first, so that threads share the work and the bits stay.
pub fn of_scenes(count: usize, name: &str, of: impl Fn(&[usize]) -> f64 + Sync) -> Option<Estimate> {
    let scenes: Vec<usize> = (0..count).collect();
    if count == 0 {
        return None;
    }
    let mut rng = Rng::new(0, name, "bootstrap");
    let draws: Vec<Vec<usize>> =
        (0..RESAMPLES).map(|_| scenes.iter().map(|_| rng.below(count)).collect()).collect();
    let drawn: Vec<f64> = draws.par_iter().map(|scenes| of(scenes)).collect();
    interval(of(&scenes), count, &drawn)
}

fn interval(value: f64, n: usize, drawn: &[f64]) -> Option<Estimate> {
    Some(Estimate { value, low: quantile(drawn, 0.025)?, high: quantile(drawn, 0.975)?, n })
}

impl Samples {
    /// One seed with one value for each scene; `None` where it was not measured.
    pub fn of(values: impl IntoIterator<Item = Option<f64>>) -> Self {
        let values: Vec<Option<f64>> = values.into_iter().collect();
        let cell = |value: &Option<f64>| value.map_or([0.0; 2], |value| [value, 1.0]);
        let seeds = vec![values.iter().map(cell).collect()];
        let values = values.into_iter().map(|value| value.into_iter().collect()).collect();
        Self { seeds, values, ..Self::default() }
    }

    /// The same for a distance of pooled samples, by seed and scene.
    pub fn with_pools(self, samples: &[Vec<TwoSamples>]) -> Self {
        Self { pools: samples.iter().map(|scenes| Pool::of(scenes)).collect(), ..self }
    }

    /// Value of a seed over some scenes, each as often as it is given.
    fn of_seed(&self, seed: usize, scenes: &[usize]) -> f64 {
        match self.pools.get(seed) {
            Some(pool) => pool.distance(scenes),
            None => ratio(sums(&self.seeds[seed], scenes.iter().copied())),
        }
    }

    fn scenes(&self) -> usize {
        self.seeds.first().map_or(0, Vec::len)
    }

    /// Number of scenes in which something was measured, or of agents.
    pub fn n(&self) -> usize {
        if let Some(agents) = self.agents {
            return agents;
        }
        self.measured().len()
    }

    /// The scenes in which something was measured.
    fn measured(&self) -> Vec<usize> {
        (0..self.scenes()).filter(|k| self.seeds.iter().any(|seed| seed[*k][1] > 0.0)).collect()
    }

    /// Value of each seed over all scenes.
    fn by_seed(&self) -> Vec<f64> {
        let scenes: Vec<usize> = (0..self.scenes()).collect();
        (0..self.seeds.len()).map(|seed| self.of_seed(seed, &scenes)).collect()
    }

    /// Mean over seeds; `None` if nothing was measured.
    pub fn mean(&self) -> Option<f64> {
        (self.n() > 0).then(|| statistics::mean(&self.by_seed())).flatten()
    }

    /// Standard deviation over training seeds; `None` with one seed.
    pub fn deviation(&self) -> Option<f64> {
        deviation(&self.by_seed())
    }

    /// Values whose mean over the scenes is that of each seed, and whose spread tells how exact it is: for a mean with weights,
    /// which is a ratio, its linearisation.
    fn linear(&self, scenes: &[usize]) -> Values {
        let of_seed = |seed: &Vec<[f64; 2]>| {
            let whole = sums(seed, scenes.iter().copied());
            let (value, mean_weight) = (ratio(whole), whole[1] / scenes.len() as f64);
            let influence = |[sum, weight]: [f64; 2]| ratio([sum - value * weight, mean_weight]);
            scenes.iter().map(|k| value + influence(seed[*k])).collect()
        };
        self.seeds.iter().map(of_seed).collect()
    }

    /// For each seed the same one of another method, if both have several and the same.
    fn same_seeds(&self, other: &Self) -> Option<Vec<usize>> {
        let is_named = |of: &Self| of.seeds.len() > 1 && of.training_seeds.len() == of.seeds.len();
        if !is_named(self) || !is_named(other) || self.seeds.len() != other.seeds.len() {
            return None;
        }
        let place = |seed: &u64| other.training_seeds.iter().position(|known| known == seed);
        self.training_seeds.iter().map(place).collect()
    }

    /// Means in resamples of the scenes in which something was measured, which draw the seeds too.
    fn resampled_means(&self, rng: &mut Rng) -> Vec<f64> {
        // Scenes without a value are in no resample, as they are in no mean.
        resampled(&self.measured(), rng, |scenes, rng| self.mean_of(scenes, rng))
    }

    /// The same for the difference from another over common scenes.
    fn resampled_gaps(&self, other: &Self, common: &[usize], name: &str) -> Vec<f64> {
        let mut rng = Rng::new(0, name, "bootstrap");
        resampled(common, &mut rng, |scenes, rng| self.mean_of(scenes, rng) - other.mean_of(scenes, rng))
    }

    /// Mean over seeds in a resample of scenes, which draws the seeds too.
    fn mean_of(&self, scenes: &[usize], rng: &mut Rng) -> f64 {
        let n = self.seeds.len();
        let one = |seed: usize| self.of_seed(seed, scenes);
        if n == 1 { one(0) } else { (0..n).map(|_| one(rng.below(n))).sum::<f64>() / n as f64 }
    }

    /// The estimate of a metric; `None` if it was measured nowhere. `name` seeds the bootstrap.
    ///
    /// The interval of a share with one seed is Wilson's. That of a share or mean with several seeds is from the components of
    /// variance; those of shares end at 0 and 1. All others are the bootstrap's.
    pub fn estimate(&self, aggregate: Aggregate, name: &str) -> Option<Estimate> {
        let n = self.n();
        if n == 0 {
            return None;
        }
        let is_binary =
            |seed: &Vec<[f64; 2]>| seed.iter().all(|[s, w]| *s == 0.0 || (*s == 1.0 && *w == 1.0));
        if aggregate == Aggregate::Share && self.seeds.len() == 1 && is_binary(&self.seeds[0]) {
            let held = self.seeds[0].iter().filter(|[sum, _]| *sum == 1.0).count();
            return statistics::wilson(held, n);
        }
        let mut rng = Rng::new(0, name, "bootstrap");
        if aggregate == Aggregate::Median {
            let scenes: Vec<usize> = (0..self.values.len()).filter(|k| !self.values[*k].is_empty()).collect();
            let median = |scenes: &[usize]| {
                let all: Vec<f64> = scenes.iter().flat_map(|k| self.values[*k].iter().copied()).collect();
                statistics::median(&all).unwrap_or(f64::NAN)
            };
            let drawn = resampled(&scenes, &mut rng, |scenes, _| median(scenes));
            return interval(median(&scenes), n, &drawn);
        }
        let value = statistics::mean(&self.by_seed())?;
        let is_linear = self.pools.is_empty() && aggregate != Aggregate::Pooled;
        if let Some(spread) = Spread::of_mean(&self.linear(&self.measured())).filter(|_| is_linear) {
            let [low, high] = match aggregate {
                Aggregate::Share => spread.of_share(value, self.measured().len()),
                _ => [value - spread.half_width(), value + spread.half_width()],
            };
            return Some(Estimate { value, low, high, n });
        }
        let drawn = self.resampled_means(&mut rng);
        if aggregate == Aggregate::Pooled {
            return pooled::interval(value, n, &drawn);
        }
        interval(value, n, &drawn)
    }

    /// This less another, over the scenes in which both were measured; `None` without any.
    pub fn less(&self, other: &Self, name: &str) -> Option<Difference> {
        if self.scenes() != other.scenes() {
            return None;
        }
        let others = other.measured();
        let common: Vec<usize> =
            self.measured().into_iter().filter(|k| others.binary_search(k).is_ok()).collect();
        if common.is_empty() {
            return None;
        }
        let over =
            |of: &Self| -> Vec<f64> { (0..of.seeds.len()).map(|seed| of.of_seed(seed, &common)).collect() };
        let (a, b) = (over(self), over(other));
        let value = statistics::mean(&a)? - statistics::mean(&b)?;
        let pairs = self.same_seeds(other);
        let variance = match &pairs {
            Some(pairs) => {
                let gaps: Vec<f64> = a.iter().zip(pairs).map(|(a, k)| a - b[*k]).collect();
                deviation(&gaps).map(|x| x * x)
            }
            None => deviation(&a).zip(deviation(&b)).map(|(x, y)| x * x + y * y),
        };
        let seeds_needed = variance
            .filter(|_| value != 0.0)
            .map(|variance| (QUANTILES.powi(2) * variance / value.powi(2)).ceil().max(2.0) as u64);
        let larger = (self.seeds.len() == 1 && other.seeds.len() == 1).then(|| {
            let gap = |k: usize| ratio(self.seeds[0][k]) - ratio(other.seeds[0][k]);
            [1.0, -1.0].map(|sign| common.iter().filter(|k| sign * gap(**k) > 1e-9).count())
        });
        let least = 1.0 / RESAMPLES as f64;
        let n = common.len();
        let (estimate, p) = match self.spread_of_gap(other, pairs.as_deref(), &common) {
            Some(spread) => {
                let half = spread.half_width();
                (Estimate { value, low: value - half, high: value + half, n }, spread.p(value, least))
            }
            None => {
                let drawn = self.resampled_gaps(other, &common, name);
                let share =
                    |is: fn(&f64) -> bool| drawn.iter().filter(|d| is(d)).count() as f64 / RESAMPLES as f64;
                let p = (2.0 * share(|d| *d <= 0.0).min(share(|d| *d >= 0.0))).clamp(least, 1.0);
                (interval(value, n, &drawn)?, p)
            }
        };
        Some(Difference { estimate, larger, p, seeds_needed })
    }

    /// Spread of the difference from another over common scenes, with seeds in pairs if they are the same; `None` with one seed
    /// each and for distances of pooled samples.
    fn spread_of_gap(&self, other: &Self, pairs: Option<&[usize]>, common: &[usize]) -> Option<Spread> {
        if !self.pools.is_empty() || !other.pools.is_empty() {
            return None;
        }
        let (a, b) = (self.linear(common), other.linear(common));
        let Some(pairs) = pairs else { return Spread::of_difference(&a, &b) };
        let gaps = |(a, k): (&Vec<f64>, &usize)| a.iter().zip(&b[*k]).map(|(a, b)| a - b).collect();
        Spread::of_mean(&a.iter().zip(pairs).map(gaps).collect())
    }
}

/// Holm's correction: p-values that may be compared with the level as they are.
///
/// ```
/// use sage_bench::estimate::holm;
///
/// // Of three comparisons the smallest p counts three times, the next twice; none is smaller than one before it.
/// let adjusted = holm(&[0.01, 0.04, 0.03]);
/// assert!(adjusted.iter().zip([0.03, 0.06, 0.06]).all(|(p, expected)| (p - expected).abs() < 1e-12));
/// ```
pub fn holm(ps: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..ps.len()).collect();
    order.sort_by(|a, b| ps[*a].total_cmp(&ps[*b]));
    let (mut corrected, mut largest) = (vec![0.0; ps.len()], 0.0_f64);
    for (rank, k) in order.into_iter().enumerate() {
        largest = largest.max(((ps.len() - rank) as f64 * ps[k]).min(1.0));
        corrected[k] = largest;
    }
    corrected
}
