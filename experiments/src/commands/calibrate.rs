//! `sage calibrate`: fits the aggression dial of a set of experts, so that the rate of
//! attacks rises linearly.

mod attack_grid;

use std::{collections::HashSet, sync::Arc};

use advsage::{Registries, generators::Generators, selection::Selection};
use anyhow::{Context as _, Result, ensure};
use sage_bench::curve::Linearity;
use sage_core::objective::PartSpec;
use sage_generators::{DIAL_FILE, Dials, FittedDial, Rate, hashes};
use sage_run::{
    Outcome, networks,
    output::{self, OutputFile},
    progress::{self, Progress},
    scenes::Scenes,
};

use self::attack_grid::AttackGrid;
use crate::cli::CalibrateArgs;

/// Number of aggressions at which a dial is evaluated.
const AGGRESSIONS: usize = 11;

/// Evenly spaced values from 0 to 1.
pub(crate) fn aggressions() -> Vec<f64> {
    (0..AGGRESSIONS).map(|k| k as f64 / (AGGRESSIONS - 1) as f64).collect()
}

pub(crate) fn run(args: &CalibrateArgs, registries: &Registries) -> Result<Outcome> {
    let out = OutputFile::claim(&args.out, args.force)?;
    let rule = args.rule.feasibility.as_ref();
    let selections = args.selection.iter().map(|name| Selection::of(registries, name, rule));
    let selections = selections.collect::<advsage::Result<Vec<_>>>()?;
    let names: HashSet<&str> = selections.iter().map(|selection| &selection.name[..]).collect();
    ensure!(names.len() == selections.len(), "a selection is named twice");
    let generators = Generators::new(registries, &args.merging.merger, &selections[0], args.seed)?;
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    let scenes = Scenes::of(&args.paths, &args.split.filter(), args.procedural, args.seed)?.attackable()?;
    let mut dials = Dials::default();
    let mut progress = Progress::new("evaluated", scenes.len());
    let all = aggressions();
    let generators = generators.with_experts(&experts);
    let objectives: Vec<_> = selections.iter().map(|s| Arc::new(s.objective.clone())).collect();
    let step = || progress.step();
    let grids = AttackGrid::of(&scenes, generators.inputs(), &objectives, &all, args.seed, step)?;
    for (selection, grid) in selections.iter().zip(grids) {
        let is_papers = selection.objective.spec().feasibility.name == PartSpec::default().name;
        let by_rule = if is_papers { Rate::Attack } else { Rate::Believable };
        let rate = args.rate.map_or(by_rule, Rate::from);
        let mu = grid.fit(rate)?;
        let at = |a: &f64| -> Result<_> {
            let (lambda, mu) = mu.lambda_and_mu(*a)?;
            grid.attacks(lambda, mu).context("an aggression was not evaluated")
        };
        let attacks = all.iter().map(at).collect::<Result<Vec<_>>>()?;
        let linearity = Linearity::of(&all, &attacks.iter().map(|a| a.rate(rate)).collect::<Vec<_>>());
        progress.say(&format!(
            "selection {}: {} rate {:.0} % to {:.0} %, deviation from a straight line {:.1} points RMS, {:.1} points at most",
            selection.name,
            rate.name(),
            100.0 * attacks[0].rate(rate),
            100.0 * attacks[attacks.len() - 1].rate(rate),
            100.0 * linearity.rms,
            100.0 * linearity.worst,
        ));
        if attacks[attacks.len() - 1].rate(rate) <= attacks[0].rate(rate) {
            progress
                .say("warning: the rate does not rise between aggression 0 and 1, so the dial has no effect");
        }
        let fitted = FittedDial {
            mu,
            experts: hashes(&experts)?,
            merger: args.merging.merger.to_string(),
            objective: selection.objective.spec().clone(),
            rate,
            rates: attacks.iter().map(|a| (a.rate(rate) * 1e4).round() / 1e4).collect(),
            data: scenes.describe(),
            command: output::command(),
        };
        dials.0.insert(selection.name.clone(), fitted);
    }
    progress.finish(&format!("{} selections on {} scenes", selections.len(), scenes.len()));
    let text = serde_json::to_string_pretty(&dials)? + "\n";
    out.write(text.as_bytes())?;
    progress::say(&format!(
        "the dial is in `{}`; `--aggression` reads it as `{DIAL_FILE}` in the folder of the experts",
        args.out.display()
    ));
    Ok(scenes.outcome())
}
