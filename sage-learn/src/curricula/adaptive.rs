//! The adaptive curriculum: intensities at which success is neither sure nor hopeless come more often.
//!
//! Intensity b is drawn with probability in proportion to `q (1 − q) + 0.02`, with the success rate q at b (learnability,
//! Rutherford et al. 2024, arXiv 2408.15099). One episode in ten at least has no attack.

use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};
use sage_sim::curriculum::{Curriculum, INTENSITIES, Progress};

/// Weight of an intensity with a success rate of 0 or 1.
const LEAST_WEIGHT: f64 = 0.02;
/// Least share of episodes without attack.
const UNATTACKED: f64 = 0.1;

/// The curriculum `adaptive`.
#[derive(Clone, Debug, Default)]
pub struct Adaptive;

impl Entry<dyn Curriculum> for Adaptive {
    const NAME: &'static str = "adaptive";
    const SUMMARY: &'static str = "intensities at which success is neither sure nor hopeless";
    const SOURCE: &'static str = "this project, after Rutherford et al. 2024";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Curriculum>, String> {
        Ok(Box::new(Self))
    }
}

impl Curriculum for Adaptive {
    fn draw(&self, at: &Progress, rng: &mut Rng) -> Option<f64> {
        let [none, attacked @ ..] = at.success.rates.map(|q| q * (1.0 - q) + LEAST_WEIGHT);
        let sum: f64 = attacked.iter().sum();
        if rng.unit() < (none / (none + sum)).max(UNATTACKED) {
            return None;
        }
        let mut left = rng.unit() * sum;
        let found = INTENSITIES.iter().zip(attacked).find(|(_, weight)| {
            left -= weight;
            left < 0.0
        });
        found.map(|(lambda, _)| *lambda).or(Some(INTENSITIES[INTENSITIES.len() - 1]))
    }

    fn uses_success(&self) -> bool {
        true
    }
}
