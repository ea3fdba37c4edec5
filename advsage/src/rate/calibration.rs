//! Whether a density of goals is calibrated: how often recorded ends lie in its sets.

use sage_core::geometry::Point;
use sage_generators::GoalDensity;
use serde::{Deserialize, Serialize};

use super::Timing;

/// Shares of probability whose sets are examined.
pub const LEVELS: [f64; 3] = [0.5, 0.8, 0.95];
/// Temperatures that are allowed.
pub const TEMPERATURES: [f64; 2] = [0.1, 10.0];

/// Where a recorded track ended, in the density of a prior.
#[derive(Clone, Debug)]
pub struct RecordedEnd {
    log_probs: Vec<f64>,
    /// The goal nearest to the end.
    goal: usize,
}

impl RecordedEnd {
    /// The goal of the density that is nearest to the end; `None` without goals.
    pub fn of(density: GoalDensity, end: Point) -> Option<Self> {
        let goal = density.nearest(end)?;
        Some(Self { log_probs: density.log_probs, goal })
    }

    /// Mean of the log-probabilities at an inverse temperature.
    fn mean(&self, inverse: f64) -> f64 {
        let most = self.log_probs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weighted = |[sum, all]: [f64; 2], log_prob: &f64| {
            let weight = ((log_prob - most) * inverse).exp();
            [sum + weight * log_prob, all + weight]
        };
        let [sum, all] = self.log_probs.iter().fold([0.0; 2], weighted);
        sum / all
    }

    /// Its negative log-likelihood at a temperature, nats.
    pub fn nll(&self, temperature: f64) -> f64 {
        let scaled = |log_prob: &f64| log_prob / temperature;
        let most = self.log_probs.iter().map(scaled).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = self.log_probs.iter().map(|log_prob| (scaled(log_prob) - most).exp()).sum();
        most + sum.ln() - scaled(&self.log_probs[self.goal])
    }

    /// Whether it is in the smallest set of goals that has at least a share of the probability.
    pub fn is_in_set(&self, temperature: f64, level: f64) -> bool {
        let own = self.log_probs[self.goal];
        let most = self.log_probs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weight = |log_prob: &f64| ((log_prob - most) / temperature).exp();
        let all: f64 = self.log_probs.iter().map(weight).sum();
        let likelier: f64 = self.log_probs.iter().filter(|other| **other > own).map(weight).sum();
        likelier < level * all
    }
}

/// The temperature at which recorded ends are most likely, within [`TEMPERATURES`].
pub fn fitted_temperature(ends: &[RecordedEnd]) -> f64 {
    // The log-likelihood is concave in the inverse temperature: its slope changes sign once.
    let [mut high, mut low] = TEMPERATURES.map(f64::recip);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let slope: f64 = ends.iter().map(|end| end.log_probs[end.goal] - end.mean(middle)).sum();
        *(if slope > 0.0 { &mut low } else { &mut high }) = middle;
    }
    2.0 / (low + high)
}

/// What is known of the nominal density of some weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NominalCard {
    /// Temperature at which its log-probabilities are a calibrated density.
    pub temperature: f64,
    /// Hash of the prior.
    pub prior: String,
    /// The command that fitted it.
    pub command: String,
    /// How often recorded ends lie in its sets: of the scenes of the fit, and of others.
    pub coverage: Vec<Coverage>,
    /// How recorded cars are timed beside the trajectories of their goals; none if it was not fitted.
    #[serde(default)]
    pub timing: Option<Timing>,
    /// What several timings of a goal gain: of the scenes of the fit, and of others.
    #[serde(default)]
    pub timing_gain: Vec<TimingGain>,
    /// How often recorded egos are met: of the scenes of the fit, and of others.
    #[serde(default)]
    pub meetings: Vec<Meetings>,
}

/// How often adversaries meet recorded egos: the recorded ones, and the feasible plans of the density and of one that looks out, in
/// scenes in which both have some.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Meetings {
    /// The scenes.
    pub scenes: String,
    /// Whose plans.
    pub whose: String,
    /// Number of adversaries, one a scene.
    pub adversaries: usize,
    /// Share with a contact, with its interval over scenes.
    pub contact: [f64; 3],
    /// Share with a post-encroachment time below 1 s, with its interval over scenes.
    pub near_miss: [f64; 3],
}

/// By how much likelier recorded timings are with several shifts of a goal's trajectory than with the trajectory alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimingGain {
    /// The scenes.
    pub scenes: String,
    /// Whether the timing was fitted to them.
    pub fitted: bool,
    /// Number of shifts.
    pub profiles: usize,
    /// Number of adversaries, one a scene.
    pub tracks: usize,
    /// Mean and its interval over scenes, nats.
    pub nats: [f64; 3],
}

/// How often recorded ends lie in the sets of a density at its temperature.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// The scenes.
    pub scenes: String,
    /// Whose ends: `adversary` or `ego`.
    pub role: String,
    /// Whether the temperature was fitted to them.
    pub fitted: bool,
    /// Number of tracks, one a scene.
    pub tracks: usize,
    /// Mean negative log-likelihood at temperature 1 and at the fitted one, nats.
    pub nll: [f64; 2],
    /// For each level its share of the probability, and the share of ends in the set with its interval over scenes.
    pub sets: Vec<[f64; 4]>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::seed::Rng;

    /// Ends that are drawn from a density whose log-probabilities are written as those of a temperature.
    fn drawn(temperature: f64) -> Vec<RecordedEnd> {
        let mut rng = Rng::new(4, "ends", "test");
        let one = |_| {
            let log_probs: Vec<f64> = (0..40).map(|_| 2.0 * rng.normal()).collect();
            let density = |k: usize| (log_probs[k] / temperature).exp();
            let mut left = rng.unit() * (0..40).map(density).sum::<f64>();
            let mut goal = 0;
            while goal < 39 && left > density(goal) {
                left -= density(goal);
                goal += 1;
            }
            RecordedEnd { log_probs, goal }
        };
        (0..4000).map(one).collect()
    }

    #[test]
    fn the_temperature_that_made_the_ends_is_found_and_its_sets_hold_their_share() {
        for truth in [0.6, 1.0, 2.5] {
            let ends = drawn(truth);
            let found = fitted_temperature(&ends);
            assert!((found / truth - 1.0).abs() < 0.1, "{found} and {truth}");
            for level in LEVELS {
                let count = ends.iter().filter(|end| end.is_in_set(found, level)).count();
                let share = count as f64 / ends.len() as f64;
                // The set has at least its share, and at most one goal more.
                assert!(share > level - 0.03 && share < level + 0.2, "{truth} {level}: {share}");
            }
        }
    }

    #[test]
    fn the_end_is_that_of_the_nearest_goal() {
        let density = || GoalDensity {
            goals: vec![[0.0, 0.0], [10.0, 0.0]],
            log_probs: vec![0.8f64.ln(), 0.2f64.ln()],
        };
        let end = RecordedEnd::of(density(), [7.0, 1.0]).unwrap();
        assert!((end.nll(1.0) + 0.2f64.ln()).abs() < 1e-12);
        assert!(!end.is_in_set(1.0, 0.8) && end.is_in_set(1.0, 0.81));
        // The likeliest goal is in every set.
        assert!(RecordedEnd::of(density(), [1.0, 0.0]).unwrap().is_in_set(1.0, 0.01));
        assert!(RecordedEnd::of(GoalDensity { goals: vec![], log_probs: vec![] }, [0.0, 0.0]).is_none());
    }
}
