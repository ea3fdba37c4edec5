//! `sage bench experts`: compares two variants of fine-tuning, several seeds each, paired by scene.

use std::{fmt::Write as _, path::Path, sync::Arc};

use anyhow::{Context as _, Result, bail};
use sage_backbones::training::{Expectation, Measures};
use sage_core::{
    files,
    scene::SceneData,
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_merging::Merger;

use crate::{
    Outcome, Registries,
    bench::{attack_grid::AttackGrid, open_loop},
    cli::ExpertsArgs,
    generators, networks, output,
    progress::Progress,
    scenes::Scenes,
    selection::Selection,
};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// Measures of the experts, one value per scene. Their names also name the random streams.
const MEASURES: [&str; 8] = [
    "adversarial: feasible",
    "adversarial: feasible hit",
    "adversarial: R_adv",
    "adversarial: P_real",
    "realistic: feasible",
    "realistic: feasible hit",
    "realistic: P_real",
    "best of 32 at lambda 1: attack",
];

/// Values of each measure, by scene.
type Values = Vec<Vec<f64>>;

pub(crate) fn run(args: &ExpertsArgs, registries: &Registries) -> Result<Outcome> {
    // Fails on a missing folder before anything is measured.
    for folder in args.a.iter().chain(&args.b) {
        networks::load_experts(&registries.backbones, folder)?;
    }
    let mut scenes = Scenes::of(&args.paths, &args.split, 0, args.seed)?.attackable()?;
    let mut progress = Progress::new("measured", args.a.len() + args.b.len());
    let (a, b) = loop {
        let before = scenes.failed();
        let mut group = |folders: &[String]| -> Result<Values> {
            let mut all = Vec::new();
            for folder in folders {
                all.push(values(registries, folder, &scenes, args)?);
                progress.step();
            }
            Ok(mean_over_folders(&all))
        };
        let both = (group(&args.a)?, group(&args.b)?);
        if scenes.failed() == before {
            break both;
        }
        // The groups are paired by scene, so a scene that failed with some experts is left out for all.
        scenes = scenes.without_failed();
    };
    progress.finish(&format!("{} folders on {} scenes", args.a.len() + args.b.len(), scenes.len()));
    let mut out = format!(
        "A: {}; B: {}. Means over seeds, {} scenes, paired by scene; intervals are over scenes, for these seeds.\n\n| measure | A | B | A − B | scenes larger in A | in B |\n| --- | --- | --- | --- | --- | --- |\n",
        args.a.join(", "),
        args.b.join(", "),
        scenes.len()
    );
    for ((name, a), b) in MEASURES.iter().zip(&a).zip(&b) {
        let gaps: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
        let larger = |sign: f64| gaps.iter().filter(|gap| sign * **gap > 1e-9).count();
        let cells = [a, b, &gaps].map(|values| cell(values, name));
        writeln!(out, "| {name} | {} | {} | {} |", cells.join(" | "), larger(1.0), larger(-1.0))?;
    }
    learning(&mut out, args)?;
    output::print(&out)?;
    Ok(scenes.outcome())
}

/// All measures of the experts in a folder.
fn values(registries: &Registries, folder: &str, scenes: &Scenes, args: &ExpertsArgs) -> Result<Values> {
    let experts = networks::load_experts(&registries.backbones, folder)?;
    let merger: Arc<dyn Merger> = args.merging.merger.build(&registries.mergers)?.into();
    let model = |lambda| merger.merge(&experts, &experts.between(lambda)?, args.seed);
    let policies = [model(1.0)?, model(0.0)?];
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let expectations = |data: &SceneData| -> Result<Option<Vec<Expectation>>> {
        open_loop::expectations(data, &**experts.prior(), &policies, &measures)
    };
    let (adversarial, realistic): (Vec<_>, Vec<_>) =
        scenes.map(expectations, || ())?.into_iter().flatten().map(|both| (both[0], both[1])).unzip();
    let of = |all: &[Expectation], value: fn(&Expectation) -> f64| all.iter().map(value).collect();
    let selection = Selection::of(registries, "paper-selection", None)?;
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.seed);
    let objectives = [inputs.selection.clone()];
    let grid = AttackGrid::of(scenes, &inputs, &objectives, &[1.0], args.seed, || ())?.pop();
    let grid = grid.context("one objective gives one grid")?;
    let attacks = grid.attacks(1.0, 1.0).context("lambda 1 was not evaluated")?;
    Ok(vec![
        of(&adversarial, |e| e.feasible),
        of(&adversarial, |e| e.attack),
        of(&adversarial, |e| e.reward),
        of(&adversarial, |e| e.penalty),
        of(&realistic, |e| e.feasible),
        of(&realistic, |e| e.attack),
        of(&realistic, |e| e.penalty),
        attacks.hits,
    ])
}

