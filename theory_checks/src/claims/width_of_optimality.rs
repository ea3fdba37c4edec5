//! T11: the width of the preferences that are served exactly, and what β is best for.

use sage_core::{
    registry::{Entry, NoOptions},
    statistics,
};

use super::{quadratics::Quadratics, unequal_curvature::Line};
use crate::{
    Agreement::{Distance, Factor},
    Check, Figure, Number, Preference, Report, Series, Setup, Table, Verdict,
};

/// Widths and gaps of equal curvature: β and the width.
const WIDTHS: [(f64, f64); 6] = [(0.51, 0.02), (0.6, 0.2), (0.75, 0.5), (0.9, 0.8), (0.99, 0.98), (1.0, 1.0)];
/// Steps of μ for the width and the mean.
const STEPS: usize = 2000;
/// β of the table.
const BETAS: [f64; 7] = [0.51, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0];
/// Condition number, then of an independent implementation: medians of the largest gap, seeds where β = 0.9, 0.95 and 1
/// are best, and the best β for the mean gap.
type Known = (f64, [f64; 7], [f64; 3], f64);
const MEDIANS: [Known; 3] = [
    (1.0, [2.51, 1.67, 0.94, 0.42, 0.105, 0.026, 0.0], [0.0, 0.0, 60.0], 1.0),
    (10.0, [8.08, 5.97, 3.87, 2.10, 0.69, 0.70, 1.34], [29.0, 31.0, 0.0], 0.9),
    (100.0, [23.7, 18.9, 15.1, 10.3, 4.9, 5.4, 16.0], [39.0, 21.0, 0.0], 0.8),
];
const DIMENSION: usize = 10;
const SEEDS: usize = 60;
/// Gaps below this are rounding.
const ROUNDING: f64 = 1e-9;
/// Steps of μ of the table.
const PREFERENCES: usize = 40;

/// The claim T11.
pub struct WidthOfOptimality;

impl Entry<dyn Check> for WidthOfOptimality {
    const NAME: &'static str = "T11";
    const SUMMARY: &'static str = "β nearer to 0.5 serves a wider range of preferences exactly";
    const SOURCE: &'static str = "SAGE (ICLR 2026), remark on β; corrected by this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Width of the μ without a gap, largest gap and mean gap, for curvatures 1 and optima 1 apart, by search.
fn equal_curvature(beta: f64) -> [f64; 3] {
    let line = Line { a: 1.0, b: 1.0 };
    let gap = |k: usize| {
        let mu = (k as f64 + 0.5) / STEPS as f64;
        line.direct(Preference { mu, beta })[1]
    };
    let gaps: Vec<f64> = (0..STEPS).map(gap).collect();
    let served = gaps.iter().filter(|gap| **gap < 1e-14).count() as f64 / STEPS as f64;
    let ends = [0.0, 1.0].map(|mu| line.direct(Preference { mu, beta })[1]);
    [served, ends[0].max(ends[1]), gaps.iter().sum::<f64>() / STEPS as f64]
}

impl Check for WidthOfOptimality {
    fn formula(&self) -> &'static str {
        "equal curvature: the width is 2β − 1, the largest gap η/2 (1 − β)² Δ², the mean gap η/3 (1 − β)³ Δ²"
    }

