//! `sage calibrate`: fits the aggression dial of a set of experts, so that the rate of
//! attacks rises linearly; or the temperature of a prior.

mod attack_grid;
mod nominal;

use std::{collections::HashSet, sync::Arc};

use advsage::{Registries, generators::Generators, selection::Selection};
use anyhow::{Context as _, Result, ensure};
use sage_bench::curve::Linearity;
use sage_core::objective::PartSpec;
use sage_generators::{DIAL_FILE, Dials, FittedDial, GeneratorInputs, Rate, hashes};
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

/// Number of λ from which a dial of λ is fitted.
const LAMBDAS: usize = 41;
/// The generators whose candidates are selected in a fit.
const SAGE: &str = "sage";
const SAGE_DRAWN: &str = "sage-drawn";

/// Values of λ from 0 to 1, evenly spaced.
fn fine() -> Vec<f64> {
    (0..LAMBDAS).map(|k| k as f64 / (LAMBDAS - 1) as f64).collect()
}

/// Evenly spaced values from 0 to 1.
pub(crate) fn aggressions() -> Vec<f64> {
    (0..AGGRESSIONS).map(|k| k as f64 / (AGGRESSIONS - 1) as f64).collect()
}

pub(crate) fn run(args: &CalibrateArgs, registries: &Registries) -> Result<Outcome> {
    if args.nominal {
        return nominal::run(args, registries);
    }
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
    let mut progress = Progress::new("evaluated", scenes.len() * selections.len());
    let all = aggressions();
    let generators = generators.with_experts(&experts);
    for selection in &selections {
        let grid = grid_of(selection, &scenes, registries, generators.inputs(), &mut progress)?;
        let spec = selection.objective.spec();
        let by_rule =
            if spec.feasibility.name == PartSpec::default().name { Rate::Attack } else { Rate::Believable };
        let rate = args.attack_rate.map_or(by_rule, Rate::from);
        let mu = grid.fit(rate, AGGRESSIONS)?;
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
        let generator = if spec.depends_on_mu() { SAGE } else { SAGE_DRAWN }.to_owned();
        let fitted = FittedDial {
            mu,
            generator,
            experts: hashes(&experts)?,
            merger: args.merging.merger.to_string(),
            objective: spec.clone(),
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

/// The attacks that a selection takes at many operating points.
///
/// *Errors*: the first scene that fails.
fn grid_of(
    selection: &Selection,
    scenes: &Scenes,
    registries: &Registries,
    inputs: &GeneratorInputs,
    progress: &mut Progress,
) -> Result<AttackGrid> {
    let objective = &selection.objective;
    // Where λ alone steers, more of its values are tried, and few candidates let it.
    let (name, lambdas) = match objective.spec().depends_on_mu() {
        true => (SAGE, aggressions()),
        false => (SAGE_DRAWN, fine()),
    };
    let generator = registries.generators.build_default(name)?;
    let inputs = GeneratorInputs { selection: Arc::new(objective.clone()), ..inputs.clone() };
    AttackGrid::of(scenes, &*generator, &inputs, lambdas, || progress.step())
}
