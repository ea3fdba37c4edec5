//! Estimates from rows: means, shares, medians and differences with 95 % intervals.
//!
//! There is one bootstrap, also for distances of samples that are pooled over scenes ([`Pool`]). A resample draws the scenes,
//! once for all that is compared, so that differences are paired by scene, and for each method its training seeds, if it has
//! several.

use rayon::prelude::*;
use sage_core::{
    metric::{Aggregate, TwoSamples},
    seed::Rng,
    statistics::{self, Estimate, quantile},
};

mod pooled;

pub use pooled::Pool;

/// Resamples of an interval.
pub const RESAMPLES: usize = 4000;
/// Sum of the normal quantiles of a two-sided level of 0.05 and a power of 0.8.
const QUANTILES: f64 = 1.959_964 + 0.841_621;

/// Values of a metric: for each training seed and each scene a weighted sum and its weight. A scene in which nothing
/// was measured has weight 0. All seeds have the same scenes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// By seed, then by scene.
    pub seeds: Vec<Vec<[f64; 2]>>,
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
    /// Two-sided p-value of the bootstrap, before any correction.
    pub p: f64,
    /// Seeds per method for a power of 0.8 at the 0.05 level, if this is the true difference and scenes are fixed.
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

    /// Mean over seeds in a resample of scenes, which draws the seeds too.
    fn mean_of(&self, scenes: &[usize], rng: &mut Rng) -> f64 {
        let n = self.seeds.len();
        let one = |seed: usize| self.of_seed(seed, scenes);
        if n == 1 { one(0) } else { (0..n).map(|_| one(rng.below(n))).sum::<f64>() / n as f64 }
    }

    /// The estimate of a metric; `None` if it was measured nowhere. `name` seeds the bootstrap.
    ///
    /// The interval of a share with one seed is Wilson's. That of a median and of means is the bootstrap's.
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
        // Scenes without a value are in no resample, as they are in no mean.
        let drawn = resampled(&self.measured(), &mut rng, |scenes, rng| self.mean_of(scenes, rng));
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
        let mut rng = Rng::new(0, name, "bootstrap");
        let drawn = resampled(&common, &mut rng, |scenes, rng| {
            self.mean_of(scenes, rng) - other.mean_of(scenes, rng)
        });
        let value = statistics::mean(&a)? - statistics::mean(&b)?;
        let share = |is: fn(&f64) -> bool| drawn.iter().filter(|d| is(d)).count() as f64 / RESAMPLES as f64;
        let p = (2.0 * share(|d| *d <= 0.0).min(share(|d| *d >= 0.0))).clamp(1.0 / RESAMPLES as f64, 1.0);
        let variance = deviation(&a).zip(deviation(&b)).map(|(x, y)| x * x + y * y);
        let seeds_needed = variance
            .filter(|_| value != 0.0)
            .map(|variance| (QUANTILES.powi(2) * variance / value.powi(2)).ceil().max(2.0) as u64);
        let larger = (self.seeds.len() == 1 && other.seeds.len() == 1).then(|| {
            let gap = |k: usize| ratio(self.seeds[0][k]) - ratio(other.seeds[0][k]);
            [1.0, -1.0].map(|sign| common.iter().filter(|k| sign * gap(**k) > 1e-9).count())
        });
        Some(Difference { estimate: interval(value, common.len(), &drawn)?, larger, p, seeds_needed })
    }
}

