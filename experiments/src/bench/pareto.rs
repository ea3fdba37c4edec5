//! Fronts of reward against realism: means over scenes, hypervolume, evenness and monotonicity, with intervals.

use sage_backbones::training::Expectation;
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};
use serde::{Deserialize, Serialize};

/// Reference point of the hypervolume: R_adv 0 and P_real 6.
const REFERENCE: [f64; 2] = [0.0, 6.0];
/// Resamples of an interval.
const RESAMPLES: usize = 1000;

/// Measures of one scene at one λ.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Measure {
    /// R_adv.
    pub(crate) reward: f64,
    /// P_real.
    pub(crate) penalty: f64,
    /// Rate of attacks, or their probability.
    pub(crate) attack: f64,
    /// Rate of believable attacks, or their probability.
    pub(crate) believable: f64,
}

impl From<Expectation> for Measure {
    fn from(e: Expectation) -> Self {
        Self { reward: e.reward, penalty: e.penalty, attack: e.attack, believable: e.believable }
    }
}

impl Measure {
    fn mean(all: impl Iterator<Item = Self>) -> Self {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for m in all {
            sum = Self {
                reward: sum.reward + m.reward,
                penalty: sum.penalty + m.penalty,
                attack: sum.attack + m.attack,
                believable: sum.believable + m.believable,
            };
            count += 1.0;
        }
        Self {
            reward: sum.reward / count,
            penalty: sum.penalty / count,
            attack: sum.attack / count,
            believable: sum.believable / count,
        }
    }
}

/// A sweep over λ: for each scene, its measures at every λ.
#[derive(Default)]
pub(crate) struct Sweep {
    pub(crate) scenes: Vec<Vec<Measure>>,
}

impl Sweep {
    /// Mean over scenes at every λ.
    pub(crate) fn front(&self) -> Vec<Measure> {
        self.front_of(&(0..self.scenes.len()).collect::<Vec<_>>())
    }

    /// The same over some of the scenes.
    fn front_of(&self, scenes: &[usize]) -> Vec<Measure> {
        let lambdas = self.scenes.first().map_or(0, Vec::len);
        (0..lambdas).map(|k| Measure::mean(scenes.iter().map(|&scene| self.scenes[scene][k]))).collect()
    }

    /// A quantity of the front with its 95 % interval over scenes.
    pub(crate) fn estimate(&self, of: impl Fn(&[Measure]) -> f64) -> Option<Estimate> {
        self.compared(None, |own, _| of(own))
    }

    /// Difference of a quantity from that of another sweep over the same scenes.
    pub(crate) fn difference(&self, other: &Self, of: impl Fn(&[Measure]) -> f64) -> Option<Estimate> {
        self.compared(Some(other), |own, other| of(own) - of(other))
    }

    /// A quantity of two fronts over the same scenes.
    pub(crate) fn against(
        &self,
        other: &Self,
        of: impl Fn(&[Measure], &[Measure]) -> f64,
    ) -> Option<Estimate> {
        self.compared(Some(other), of)
    }

    /// The sweep of one of its points alone.
    pub(crate) fn only(&self, point: usize) -> Self {
        Self { scenes: self.scenes.iter().map(|measures| vec![measures[point]]).collect() }
    }

    fn compared(&self, other: Option<&Self>, of: impl Fn(&[Measure], &[Measure]) -> f64) -> Option<Estimate> {
        let count = self.scenes.len();
        if count == 0 || other.is_some_and(|other| other.scenes.len() != count) {
            return None;
        }
        let other = other.unwrap_or(self);
        let mut rng = Rng::new(0, "pareto", "scenes");
        let drawn: Vec<f64> = (0..RESAMPLES)
            .map(|_| {
                let draw = |_| (rng.uniform(0.0, count as f64) as usize).min(count - 1);
                let scenes: Vec<usize> = (0..count).map(draw).collect();
                of(&self.front_of(&scenes), &other.front_of(&scenes))
            })
            .collect();
        let value = of(&self.front(), &other.front());
        let [low, high] = [0.025, 0.975].map(|share| statistics::quantile(&drawn, share));
        Some(Estimate { value, low: low?, high: high?, n: count })
    }
}

/// Area that a front dominates, up to the reference point: larger reward and smaller penalty are better.
pub(crate) fn hypervolume(front: &[Measure]) -> f64 {
    let gain = |m: &Measure| [m.reward - REFERENCE[0], REFERENCE[1] - m.penalty];
    let mut points: Vec<[f64; 2]> = front.iter().map(gain).filter(|[x, y]| *x > 0.0 && *y > 0.0).collect();
    points.sort_by(|a, b| b[0].total_cmp(&a[0]));
    let (mut area, mut height) = (0.0, 0.0);
    for (k, [_, y]) in points.iter().enumerate() {
        height = f64::max(height, *y);
        let next = points.get(k + 1).map_or(0.0, |[x, _]| *x);
        area += (points[k][0] - next) * height;
    }
    area
}

/// Root mean square deviation of the attack rate from the straight line between its ends, in points.
pub(crate) fn unevenness(front: &[Measure]) -> f64 {
    let (Some(first), Some(last)) = (front.first(), front.last()) else { return 0.0 };
    let steps = (front.len() - 1).max(1) as f64;
    let deviation = |(k, m): (usize, &Measure)| {
        let line = first.attack + (last.attack - first.attack) * k as f64 / steps;
        (m.attack - line).powi(2)
    };
    let sum: f64 = front.iter().enumerate().map(deviation).sum();
    100.0 * (sum / front.len().max(1) as f64).sqrt()
}

/// Share of the steps in λ at which the reward does not fall, in percent.
pub(crate) fn monotone(front: &[Measure]) -> f64 {
    let steps = front.windows(2);
    let rising = steps.clone().filter(|pair| pair[1].reward >= pair[0].reward).count();
    100.0 * rising as f64 / steps.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(reward: f64, penalty: f64) -> Measure {
        Measure { reward, penalty, ..Measure::default() }
    }

    #[test]
    fn the_hypervolume_is_the_area_of_the_steps() {
        // (1, 2) dominates 1 × 4; (3, 4) adds 2 × 2. (2, 5) is dominated, (4, 7) is beyond the reference.
        let front = [at(1.0, 2.0), at(2.0, 5.0), at(3.0, 4.0), at(4.0, 7.0)];
        assert_eq!(hypervolume(&front), 4.0 + 4.0);
        assert_eq!(hypervolume(&[]), 0.0);
    }

    #[test]
    fn a_straight_rise_is_even_and_monotone() {
        let rise = |of: fn(f64) -> f64| -> Vec<Measure> {
            (0..=4)
                .map(|k| Measure { attack: of(f64::from(k) / 4.0), reward: of(f64::from(k)), ..at(0.0, 2.0) })
                .collect()
        };
        assert!(unevenness(&rise(|x| 0.2 + 0.5 * x)) < 1e-12);
        assert_eq!(monotone(&rise(|x| x)), 100.0);
        assert_eq!(monotone(&rise(|x| if x == 2.0 { 0.0 } else { x })), 75.0);
    }

    #[test]
    fn a_sweep_differs_from_itself_by_nothing() {
        let sweep =
            Sweep { scenes: vec![vec![at(1.0, 2.0), at(2.0, 3.0)], vec![at(3.0, 2.5), at(4.0, 4.0)]] };
        let difference = sweep.difference(&sweep, hypervolume).unwrap();
        assert_eq!((difference.value, difference.low, difference.high), (0.0, 0.0, 0.0));
        let own = sweep.estimate(hypervolume).unwrap();
        assert!(own.low <= own.value && own.value <= own.high);
    }
}
