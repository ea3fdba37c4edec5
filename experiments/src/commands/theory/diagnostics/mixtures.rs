//! Diagnostics of mixtures against the log: weight against output mixing, and the squared error as a likelihood.

use sage_bench::estimate::of_scenes;
use sage_core::{
    statistics::{self, Estimate},
    text::table::Table,
};
use theory_checks::{Figure, Series};

use super::{
    Diagnostic, Found, cell, unless_few,
    weight_and_output::{COMPARED, Comparison},
};

impl Found {
    /// Weight against output mixing without derivatives.
    pub(super) fn mixing(&self) -> Option<Diagnostic> {
        let mut table = Table::new(
            format!(
                "Half the mean squared distance of the mean trajectory from the log, m²: weight mixing is better where chord − L_w exceeds k E‖Δf‖² (N = {} with a whole log)",
                self.mixing.len()
            ),
            &["λ", "chord − L_w", "k E‖Δf‖²", "L_e − L_w", "scenes where weights are better, %"],
        );
        let mut verdicts = Vec::new();
        for (k, lambda) in COMPARED.iter().enumerate() {
            let mean = |of: fn(&Comparison) -> f64| self.bootstrap(|scenes| average(scenes, k, of));
            let gain = mean(Comparison::gain)?;
            let sign = if gain.low > 0.0 {
                "weights"
            } else if gain.high < 0.0 {
                "outputs"
            } else {
                "neither"
            };
            verdicts.push(format!("{sign} at {lambda}"));
            let cells = [
                cell(&mean(|c| c.chord - c.weight)?, 2),
                cell(&mean(|c| c.diversity)?, 2),
                cell(&gain, 2),
                cell(&mean(|c| if c.gain() > 0.0 { 100.0 } else { 0.0 })?, 0),
            ];
            table.row(format!("{lambda}"), cells);
        }
        Some(Diagnostic {
            id: "G5",
            question: "Does weight mixing beat output mixing in the squared error (T14x)?",
            finding: unless_few(
                self.mixing.len(),
                format!("favoured by the interval: {}", verdicts.join(", ")),
            ),
            caveat: "An exact test without derivatives. A loss below its chord alone is too weak: k E‖Δf‖² is what output mixing gains.",
            tables: vec![table],
            figures: vec![],
        })
    }

    /// The squared error in place of a log-likelihood.
    pub(super) fn surrogate(&self) -> Option<Diagnostic> {
        let mut table = Table::new(
            format!(
                "Squared error of the mean trajectory against the negative log-likelihood (nll) of the mode nearest to the log, by scene (N = {})",
                self.mixing.len()
            ),
            &[
                "λ",
                "rank correlation of both, weight mixing",
                "R² of the best line",
                "scenes where both prefer the same mixture, %",
                "nll of output − weight mixing, nats",
                "squared error of output − weight mixing, m²",
            ],
        );
        let (mut correlations, mut agreements) = (Vec::new(), Vec::new());
        for (k, lambda) in COMPARED.iter().enumerate() {
            let pairs = |scenes: &[&[Comparison; 3]]| -> [Vec<f64>; 2] {
                [scenes.iter().map(|s| s[k].weight).collect(), scenes.iter().map(|s| s[k].nll[0]).collect()]
            };
            let correlation = self.bootstrap(|scenes| {
                let [errors, likelihoods] = pairs(scenes);
                statistics::rank_correlation(&errors, &likelihoods)
            })?;
            let explained = self.bootstrap(|scenes| {
                let [errors, likelihoods] = pairs(scenes);
                explained(&errors, &likelihoods)
            })?;
            let agree = self.bootstrap(|scenes| {
                average(scenes, k, |c| if (c.gain() > 0.0) == (c.nll[1] > c.nll[0]) { 100.0 } else { 0.0 })
            })?;
            let likelihood = self.bootstrap(|scenes| average(scenes, k, |c| c.nll[1] - c.nll[0]))?;
            let error = self.bootstrap(|scenes| average(scenes, k, Comparison::gain))?;
            correlations.push(correlation.value);
            agreements.push(agree.value);
            let cells = [
                cell(&correlation, 2),
                cell(&explained, 2),
                cell(&agree, 0),
                cell(&likelihood, 2),
                cell(&error, 1),
            ];
            table.row(format!("{lambda}"), cells);
        }
        let middle: Vec<[f64; 2]> = self.mixing.iter().map(|s| [s[1].weight, s[1].nll[0]]).collect();
        let greatest = agreements.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let least = agreements.iter().copied().fold(f64::INFINITY, f64::min);
        let most = correlations.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some(Diagnostic {
            id: "G6",
            question: "Can a squared error stand in for the log-likelihood of the motion model?",
            finding: unless_few(
                self.mixing.len(),
                format!(
                    "rank correlation over scenes at most {most:.2}; both prefer the same mixture in {least:.0} to {greatest:.0} % of the scenes"
                ),
            ),
            caveat: "The paper's comparison of mixtures takes the squared error of mixed trajectories for a negative log-likelihood. They are the same only for a normal distribution of fixed width around one trajectory: R² would be 1. The policy here has many modes.",
            tables: vec![table],
            figures: vec![
                Figure::new(
                    "Squared error of the mean trajectory and nll, weight mixing at λ = 0.5, by scene",
                    ["squared error / 2, m²", "nll, nats"],
                    vec![Series::points("scenes", middle)],
                )
                .logarithmic([true, false]),
            ],
        })
    }

    /// A quantity of the scenes with its 95 % interval.
    fn bootstrap(&self, of: impl Fn(&[&[Comparison; 3]]) -> f64 + Sync) -> Option<Estimate> {
        let of = |scenes: &[usize]| of(&scenes.iter().map(|k| &self.mixing[*k]).collect::<Vec<_>>());
        of_scenes(self.mixing.len(), "theory", of)
    }
}

fn average(scenes: &[&[Comparison; 3]], k: usize, of: fn(&Comparison) -> f64) -> f64 {
    let values: Vec<f64> = scenes.iter().map(|scene| of(&scene[k])).collect();
    statistics::mean(&values).unwrap_or(f64::NAN)
}

/// Share of the variance of `y` that a line in `x` explains.
fn explained(x: &[f64], y: &[f64]) -> f64 {
    let mean = |of: &[f64]| statistics::mean(of).unwrap_or(f64::NAN);
    let (mx, my) = (mean(x), mean(y));
    let product = |a: &[f64], ma: f64, b: &[f64], mb: f64| -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - ma) * (b - mb)).sum()
    };
    product(x, mx, y, my).powi(2) / (product(x, mx, x, mx) * product(y, my, y, my))
}