/// Holm's correction: p-values that may be compared with the level as they are.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_leaves_out_what_was_not_measured() {
        let samples = Samples::of([Some(1.0), None, Some(4.0), Some(4.0)]);
        let e = samples.estimate(Aggregate::Mean, "x").unwrap();
        assert_eq!((e.value, e.n), (3.0, 3));
        assert!(e.low >= 1.0 && e.low < 3.0 && e.high > 3.0 && e.high <= 4.0, "{e:?}");
        let e = samples.estimate(Aggregate::Median, "x").unwrap();
        assert_eq!((e.value, e.n), (4.0, 3));
        assert!(Samples::of([None, None]).estimate(Aggregate::Mean, "x").is_none());
    }

    #[test]
    fn the_interval_of_a_share_is_wilsons() {
        // 3 of 4: centre (0.75 + z²/8)/(1 + z²/4) with z = 1.96 is 0.627, half width 0.327.
        let samples = Samples::of([Some(1.0), Some(1.0), Some(0.0), Some(1.0), None]);
        let e = samples.estimate(Aggregate::Share, "x").unwrap();
        assert_eq!((e.value, e.n), (0.75, 4));
        assert!((e.low - 0.3006).abs() < 1e-4 && (e.high - 0.9544).abs() < 1e-4, "{e:?}");
    }

    #[test]
    fn weights_are_those_of_the_scenes() {
        // Speeds 2 over 10 steps and 8 over 30 steps: (20 + 240)/40.
        let samples = Samples { seeds: vec![vec![[20.0, 10.0], [240.0, 30.0]]], ..Samples::default() };
        assert_eq!(samples.estimate(Aggregate::Mean, "x").unwrap().value, 6.5);
    }

    #[test]
    fn seeds_are_averaged_after_their_scenes() {
        let seeds = vec![vec![[1.0, 1.0], [0.0, 1.0]], vec![[1.0, 1.0], [1.0, 1.0]]];
        let samples = Samples { seeds, ..Samples::default() };
        let e = samples.estimate(Aggregate::Share, "x").unwrap();
        assert_eq!((e.value, e.n), (0.75, 2));
        // Seed values 0.5 and 1: deviation 0.5/√2.
        assert!((samples.deviation().unwrap() - 0.125f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn differences_are_paired_by_scene() {
        let a = Samples::of([Some(10.0), Some(21.0), Some(32.0), None]);
        let b = Samples::of([Some(9.0), Some(20.0), Some(31.0), Some(99.0)]);
        let d = a.less(&b, "x").unwrap();
        // The same in every common scene, so without any spread.
        assert_eq!((d.estimate.value, d.estimate.low, d.estimate.high, d.estimate.n), (1.0, 1.0, 1.0, 3));
        assert_eq!((d.larger, d.seeds_needed), (Some([3, 0]), None));
        assert_eq!(d.p, 1.0 / RESAMPLES as f64);
        assert!(a.less(&Samples::of([None, None, None, Some(1.0)]), "x").is_none());
    }

    #[test]
    fn the_seeds_that_are_needed_follow_from_both_deviations() {
        let method = |values: [f64; 2]| Samples {
            seeds: values.map(|v| vec![[v, 1.0]]).to_vec(),
            ..Samples::default()
        };
        // Deviations 0.1/√2 each: variance 0.01; (2.8016)² · 0.01/0.2² = 1.96, at least 2.
        let d = method([0.5, 0.6]).less(&method([0.3, 0.4]), "x").unwrap();
        assert!((d.estimate.value - 0.2).abs() < 1e-12);
        assert_eq!(d.seeds_needed, Some(2));
        // With a difference of 0.05 it is 31.4.
        let d = method([0.35, 0.45]).less(&method([0.3, 0.4]), "x").unwrap();
        assert_eq!(d.seeds_needed, Some(32));
    }

    #[test]
    fn holm_multiplies_by_what_is_left() {
        assert_eq!(holm(&[0.01, 0.04, 0.03]), [0.03, 0.06, 0.06]);
        assert_eq!(holm(&[0.6, 0.9]), [1.0, 1.0]);
    }

    #[test]
    fn intervals_cover_at_their_level() {
        // 300 samples of 40 uniform values: 95 % of the intervals hold 0.5, up to sampling.
        let held = (0..300)
            .filter(|k| {
                let mut rng = Rng::new(*k, "values", "test");
                let samples = Samples::of((0..40).map(|_| Some(rng.uniform(0.0, 1.0))));
                let e = samples.estimate(Aggregate::Mean, "x").unwrap();
                (e.low..=e.high).contains(&0.5)
            })
            .count();
        assert!((270..=298).contains(&held), "{held} of 300");
    }
}
