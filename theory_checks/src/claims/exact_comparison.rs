//! T14x: the comparison without any approximation.

use sage_core::registry::{Entry, NoOptions};

use super::nets::{SIZES, problem};
use crate::{
    Check, Report, Setup,
    quadrature::{gauss_legendre, integral},
    random::log_uniform,
};

/// Inputs of a network, and nodes on each side of the kernel's kink.
const INPUTS: usize = 32;
const NODES: usize = 60;
const TOLERANCE: f64 = 1e-12;

/// The claim T14x.
pub struct ExactComparison;

impl Entry<dyn Check> for ExactComparison {
    const NAME: &'static str = "T14x";
    const SUMMARY: &'static str = "L_w − L_e = −∫ w L'' dt + k E‖Δf‖² exactly; a test without derivatives";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

impl Check for ExactComparison {
    fn formula(&self) -> &'static str {
        "L_e = chord − k E‖Δf‖², L_w = chord − ∫ w L'' dt: weight mixing is better iff chord − L_w > k E‖Δf‖²"
    }

    fn experiment(&self) -> &'static str {
        "50 random 4-16-3 tanh networks (weights as in T14, δ times 10^[-1.5, 0], 32 inputs), α in [0.05, 0.95], Gauss and Legendre's quadrature with 60 nodes on each side of the kink"
    }

    fn caveat(&self) -> &'static str {
        "a loss below its chord (a reward above it) is the condition with 0 on the right: too weak"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["without k E‖Δf‖²"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let nodes = gauss_legendre(NODES);
        let tally = setup.each("T14x", 50, |_, rng, tally| {
            let scale = log_uniform(rng, [-1.5, 0.0]);
            let alpha = rng.uniform(0.05, 0.95);
            let problem = problem(rng, SIZES, INPUTS, scale);
            let mixing = problem.at(alpha);
            let scale = 1.0 + mixing.chord;
            let diversity = if injected == Some(0) { 0.0 } else { mixing.k() * mixing.distance };
            tally.equal(mixing.chord - diversity, mixing.output, TOLERANCE * scale);
            let weighted = |t: f64| ((1.0 - alpha) * t).min(alpha * (1.0 - t)) * problem.at(t).bend();
            let bent = integral(&nodes, 0.0, alpha, weighted) + integral(&nodes, alpha, 1.0, weighted);
            tally.equal(mixing.chord - bent, mixing.weight, TOLERANCE * scale);
            tally.equal(diversity - bent, mixing.difference(), TOLERANCE * scale);
            let is_better = mixing.chord - mixing.weight > diversity;
            if mixing.difference().abs() > TOLERANCE * scale {
                tally.holds(is_better == (mixing.difference() < 0.0));
            }
        });
        tally.report(vec![], vec![])
    }
}
