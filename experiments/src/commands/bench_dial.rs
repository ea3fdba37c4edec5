//! `sage bench dial`: rates of attacks along the aggression dial, and the shares of λ and μ.

use std::{fmt::Write as _, sync::Arc};

use anyhow::{Context as _, Result};
use sage_core::statistics;
use sage_generators::Rate;

use sage_merging::Merger;
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::{
        attack_grid::{AttackGrid, Attacks, Linearity, shapley_of_lambda},
        line_chart::{Chart, Line},
    },
    cli::DialBenchArgs,
    commands::calibrate::aggressions,
    generators, networks,
    output::{self, Folder},
    progress::{self, Progress},
    scenes::Scenes,
    selection::Selection,
};

/// Values of λ and of μ in the table of both.
const LAMBDAS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
const MUS: [f64; 8] = [0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0];

/// A sweep of operating points from 0 to 1.
struct Sweep {
    name: &'static str,
    /// λ, μ and the attacks at each operating point.
    points: Vec<(f64, f64, Attacks)>,
}

impl Sweep {
    /// Rates in percent over the aggression.
    fn line(&self, rate: Rate) -> Line {
        let points = aggressions().into_iter().zip(&self.points);
        (self.name.to_owned(), points.map(|(a, (.., attacks))| [a, 100.0 * attacks.rate(rate)]).collect())
    }
}

pub(crate) fn run(args: &DialBenchArgs, registries: &Registries) -> Result<Outcome> {
    let selection = Selection::of(registries, &args.on.selection, args.on.rule.feasibility.as_ref())?;
    let merger: Arc<dyn Merger> = args.merging.merger.build(&registries.mergers)?.into();
    let experts = networks::load_experts(&registries.backbones, &args.on.weights)?;
    let merger_name = args.merging.merger.to_string();
    let fitted = networks::find_dial(&args.on.weights, &experts, &selection)?;
    let dial = networks::load_dial(&args.on.weights, &experts, &selection, &merger_name)?;
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.on.seed);
    let out = Folder::make(&args.on.folder.out, args.on.folder.force)?;
    let scenes = Scenes::of(&args.on.paths, &args.on.split, 0, args.on.seed)?.attackable()?;
    let mut lambdas = aggressions();
    lambdas.extend(LAMBDAS.into_iter().filter(|l| !aggressions().iter().any(|p| (p - l).abs() < 1e-9)));
    let mut progress = Progress::new("evaluated", scenes.len());
    let step = || progress.step();
    let objectives = [inputs.selection.clone()];
    let mut grid = AttackGrid::of(&scenes, &inputs, &objectives, &lambdas, args.on.seed, step)?;
    let grid = grid.pop().context("one objective gives one grid")?;
    progress.finish(&format!("{} values of lambda on {} scenes", lambdas.len(), scenes.len()));
    let attacks = |lambda: f64, mu: f64| grid.attacks(lambda, mu).context("a lambda was not evaluated");
    let points = |lambda_and_mu: &dyn Fn(f64) -> Result<(f64, f64)>| -> Result<Vec<_>> {
        let point = |a: f64| {
            let (lambda, mu) = lambda_and_mu(a)?;
            Ok((lambda, mu, attacks(lambda, mu)?))
        };
        aggressions().into_iter().map(point).collect()
    };
    let of_dial = |a: f64| Ok(dial.lambda_and_mu(a)?);
    let sweeps = [
        Sweep { name: "aggression", points: points(&of_dial)? },
        Sweep { name: "lambda = mu", points: points(&|a| Ok((a, a)))? },
    ];
    let mut markdown = format!("Selection {}, {} scenes.\n\n", selection.name, scenes.len());
    let mut csv = "sweep,a,lambda,mu,measure,value,low,high,n\n".to_owned();
    curves(&mut markdown, &mut csv, &sweeps, fitted.rate)?;
    let rate = |l: f64, m: f64| grid.attacks(l, m).map_or(f64::NAN, |a| a.rate(fitted.rate));
    let reward = |l: f64, m: f64| grid.attacks(l, m).map_or(f64::NAN, |a| a.reward());
    table_of_both(&mut markdown, fitted.rate.name(), &rate, &reward)?;
    let lines: Vec<Line> = sweeps.iter().map(|sweep| sweep.line(fitted.rate)).collect();
    let file = |name: &str, text: &str| out.write(name, text.as_bytes());
    file("dial.md", &markdown)?;
    file("dial.csv", &csv)?;
    file("dial.svg", &chart(fitted.rate, lines)?)?;
    let record = json!({
        "command": output::command(), "scenes": scenes.len(), "data": scenes.describe(),
        "seed": args.on.seed, "selection": selection.objective.spec(), "merger": merger_name, "version": env!("CARGO_PKG_VERSION"),
    });
    file("run.json", &format!("{record:#}\n"))?;
    output::print(&markdown)?;
    progress::say(&format!(
        "dial.md, dial.csv, dial.svg and run.json are in `{}`",
        args.on.folder.out.display()
    ));
    Ok(scenes.outcome())
}

