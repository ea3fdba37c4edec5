//! `sage bench prediction`: prediction errors of priors and of constant velocity.

use std::io::Write;

use anyhow::Result;
use sage_core::statistics::Estimate;

use crate::{
    Outcome, Registries,
    bench::prediction::{self, Predictor, Report},
    cli::PredictionArgs,
    networks,
    progress::Progress,
    scenes::Scenes,
    terminal,
};

pub(crate) fn run(args: &PredictionArgs, registries: &Registries) -> Result<Outcome> {
    let weights = args.weights.iter().map(|name| networks::load(&registries.backbones, name));
    let weights = weights.collect::<Result<Vec<_>>>()?;
    let scenes = Scenes::under(&args.paths)?;
    let mut predictors = vec![Predictor::ConstantVelocity];
    for loaded in &weights {
        for radius in &args.radius {
            let name = match args.radius.len() {
                1 => loaded.name.clone(),
                _ => format!("{}, {radius} m", loaded.name),
            };
            predictors.push(Predictor::Prior { name, network: &*loaded.network, radius: *radius });
        }
    }
    let mut progress = Progress::new("measured", scenes.len());
    let report = prediction::run(&scenes, &predictors, || progress.step())?;
    progress.finish(&format!("{} predictors on {} scenes", predictors.len(), scenes.len()));
    if args.json { json(&report) } else { table(&report) }?;
    Ok(scenes.outcome())
}

fn json(report: &Report) -> Result<()> {
    let mut out = std::io::stdout().lock();
    for row in &report.rows {
        terminal::json_line(&mut out, row)?;
    }
    for row in &report.quality {
        terminal::json_line(&mut out, row)?;
    }
    Ok(())
}

fn table(report: &Report) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let metres = |e: &Estimate| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high);
    let share = |e: &Estimate| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high);
    writeln!(out, "| predictor | agents | motion | N | K | minADE m | minFDE m | miss 2 m | miss WOMD |")?;
    writeln!(out, "| --- | --- | --- | --- | --- | --- | --- | --- | --- |")?;
    for row in &report.rows {
        writeln!(
            out,
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            terminal::escaped_name(&row.method),
            row.agents,
            row.motion,
            row.min_fde.n,
            row.k,
            metres(&row.min_ade),
            metres(&row.min_fde),
            share(&row.miss),
            share(&row.miss_womd)
        )?;
    }
    if report.quality.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "\n| predictor | ends of 6 on lanes | top 32: median P_kin | top 32 feasible | random 32 feasible |"
    )?;
    writeln!(out, "| --- | --- | --- | --- | --- |")?;
    for row in &report.quality {
        writeln!(
            out,
            "| {} | {} | {} | {} | {} |",
            terminal::escaped_name(&row.method),
            share(&row.ends_on_lanes),
            row.median_kinematic.map_or("-".to_owned(), |p| format!("{p:.3}")),
            row.feasible.as_ref().map_or("-".to_owned(), share),
            row.feasible_random.as_ref().map_or("-".to_owned(), share)
        )?;
    }
    Ok(())
}
