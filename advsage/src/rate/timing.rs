//! Timing of nominal plans: how recorded cars were timed beside the trajectory of the goal at which they ended.

use sage_core::{
    geometry::Point,
    statistics::{mean, quantile},
};
use sage_generators::{TimedPath, shift_share};
use serde::{Deserialize, Serialize};

/// Number of quantiles of the shifts that a card keeps.
const QUANTILES: usize = 21;
/// Steps at which the likelihood of a timing is taken: 2, 4 and 6 s.
const STEPS: [usize; 3] = [20, 40, 60];
/// Rounds of the fit of a spread, which has long settled by then.
const ROUNDS: usize = 100;

/// How a recorded car was timed beside the trajectory of the goal nearest to its end.
#[derive(Clone, Copy, Debug)]
pub struct RecordedTiming {
    /// The nearest shift, metres.
    shift: f64,
    /// How much further it was at 2, 4 and 6 s, metres.
    further: [f64; 3],
}

impl RecordedTiming {
    /// Of the recorded points of the 80 steps.
    pub fn of(path: &TimedPath, recorded: &[Point; sage_core::motion::HORIZON]) -> Self {
        let further = path.further(recorded);
        Self { shift: path.shift_of(recorded), further: STEPS.map(|step| further[step - 1]) }
    }

    /// Its log-likelihood if every shift is equally likely, and what is left has a normal distribution of a spread.
    fn log_likelihood(&self, shifts: &[f64], spread: f64) -> f64 {
        let left = self.left(shifts);
        let least = left.iter().copied().fold(f64::INFINITY, f64::min);
        let sum: f64 = left.iter().map(|left| (-0.5 * (left - least) / (spread * spread)).exp()).sum();
        let norm = STEPS.len() as f64 * (spread.ln() + 0.5 * std::f64::consts::TAU.ln());
        (sum / shifts.len() as f64).ln() - 0.5 * least / (spread * spread) - norm
    }

    /// Square of what each shift leaves.
    fn left(&self, shifts: &[f64]) -> Vec<f64> {
        let of = |shift: &f64| {
            let pairs = STEPS.iter().zip(self.further);
            pairs.map(|(step, further)| (further - shift * shift_share(*step)).powi(2)).sum()
        };
        shifts.iter().map(of).collect()
    }
}

/// How the shifts of recorded cars are distributed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Their quantiles, metres, each in the middle of its share.
    pub quantiles: Vec<f64>,
}

impl Timing {
    /// That of recorded cars; `None` without any.
    pub fn of(recorded: &[RecordedTiming]) -> Option<Self> {
        let shifts: Vec<f64> = recorded.iter().map(|timing| timing.shift).collect();
        let at = |k| quantile(&shifts, (k as f64 + 0.5) / QUANTILES as f64);
        Some(Self { quantiles: (0..QUANTILES).map(at).collect::<Option<_>>()? })
    }

    /// So many shifts, equally likely; one alone is 0: the trajectory of the goal.
    ///
    /// ```
    /// use advsage::rate::Timing;
    ///
    /// let timing = Timing { quantiles: vec![-3.0, -1.0, 1.0] };
    /// assert_eq!(timing.shifts(1), [0.0]);
    /// assert_eq!(timing.shifts(2), [-2.5, 0.5]);
    /// assert_eq!(timing.shifts(3), [-3.0, -1.0, 1.0]);
    /// ```
    pub fn shifts(&self, count: usize) -> Vec<f64> {
        if count < 2 || self.quantiles.is_empty() {
            return vec![0.0];
        }
        let kept = self.quantiles.len();
        let at = |k: usize| {
            let place = ((k as f64 + 0.5) / count as f64 * kept as f64 - 0.5).clamp(0.0, (kept - 1) as f64);
            let below = place as usize;
            let above = (below + 1).min(kept - 1);
            self.quantiles[below] + (place - below as f64) * (self.quantiles[above] - self.quantiles[below])
        };
        (0..count).map(at).collect()
    }
}

/// The spread, metres, with which recorded timings are likeliest under some shifts.
pub fn fitted_spread(recorded: &[RecordedTiming], shifts: &[f64]) -> f64 {
    let mut spread: f64 = 1.0;
    for _ in 0..ROUNDS {
        // Expectation and maximisation of a mixture with one unknown.
        let squares: Vec<f64> = recorded
            .iter()
            .map(|timing| {
                let left = timing.left(shifts);
                let least = left.iter().copied().fold(f64::INFINITY, f64::min);
                let weighted = |[sum, all]: [f64; 2], left: &f64| {
                    let weight = (-0.5 * (left - least) / (spread * spread)).exp();
                    [sum + weight * left, all + weight]
                };
                let [sum, all] = left.iter().fold([0.0; 2], weighted);
                sum / all / STEPS.len() as f64
            })
            .collect();
        // A spread of 0 has no likelihood.
        spread = mean(&squares).unwrap_or(1.0).sqrt().max(0.01);
    }
    spread
}

/// By how much likelier each timing is with shifts than with the trajectory of the goal alone, nats.
pub fn gains(recorded: &[RecordedTiming], shifts: &[f64], [single, several]: [f64; 2]) -> Vec<f64> {
    let gain = |timing: &RecordedTiming| {
        timing.log_likelihood(shifts, several) - timing.log_likelihood(&[0.0], single)
    };
    recorded.iter().map(gain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::seed::Rng;

    fn drawn(count: usize, shifts: &[f64], spread: f64) -> Vec<RecordedTiming> {
        let mut rng = Rng::new(5, "timings", "test");
        let mut one = || {
            let shift = shifts[((rng.unit() * shifts.len() as f64) as usize).min(shifts.len() - 1)];
            RecordedTiming {
                shift,
                further: STEPS.map(|step| shift * shift_share(step) + spread * rng.normal()),
            }
        };
        (0..count).map(|_| one()).collect()
    }

    #[test]
    fn the_spread_that_made_timings_is_found_and_shifts_pay_where_there_are_shifts() {
        let truth = [-4.0, -1.0, 0.0, 1.0, 4.0];
        let recorded = drawn(4000, &truth, 0.7);
        let spreads = [fitted_spread(&recorded, &[0.0]), fitted_spread(&recorded, &truth)];
        assert!((spreads[1] - 0.7).abs() < 0.02, "{spreads:?}");
        assert!(mean(&gains(&recorded, &truth, spreads)).unwrap() > 0.5);
        let recorded = drawn(4000, &[0.0], 0.7);
        let spreads = [fitted_spread(&recorded, &[0.0]), fitted_spread(&recorded, &truth)];
        assert!(mean(&gains(&recorded, &truth, spreads)).unwrap() < -0.1);
    }

    #[test]
    fn a_log_likelihood_is_that_of_a_normal_distribution() {
        let timing = RecordedTiming { shift: 0.0, further: [1.0, 0.0, 0.0] };
        let normal = -0.5 / 4.0 - 3.0 * (2.0f64.ln() + 0.5 * std::f64::consts::TAU.ln());
        assert!((timing.log_likelihood(&[0.0], 2.0) - normal).abs() < 1e-12);
        assert!((timing.log_likelihood(&[0.0, 0.0], 2.0) - normal).abs() < 1e-12);
    }
}
