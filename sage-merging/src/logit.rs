//! Logit mixing: `log π = Σ w_i log π_i`, renormalised: the geometric mean of the experts' probabilities.
//!
//! Properties: at a corner it is the expert, bit for bit; experts with the same weights mix to them, to
//! rounding; the order of the experts does not matter, except for rounding. With experts that differ in a
//! last linear layer alone it equals weight interpolation.

use std::sync::Arc;

use sage_backbones::MotionModel;
use sage_core::{
    generator::Mixture,
    registry::{Entry, NoOptions},
};

use crate::{
    Error, ExpertSet, Merger, Range,
    output_mixture::{Combination, OutputMixture},
};

/// The geometric mean of the experts' probabilities.
#[derive(Clone, Copy)]
pub struct LogitMixing;

impl Combination for LogitMixing {
    fn combine(weights: &[f64], log_probs: &[f64]) -> f64 {
        weights.iter().zip(log_probs).map(|(weight, log_prob)| weight * log_prob).sum()
    }
}

impl Merger for LogitMixing {
    fn range(&self) -> Range {
        Range::Simplex
    }

    fn model(&self, experts: &ExpertSet, at: &Mixture, _: u64) -> Result<Arc<dyn MotionModel>, Error> {
        OutputMixture::<Self>::model(experts, at)
    }
}

impl Entry<dyn Merger> for LogitMixing {
    const NAME: &'static str = "logit";
    const SUMMARY: &'static str = "weighted mean of the experts' log-probabilities, renormalised";
    const SOURCE: &'static str = "Shi et al. 2024 (MOD, multi-objective decoding)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_worked_by_hand() {
        // Probabilities (0.8, 0.2) and (0.2, 0.8): at half both are 0.4 before the renormalisation.
        let combine = |a: f64, b: f64| LogitMixing::combine(&[0.5, 0.5], &[a.ln(), b.ln()]).exp();
        assert!((combine(0.8, 0.2) - 0.4).abs() < 1e-15 && (combine(0.2, 0.8) - 0.4).abs() < 1e-15);
        // 0.9^0.25 · 0.1^0.75.
        let quarter = LogitMixing::combine(&[0.25, 0.75], &[0.9f64.ln(), 0.1f64.ln()]).exp();
        assert!((quarter - 0.9f64.powf(0.25) * 0.1f64.powf(0.75)).abs() < 1e-15);
    }
}
