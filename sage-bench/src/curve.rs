//! Quantities of curves over λ: areas, evenness, heights above a chord, and the share of λ in a change.
//!
//! A [`Curve`] holds the metrics of every scene at every point. A quantity is a function of the means over scenes, and
//! its interval is that of the bootstrap over scenes.

use sage_backbones::training::Expectation;
use sage_core::statistics::{Estimate, mean};
use serde::{Deserialize, Serialize};

use crate::estimate::of_scenes;

/// Seeds the bootstrap, the same for all curves, so that their differences are paired.
const STREAM: &str = "curve";
/// Reference point of the hypervolume: R_adv 0 and P_real 6.
const REFERENCE: [f64; 2] = [0.0, 6.0];

/// Values of a point of a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// R_adv.
    pub reward: f64,
    /// P_real.
    pub penalty: f64,
    /// Rate of attacks, or their probability.
    pub attack: f64,
    /// Rate of believable attacks, or their probability.
    pub believable: f64,
}

impl From<Expectation> for Point {
    fn from(e: Expectation) -> Self {
        Self { reward: e.reward, penalty: e.penalty, attack: e.attack, believable: e.believable }
    }
}

impl Point {
    fn mean(all: impl Iterator<Item = Self>) -> Self {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for p in all {
            sum = Self {
                reward: sum.reward + p.reward,
                penalty: sum.penalty + p.penalty,
                attack: sum.attack + p.attack,
                believable: sum.believable + p.believable,
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

/// For each scene, the values at every point.
///
/// ```
/// use sage_bench::curve::{Curve, Point};
///
/// // Two scenes at λ = 0 and 1: neither is attacked at first, one at the end.
/// let attack = |attack| Point { attack, ..Point::default() };
/// let curve = Curve { scenes: vec![vec![attack(0.0), attack(1.0)], vec![attack(0.0), attack(0.0)]] };
/// let rise = curve.estimate(|front| front[1].attack - front[0].attack).ok_or("no scenes")?;
/// assert_eq!((rise.value, rise.n), (0.5, 2));
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// By scene, then by point.
    pub scenes: Vec<Vec<Point>>,
}

impl Curve {
    /// Mean over scenes at every point.
    pub fn front(&self) -> Vec<Point> {
        self.front_of(&(0..self.scenes.len()).collect::<Vec<_>>())
    }

    fn front_of(&self, scenes: &[usize]) -> Vec<Point> {
        let points = self.scenes.first().map_or(0, Vec::len);
        (0..points).map(|k| Point::mean(scenes.iter().map(|&scene| self.scenes[scene][k]))).collect()
    }

    /// A quantity of the means with its 95 % interval; `None` without scenes.
    pub fn estimate(&self, of: impl Fn(&[Point]) -> f64 + Sync) -> Option<Estimate> {
        of_scenes(self.scenes.len(), STREAM, |scenes| of(&self.front_of(scenes)))
    }

    /// Difference of a quantity from that of another curve over the same scenes.
    pub fn difference(&self, other: &Self, of: impl Fn(&[Point]) -> f64 + Sync) -> Option<Estimate> {
        self.against(other, |own, other| of(own) - of(other))
    }

    /// A quantity of two curves over the same scenes.
    pub fn against(&self, other: &Self, of: impl Fn(&[Point], &[Point]) -> f64 + Sync) -> Option<Estimate> {
        if other.scenes.len() != self.scenes.len() {
            return None;
        }
        of_scenes(self.scenes.len(), STREAM, |scenes| of(&self.front_of(scenes), &other.front_of(scenes)))
    }

    /// The curve of one of its points alone.
    pub fn only(&self, point: usize) -> Self {
        Self { scenes: self.scenes.iter().map(|points| vec![points[point]]).collect() }
    }
}

/// A value of a point that is maximised.
pub type Value = fn(&Point) -> f64;

/// The rewards that the theory is about. The experts maximise the mixtures of both with weight 0.9.
pub const VALUES: [(&str, Value); 4] = [
    ("R_adv", |p| p.reward),
    ("-P_real", |p| -p.penalty),
    ("0.9 R_adv - 0.1 P_real", |p| 0.9 * p.reward - 0.1 * p.penalty),
    ("0.1 R_adv - 0.9 P_real", |p| 0.1 * p.reward - 0.9 * p.penalty),
];

/// What a value does along a path from one expert to another. The chord between the ends is what probability mixing
/// attains: expectations are linear in the probabilities.
pub struct Path {
    /// Least height above the chord at the inner points; below 0 it is a barrier of the loss, the negative value.
    pub least: Estimate,
    /// Mean height at the inner points.
    pub mean: Estimate,
    /// Share of the inner points at which the second difference is not above 0, in percent.
    pub concave: Estimate,
}

impl Path {
    /// The path of a value over increasing λ, one for each point; `None` without scenes or without an inner point.
    pub fn of(curve: &Curve, lambdas: &[f64], value: Value) -> Option<Self> {
        if lambdas.len() < 3 {
            return None;
        }
        let values = |front: &[Point]| front.iter().map(value).collect::<Vec<_>>();
        let heights = |front: &[Point]| heights(lambdas, &values(front));
        Some(Self {
            least: curve.estimate(|front| heights(front).into_iter().fold(f64::INFINITY, f64::min))?,
            mean: curve.estimate(|front| mean(&heights(front)).unwrap_or(0.0))?,
            concave: curve.estimate(|front| concave(lambdas, &values(front)))?,
        })
    }
}

/// Area that a front dominates, up to the reference point: larger reward and smaller penalty are better.
///
/// ```
/// use sage_bench::curve::{Point, hypervolume};
///
/// let point = |reward, penalty| Point { reward, penalty, ..Point::default() };
/// // R_adv 1 at a P_real of 2, and 3 at 4: rectangles up to the reference point (0, 6).
/// assert_eq!(hypervolume(&[point(1.0, 2.0), point(3.0, 4.0)]), 1.0 * 4.0 + 2.0 * 2.0);
/// // A point that another one dominates adds nothing.
/// assert_eq!(hypervolume(&[point(3.0, 4.0), point(2.0, 5.0)]), 6.0);
/// ```
pub fn hypervolume(front: &[Point]) -> f64 {
    let gain = |p: &Point| [p.reward - REFERENCE[0], REFERENCE[1] - p.penalty];
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

/// Share of the steps at which the reward does not fall, in percent.
pub fn monotone(front: &[Point]) -> f64 {
    let steps = front.windows(2);
    let rising = steps.clone().filter(|pair| pair[1].reward >= pair[0].reward).count();
    100.0 * rising as f64 / steps.len().max(1) as f64
}

/// Deviation of rates from the straight line between their ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearity {
    /// Root mean square of the distances from the line.
    pub rms: f64,
    /// Largest distance from the line.
    pub worst: f64,
    /// Largest drop between neighbouring rates.
    pub largest_drop: f64,
    /// Last rate minus the first.
    pub span: f64,
}

impl Linearity {
    /// Of rates at increasing positions; all 0 without any.
    pub fn of(positions: &[f64], rates: &[f64]) -> Self {
        let (Some(low), Some(high)) = (rates.first().copied(), rates.last().copied()) else {
            return Self { rms: 0.0, worst: 0.0, largest_drop: 0.0, span: 0.0 };
        };
        let line = |k: usize| low + (high - low) * share(positions, k);
        let distances: Vec<f64> = rates.iter().enumerate().map(|(k, rate)| (rate - line(k)).abs()).collect();
        Self {
            rms: (distances.iter().map(|d| d * d).sum::<f64>() / distances.len() as f64).sqrt(),
            worst: distances.iter().copied().fold(0.0, f64::max),
            largest_drop: rates.windows(2).map(|pair| pair[0] - pair[1]).fold(0.0, f64::max),
            span: high - low,
        }
    }
}

/// Root mean square deviation of the attack rate from the straight line between its ends, in points.
pub fn unevenness(positions: &[f64], front: &[Point]) -> f64 {
    100.0 * Linearity::of(positions, &front.iter().map(|p| p.attack).collect::<Vec<_>>()).rms
}

/// Where a position lies between the first and the last, from 0 to 1.
fn share(positions: &[f64], k: usize) -> f64 {
    match positions {
        [first, .., last] => (positions[k] - first) / (last - first),
        _ => 0.0,
    }
}

/// Heights above the chord between the ends, at the inner ones of increasing λ. The chord is what mixing of probabilities
/// attains.
pub fn heights(lambdas: &[f64], values: &[f64]) -> Vec<f64> {
    let last = values.len().saturating_sub(1);
    let (first, end) = (values.first().copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0));
    let height = |k: usize| {
        let share = share(lambdas, k);
        values[k] - ((1.0 - share) * first + share * end)
    };
    (1..last).map(height).collect()
}

/// Share of the inner ones of increasing λ at which the slope does not rise, in percent.
pub fn concave(lambdas: &[f64], values: &[f64]) -> f64 {
    let slopes: Vec<f64> =
        lambdas.windows(2).zip(values.windows(2)).map(|(l, v)| (v[1] - v[0]) / (l[1] - l[0])).collect();
    let bends = slopes.windows(2).map(|pair| pair[1] - pair[0]);
    let (count, down) =
        bends.fold((0.0, 0.0), |(count, down), bend| (count + 1.0, down + f64::from(u8::from(bend <= 0.0))));
    100.0 * down / f64::max(count, 1.0)
}

/// λ at which `mu R_adv − (1 − mu) P_real` is largest; 0 without points.
pub fn best_lambda(lambdas: &[f64], front: &[Point], mu: f64) -> f64 {
    let value = |p: &Point| mu * p.reward - (1.0 - mu) * p.penalty;
    let best = (0..front.len()).max_by(|a, b| value(&front[*a]).total_cmp(&value(&front[*b])));
    best.map_or(0.0, |k| lambdas[k])
}

/// Shapley share of λ in the change of a value when λ and μ rise from 0 to 1: the mean of the changes by λ at μ = 0
/// and at μ = 1, divided by the whole change. `None` if nothing changes. The values are at (λ, μ) = (0, 0), (1, 0),
/// (0, 1) and (1, 1).
pub fn shapley_of_lambda([none, lambda, mu, both]: [f64; 4]) -> Option<f64> {
    (both != none).then(|| 0.5 * ((lambda - none) + (both - mu)) / (both - none))
}

/// The largest value on a front at no more than a penalty, straight between its points; that of the most realistic
/// point if all are less realistic, which happens in resamples.
pub fn within(front: &[Point], penalty: f64, value: fn(&Point) -> f64) -> f64 {
    let at = |p: &Point| (p.penalty <= penalty).then(|| value(p));
    let crossing = |pair: &[Point]| {
        let [a, b] = [&pair[0], &pair[1]];
        let share = (penalty - a.penalty) / (b.penalty - a.penalty);
        (0.0..=1.0).contains(&share).then(|| value(a) + share * (value(b) - value(a)))
    };
    let all = front.iter().filter_map(at).chain(front.windows(2).filter_map(crossing));
    all.reduce(f64::max).unwrap_or_else(|| {
        let most = front.iter().min_by(|a, b| a.penalty.total_cmp(&b.penalty));
        most.map_or(0.0, value)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(reward: f64, penalty: f64, attack: f64) -> Point {
        Point { reward, penalty, attack, believable: 0.0 }
    }

    #[test]
    fn the_hypervolume_is_the_area_of_steps() {
        // Up to (0, 6): 2 × 4 of the first, then (5 − 2) × 1 of the second; the third is dominated.
        let front = [at(2.0, 2.0, 0.0), at(5.0, 5.0, 0.0), at(1.0, 3.0, 0.0)];
        assert_eq!(hypervolume(&front), 11.0);
        assert_eq!(hypervolume(&[at(-1.0, 2.0, 0.0), at(1.0, 7.0, 0.0)]), 0.0);
    }

    #[test]
    fn evenness_is_measured_from_the_line_between_the_ends() {
        // The line is 0, 0.5, 1; the middle lies 0.3 below: RMS 0.3/√3.
        let rates = Linearity::of(&[0.0, 0.5, 1.0], &[0.0, 0.2, 1.0]);
        assert!((rates.rms - 0.3 / 3f64.sqrt()).abs() < 1e-12 && (rates.worst - 0.3).abs() < 1e-12);
        assert_eq!((rates.largest_drop, rates.span), (0.0, 1.0));
        assert!((Linearity::of(&[0.0, 0.5, 1.0], &[0.5, 0.2, 0.4]).largest_drop - 0.3).abs() < 1e-12);
        let front = [at(1.0, 0.0, 0.0), at(2.0, 0.0, 0.2), at(1.5, 0.0, 1.0)];
        assert!((unevenness(&[0.0, 0.5, 1.0], &front) - 100.0 * rates.rms).abs() < 1e-12);
        assert_eq!(monotone(&front), 50.0);
    }

    #[test]
    fn heights_and_bends_are_those_of_a_parabola() {
        // x (1 − x) at 0, ¼, ½, ¾, 1 over a chord of 0.
        let parabola = |lambdas: &[f64]| lambdas.iter().map(|x| x * (1.0 - x)).collect::<Vec<_>>();
        let lambdas = [0.0, 0.25, 0.5, 0.75, 1.0];
        assert_eq!(heights(&lambdas, &parabola(&lambdas)), [0.1875, 0.25, 0.1875]);
        assert_eq!(concave(&lambdas, &parabola(&lambdas)), 100.0);
        assert_eq!(concave(&lambdas[..3], &[0.0, -1.0, 0.0]), 0.0);
        // Uneven steps, and a part of the path: the chord is 0.75 λ from 0 to 1/4.
        let uneven = [0.0, 0.125, 0.25];
        assert_eq!(heights(&uneven, &parabola(&uneven)), [0.015625]);
        let uneven = [0.0, 0.25, 1.0];
        assert_eq!(heights(&uneven, &parabola(&uneven)), [0.1875]);
        assert_eq!(concave(&uneven, &parabola(&uneven)), 100.0);
        assert_eq!(heights(&uneven, &uneven), [0.0]);
    }

    #[test]
    fn a_parabola_lies_above_its_chord_and_a_valley_has_a_barrier() {
        let path = |of: fn(f64) -> f64| {
            let points = (0..=4).map(|k| at(of(f64::from(k) / 4.0), 0.0, 0.0)).collect();
            Path::of(&Curve { scenes: vec![points; 3] }, &[0.0, 0.25, 0.5, 0.75, 1.0], VALUES[0].1).unwrap()
        };
        let hill = path(|x| 2.0 * x + x * (1.0 - x));
        // At 1/4 and 3/4 the height is 3/16, at 1/2 it is 1/4.
        assert!((hill.least.value - 0.1875).abs() < 1e-12 && hill.concave.value == 100.0);
        assert!((hill.mean.value - (2.0 * 0.1875 + 0.25) / 3.0).abs() < 1e-12);
        let valley = path(|x| x - x * (1.0 - x));
        assert!((valley.least.value + 0.25).abs() < 1e-12 && valley.concave.value == 0.0);
        assert!(Path::of(&Curve::default(), &[0.0, 0.5, 1.0], VALUES[0].1).is_none());
    }

    #[test]
    fn shares_of_lambda_add_up() {
        // λ alone 3, μ alone 1, both 10: (3 + 9)/2 of 10.
        assert_eq!(shapley_of_lambda([0.0, 3.0, 1.0, 10.0]), Some(0.6));
        assert_eq!(shapley_of_lambda([1.0, 3.0, 2.0, 1.0]), None);
        let front = [at(0.0, 1.0, 0.0), at(2.0, 2.0, 0.0), at(3.0, 6.0, 0.0)];
        assert_eq!([0.0, 0.5, 1.0].map(|mu| best_lambda(&[0.0, 0.1, 1.0], &front, mu)), [0.0, 0.1, 1.0]);
    }

    #[test]
    fn the_front_is_read_straight_between_its_points() {
        let front = [at(0.0, 2.0, 0.1), at(0.0, 2.4, 0.5), at(0.0, 3.0, 0.9)];
        let attack = |penalty| within(&front, penalty, |p| p.attack);
        assert!((attack(2.2) - 0.3).abs() < 1e-12 && (attack(2.7) - 0.7).abs() < 1e-12);
        assert_eq!((attack(4.0), attack(1.0)), (0.9, 0.1));
    }

    #[test]
    fn differences_of_curves_are_paired_by_scene() {
        let curve = |plus: f64| Curve {
            scenes: (0..6)
                .map(|k| vec![at(f64::from(k) + plus, 1.0, 0.0), at(f64::from(k), 1.0, 0.0)])
                .collect(),
        };
        let e = curve(1.0).difference(&curve(0.0), |front| front[0].reward).unwrap();
        assert_eq!((e.value, e.n), (1.0, 6));
        assert!((e.low - 1.0).abs() < 1e-9 && (e.high - 1.0).abs() < 1e-9, "{e:?}");
        assert_eq!(curve(0.0).only(1).front(), [at(2.5, 1.0, 0.0)]);
    }
}