/// Rates over the aggression, and a straight line between the ends of the first sweep.
fn chart(rate: Rate, lines: Vec<Line>) -> Result<String> {
    let shown = match rate {
        Rate::Attack => "scenes attacked, %",
        Rate::Believable => "scenes attacked believably, %",
    };
    let ends = lines.first().map(|(_, points)| &points[..]);
    Chart {
        axes: ["aggression, or lambda = mu", shown],
        ranges: Some([0.0..1.0, 0.0..100.0]),
        dashed: ends.and_then(|points| Some([*points.first()?, *points.last()?])),
        lines,
        ..Chart::default()
    }
    .draw()
}

/// Rates and reward along each sweep, and the deviation from a straight line.
fn curves(markdown: &mut String, csv: &mut String, sweeps: &[Sweep], rate: Rate) -> Result<()> {
    for sweep in sweeps {
        writeln!(
            markdown,
            "| {} | lambda | mu | attack | believable | R_adv |\n| --- | --- | --- | --- | --- | --- |",
            sweep.name
        )?;
        for (a, (lambda, mu, attacks)) in aggressions().into_iter().zip(&sweep.points) {
            let measures = [
                ("attack", attacks.rate_estimate(Rate::Attack)),
                ("believable", attacks.rate_estimate(Rate::Believable)),
                ("R_adv", attacks.reward_estimate()),
            ];
            let mut cells = Vec::new();
            for (measure, estimate) in measures {
                let Some(e) = estimate else { continue };
                cells.push(format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high));
                writeln!(
                    csv,
                    "{},{a},{lambda},{mu},{measure},{},{},{},{}",
                    sweep.name, e.value, e.low, e.high, e.n
                )?;
            }
            writeln!(markdown, "| {a:.1} | {lambda:.2} | {mu:.4} | {} |", cells.join(" | "))?;
        }
        let attacks: Vec<&Attacks> = sweep.points.iter().map(|(_, _, attacks)| attacks).collect();
        let linearity = Linearity::of(&attacks, rate);
        let order = aggressions();
        let rank = |value: &dyn Fn(&Attacks) -> f64| {
            let values: Vec<f64> = attacks.iter().map(|a| value(a)).collect();
            statistics::rank_correlation(&order, &values)
        };
        writeln!(
            markdown,
            "\n{}, {} rate: deviation from a straight line {:.1} points RMS, {:.1} points at most; largest drop between neighbours {} scenes; span {:.1} points; rank correlation with it {:.3}, with R_adv {:.3}.\n",
            sweep.name,
            rate.name(),
            100.0 * linearity.rms,
            100.0 * linearity.worst,
            linearity.largest_drop,
            100.0 * linearity.span,
            rank(&|attacks| attacks.rate(rate)),
            rank(&Attacks::reward),
        )?;
    }
    Ok(())
}

/// Rate and reward over λ and μ, and the Shapley share of λ.
fn table_of_both(
    markdown: &mut String,
    name: &str,
    rate: &dyn Fn(f64, f64) -> f64,
    reward: &dyn Fn(f64, f64) -> f64,
) -> Result<()> {
    let share = |share: Option<f64>| share.map_or("-".to_owned(), |share| format!("{share:.2}"));
    let head = MUS.map(|mu| format!("mu {mu}")).join(" | ");
    writeln!(
        markdown,
        "Rate ({name}) / R_adv:\n\n| lambda | {head} |\n| --- |{}",
        " --- |".repeat(MUS.len())
    )?;
    for lambda in LAMBDAS {
        let cells = MUS.map(|mu| format!("{:.2} / {:.2}", rate(lambda, mu), reward(lambda, mu)));
        writeln!(markdown, "| {lambda} | {} |", cells.join(" | "))?;
    }
    writeln!(
        markdown,
        "\nShapley share of lambda in the whole span: {} of the {name} rate, {} of R_adv; the rest is due to the selection (mu).",
        share(shapley_of_lambda(rate)),
        share(shapley_of_lambda(reward))
    )?;
    Ok(())
}
