//! Probability mixing: `π = Σ w_i π_i`, the mixture of the experts as distributions.
//!
//! Properties: at a corner it is the expert, bit for bit; the probability of any mode is between those of the
//! experts; the order of the experts does not matter, except for rounding.

use std::sync::Arc;

use sage_backbones::MotionModel;
use sage_core::{
    generator::Mixture,
    registry::{Entry, NoOptions},
};

use crate::{
    Error, ExpertSet, Merger, Range,
    output_mixture::{Combination, OutputMixture, log_sum_exp},
};

/// The weighted mean of the experts' probabilities.
#[derive(Clone, Copy)]
pub struct ProbabilityMixing;

impl Combination for ProbabilityMixing {
    fn combine(weights: &[f64], log_probs: &[f64]) -> f64 {
        let terms: Vec<f64> = weights.iter().zip(log_probs).map(|(w, log_prob)| w.ln() + log_prob).collect();
        log_sum_exp(&terms)
    }
}

impl Merger for ProbabilityMixing {
    fn range(&self) -> Range {
        Range::Simplex
    }

    fn model(&self, experts: &ExpertSet, at: &Mixture, _: u64) -> Result<Arc<dyn MotionModel>, Error> {
        OutputMixture::<Self>::model(experts, at)
    }
}

impl Entry<dyn Merger> for ProbabilityMixing {
    const NAME: &'static str = "probability";
    const SUMMARY: &'static str = "weighted mean of the experts' probabilities";
    const SOURCE: &'static str = "this project: a mixture of distributions";
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
        // 0.25 × 0.8 + 0.75 × 0.2.
        let mixed = ProbabilityMixing::combine(&[0.25, 0.75], &[0.8f64.ln(), 0.2f64.ln()]).exp();
        assert!((mixed - 0.35).abs() < 1e-15);
    }
}
