//! The distance of two samples that are pooled over scenes.

use sage_core::{
    metric::TwoSamples,
    statistics::{Estimate, quantile},
};

/// The samples of all scenes, merged once so that a resample of the scenes costs one pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pool {
    /// Distinct values, ascending.
    values: Vec<f64>,
    /// For each value, where its occurrences begin in `occurrences`; one more at the end.
    starts: Vec<usize>,
    /// Scene, sample (0 or 1) and number of equal values.
    occurrences: Vec<(u32, u8, u32)>,
    /// Number of values of each sample in each scene.
    counts: Vec<[f64; 2]>,
}

impl Pool {
    /// Merges the samples of scenes.
    pub fn of(scenes: &[TwoSamples]) -> Self {
        let mut all: Vec<(f32, u32, u8, u32)> = Vec::new();
        for (scene, samples) in scenes.iter().enumerate() {
            for (side, sample) in samples.0.iter().enumerate() {
                all.extend(sample.iter().map(|(x, n)| (*x, scene as u32, side as u8, *n)));
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut pool = Self { counts: vec![[0.0; 2]; scenes.len()], ..Self::default() };
        for same in all.chunk_by(|a, b| a.0 == b.0) {
            pool.values.push(f64::from(same[0].0));
            pool.starts.push(pool.occurrences.len());
            for (_, scene, side, n) in same {
                pool.occurrences.push((*scene, *side, *n));
                pool.counts[*scene as usize][usize::from(*side)] += f64::from(*n);
            }
        }
        pool.starts.push(pool.occurrences.len());
        pool
    }

    /// ∫ |F_a − F_b| of the samples of some scenes, each as often as it is given; 0 if a sample is empty.
    pub fn distance(&self, scenes: &[usize]) -> f64 {
        let mut times = vec![0.0; self.counts.len()];
        let mut total = [0.0; 2];
        for scene in scenes {
            times[*scene] += 1.0;
            for (total, count) in total.iter_mut().zip(self.counts[*scene]) {
                *total += count;
            }
        }
        if total.contains(&0.0) {
            return 0.0;
        }
        let share = total.map(f64::recip);
        let (mut gap, mut sum, mut before) = (0.0_f64, 0.0, 0.0);
        for (k, x) in self.values.iter().enumerate() {
            // Before the first value the gap is 0.
            sum += gap.abs() * (x - before);
            before = *x;
            for (scene, side, n) in &self.occurrences[self.starts[k]..self.starts[k + 1]] {
                let added = times[*scene as usize] * f64::from(*n) * share[usize::from(*side)];
                gap += if *side == 0 { added } else { -added };
            }
        }
        sum
    }
}

/// The interval of a pooled distance from its resamples. Samples that are drawn again differ more, so their distances are too
/// large: the quantiles are moved by how much the median is.
pub(super) fn interval(value: f64, n: usize, drawn: &[f64]) -> Option<Estimate> {
    let excess = quantile(drawn, 0.5)? - value;
    let at = |share: f64| Some((quantile(drawn, share)? - excess).max(0.0));
    Some(Estimate { value, low: at(0.025)?, high: at(0.975)?, n })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::{metric::Aggregate, seed::Rng, statistics::wasserstein};

    use crate::estimate::Samples;

    #[test]
    fn the_distance_of_a_pool_is_that_of_its_joined_samples() {
        let mut rng = Rng::new(3, "pools", "test");
        let mut draw = |n: usize, centre: f64| -> Vec<f64> {
            (0..n).map(|_| (8.0 * rng.uniform(centre - 2.0, centre + 2.0)).round() / 8.0).collect()
        };
        let scenes: Vec<[Vec<f64>; 2]> = (0..7).map(|k| [draw(5 + k, k as f64), draw(9 - k, 1.0)]).collect();
        let pool = Pool::of(&scenes.iter().map(|[a, b]| TwoSamples::new([a, b])).collect::<Vec<_>>());
        for drawn in [vec![0, 1, 2, 3, 4, 5, 6], vec![6, 6, 2, 0, 0, 0, 5], vec![4]] {
            let joined = |side: usize| -> Vec<f64> {
                drawn.iter().flat_map(|k: &usize| scenes[*k][side].iter().copied()).collect()
            };
            let expected = wasserstein(&joined(0), &joined(1));
            assert!((pool.distance(&drawn) - expected).abs() < 1e-12, "{drawn:?}");
        }
    }

    #[test]
    fn a_pooled_distance_has_an_interval_and_differs_from_the_mean_over_scenes() {
        // Each scene is shifted, up or down: apart by 1 in each scene, not at all when pooled.
        let scenes: Vec<TwoSamples> = (0..40)
            .map(|k| TwoSamples::new(if k % 2 == 0 { [&[0.0], &[1.0]] } else { [&[1.0], &[0.0]] }))
            .collect();
        let samples = Samples::of((0..40).map(|_| Some(1.0))).with_pools(&[scenes]);
        let pooled = samples.estimate(Aggregate::Pooled, "x").unwrap();
        assert_eq!(pooled.value, 0.0);
        assert!(pooled.low == 0.0 && pooled.high > 0.1 && pooled.high < 0.5, "{pooled:?}");
        let mean = Samples::of((0..40).map(|_| Some(1.0))).estimate(Aggregate::Mean, "x").unwrap();
        assert_eq!(mean.value, 1.0);
    }
}
