//! When the adversary attacks in training, and how strongly.

use sage_core::seed::Rng;
use serde::{Deserialize, Serialize};

/// Chooses the intensity of each training episode.
///
/// Implementations are pure: what they need to remember is in [`Progress`], which every run keeps and resumes.
pub trait Curriculum: Send + Sync {
    /// The intensity λ of the next episode's attack; `None` for an episode without attack.
    fn draw(&self, at: &Progress, rng: &mut Rng) -> Option<f64>;

    /// Whether it uses [`Progress::success`], which takes a search for evasive manoeuvres to count.
    fn uses_success(&self) -> bool {
        false
    }
}

/// How far the training is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Share of the steps that are done, 0 to 1.
    pub share: f64,
    /// Success so far, by intensity.
    pub success: &'a SuccessRates,
}

/// Intensities at which success is counted, besides episodes without attack.
pub const INTENSITIES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Episodes over which a success rate is averaged.
const MEMORY: f64 = 50.0;

/// Rate of success in episodes without attack and at each intensity: exponential means over 50 episodes.
///
/// Success is an episode without contact with the adversary in which the car completes 80 % of its route. A failure
/// against an attack that is not shown avoidable counts as neither.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SuccessRates {
    /// Without attack, then at each of [`INTENSITIES`].
    pub rates: [f64; 1 + INTENSITIES.len()],
}

impl Default for SuccessRates {
    fn default() -> Self {
        Self { rates: [0.5; 1 + INTENSITIES.len()] }
    }
}

impl SuccessRates {
    /// Counts an episode at an intensity.
    pub fn count(&mut self, intensity: Option<f64>, success: bool) {
        let rate = &mut self.rates[bin(intensity)];
        *rate += (f64::from(u8::from(success)) - *rate) / MEMORY;
    }
}

/// Index of an intensity's rate: the nearest one.
fn bin(intensity: Option<f64>) -> usize {
    let Some(lambda) = intensity else { return 0 };
    let gap = |k: &usize| (INTENSITIES[*k] - lambda).abs();
    1 + (0..INTENSITIES.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn success_is_counted_at_the_nearest_intensity() {
        let mut success = SuccessRates::default();
        success.count(Some(0.6), true);
        success.count(None, false);
        assert_eq!(success.rates, [0.49, 0.5, 0.5, 0.51, 0.5, 0.5]);
    }
}