    fn experiment(&self) -> &'static str {
        "six β, gaps by search on 2000 values of μ; and 60 pairs of quadratics in 10 dimensions for each condition number κ (spectra log-uniform in [1, κ], random rotations, normal optima), 41 values of μ"
    }

    fn caveat(&self) -> &'static str {
        "the sentence has it backwards; a β below 1 pays only where Hessians differ, because a long segment leaves the curve of the optima: 0.9 is a matter of conditioning"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["width 2 (1 − β)"]
    }

    fn expected(&self) -> Verdict {
        Verdict::FailsAsPrinted
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let mut widths = Table::new(
            "Equal curvature η = 1, optima 1 apart",
            &["β", "width of μ without a gap", "largest gap", "mean gap over μ"],
        );
        let mut tally = setup.each("T11 widths", 1, |_, _, tally| {
            for (beta, known) in WIDTHS {
                let [width, largest, mean] = equal_curvature(beta);
                let formula = if injected == Some(0) { 2.0 * (1.0 - beta) } else { 2.0 * beta - 1.0 };
                tally.compare_stored(formula, known, 1e-12);
                tally.equal(formula, width, 2.0 / STEPS as f64);
                tally.equal(0.5 * (1.0 - beta).powi(2), largest, 1e-12);
                tally.equal((1.0 - beta).powi(3) / 3.0, mean, 1e-6);
                // As printed, the next β, which is larger, would serve less.
                let wider = WIDTHS.iter().find(|(next, _)| *next > beta);
                tally.counterexample(wider.is_some_and(|(next, _)| equal_curvature(*next)[0] > width));
            }
        });
        for (beta, _) in WIDTHS {
            widths.row(format!("{beta}"), equal_curvature(beta).map(Number::new));
        }
        let mut columns = vec!["κ".to_owned()];
        columns.extend(BETAS.map(|beta| format!("β = {beta}")));
        columns.extend([0.9, 0.95, 1.0].map(|beta| format!("seeds where {beta} is best")));
        columns.push("best β for the mean gap, median".to_owned());
        let mut table =
            Table::new("General Hessians in 10 dimensions: median of the largest gap over μ", &[]);
        table.columns = columns;
        let mut series = Vec::new();
        for (condition, known, bests, for_mean) in MEDIANS {
            let measured = setup.each(&format!("T11 {condition}"), SEEDS, |_, rng, tally| {
                let quadratics = Quadratics::draw(rng, DIMENSION, condition);
                let gaps = BETAS.map(|beta| {
                    let gap = |k: usize| {
                        let mu = k as f64 / PREFERENCES as f64;
                        Some(quadratics.segment(Preference { mu, beta }, None)?.direct[1])
                    };
                    (0..=PREFERENCES).map(gap).collect::<Option<Vec<f64>>>().unwrap_or_default()
                });
                let largest = gaps.each_ref().map(|gaps| gaps.iter().copied().fold(0.0, f64::max));
                let mean = gaps.each_ref().map(|gaps| statistics::mean(gaps).unwrap_or(f64::NAN));
                tally.holds(mean.iter().all(|gap| gap.is_finite()));
                let smallest =
                    |gaps: &[f64]| (0..BETAS.len()).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b])).unwrap_or(0);
                let best = smallest(&largest);
                tally.sample("best for the mean", BETAS[smallest(&mean)]);
                for (k, (beta, gap)) in BETAS.iter().zip(largest).enumerate() {
                    tally.sample(format!("{beta}"), gap);
                    tally.sample(format!("{beta} is best"), f64::from(u8::from(k == best)));
                }
            });
            let median =
                |beta: f64| Number::median(measured.samples(&format!("{beta}")), setup.scaled(SEEDS));
            let beside = |(beta, known): (&f64, f64)| {
                let agreement = if known == 0.0 { Distance(ROUNDING) } else { Factor(2.5) };
                median(*beta).beside(known, agreement)
            };
            let numbers = BETAS.iter().zip(known).map(beside);
            let count = |(beta, known): (f64, f64)| {
                let sum = measured.samples(&format!("{beta} is best")).iter().sum();
                Number::new(sum).beside_another(known)
            };
            let [best] = Number::quantiles(measured.samples("best for the mean"), [0.5]);
            let best_for_mean = best.beside(for_mean, Distance(0.1));
            table.row(
                format!("{condition}"),
                numbers.chain([0.9, 0.95, 1.0].into_iter().zip(bests).map(count)).chain([best_for_mean]),
            );
            // What rounding leaves of a gap of 0 has no place on a logarithmic axis.
            let points = BETAS
                .map(|beta| [beta, median(beta).value])
                .into_iter()
                .filter(|[_, gap]| *gap > ROUNDING)
                .collect();
            series.push(Series::line(format!("κ = {condition}"), points));
            tally = tally.and(measured);
        }
        let figure = Figure::new(
            "The largest gap over μ for each β: an inner β is best only where Hessians differ",
            ["β", "median of the largest gap"],
            series,
        );
        tally.report(vec![widths, table], vec![figure.logarithmic([false, true])])
    }
}