fn mean_over_folders(all: &[Values]) -> Values {
    let mean = |measure: usize, scene: usize| {
        all.iter().map(|values| values[measure][scene]).sum::<f64>() / all.len() as f64
    };
    (0..MEASURES.len()).map(|m| (0..all[0][m].len()).map(|s| mean(m, s)).collect()).collect()
}

fn cell(values: &[f64], name: &str) -> String {
    let estimate: Option<Estimate> =
        statistics::bootstrap_mean(values, RESAMPLES, &mut Rng::new(0, name, "experts"));
    estimate.map_or("-".to_owned(), |e| format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high))
}

/// Size limit of `finetune.csv`, bytes.
const CURVE_LIMIT: u64 = 64 << 20;
/// Columns of `finetune.csv` in the training curves of the adversarial expert.
const LEARNING: [&str; 5] =
    ["pairs", "pairs_by_feasibility", "expected_feasible", "expected_attack", "expected_reward"];

/// Training curves of the adversarial experts from `finetune.csv`, means over seeds.
fn learning(out: &mut String, args: &ExpertsArgs) -> Result<()> {
    writeln!(out, "\nTraining curves of the adversarial expert, on its training scenes:\n")?;
    writeln!(
        out,
        "| | epoch | {} |\n| --- | --- |{}",
        LEARNING.join(" | "),
        " --- |".repeat(LEARNING.len())
    )?;
    for (name, folders) in [("A", &args.a), ("B", &args.b)] {
        let curves = folders.iter().map(|folder| curve(Path::new(folder))).collect::<Result<Vec<_>>>()?;
        let curves: Vec<_> = curves.into_iter().filter(|curve| !curve.is_empty()).collect();
        if curves.len() < folders.len() {
            writeln!(
                out,
                "| {name} | {} of {} folders have curves | | | | | |",
                curves.len(),
                folders.len()
            )?;
        }
        for epoch in 0..curves.iter().map(Vec::len).min().unwrap_or(0) {
            let mean = |k: usize| curves.iter().map(|c| c[epoch][k]).sum::<f64>() / curves.len() as f64;
            let cells: Vec<String> = (0..LEARNING.len()).map(|k| format!("{:.3}", mean(k))).collect();
            writeln!(out, "| {name} | {} | {} |", epoch + 1, cells.join(" | "))?;
        }
    }
    Ok(())
}

/// Rows of the adversarial expert in `finetune.csv`, with the columns of [`LEARNING`]; none without the file.
fn curve(folder: &Path) -> Result<Vec<Vec<f64>>> {
    let file = folder.join("finetune.csv");
    let Ok(text) = files::read_text(&file, CURVE_LIMIT) else { return Ok(Vec::new()) };
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &&str| head.iter().position(|known| known == name);
    let Some(columns) = LEARNING.iter().map(column).collect::<Option<Vec<_>>>() else {
        bail!("`{}` has no columns {}", file.display(), LEARNING.join(", "));
    };
    let row = |line: &str| -> Result<Vec<f64>> {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |&k: &usize| cells.get(k).and_then(|cell| cell.parse().ok());
        let numbers: Option<Vec<f64>> = columns.iter().map(number).collect();
        numbers.with_context(|| format!("`{}`: row `{line}` does not match the header", file.display()))
    };
    lines.filter(|line| line.starts_with("adversarial,")).map(row).collect()
}
