//! `sage bench mixtures`: attack rate, P_real and lane distance over the mixtures of three experts.

use std::{fmt::Write as _, sync::Arc};

use anyhow::{Context as _, Result, bail, ensure};
use sage_backbones::{
    MotionModel,
    training::{Measures, PreparedScene},
};
use sage_core::{
    objective::{FurtherMeasures, Objective, ObjectiveSpec},
    scene::SceneData,
    seed::Rng,
    statistics,
};
use sage_merging::Merger;
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::{
        open_loop::{MeasuredScene, SceneRow, is_attack},
        triangle::{self, Triangle},
    },
    cli::MixturesArgs,
    generators::{self, BuiltGenerator},
    networks,
    operating_point::OperatingPointSpec,
    output::{self, Folder},
    part::Part,
    progress::{self, Progress},
    scenes::Scenes,
    selection::Selection,
};

/// Values at one mixture: attack (rate or probability), P_real, lane distance in metres.
type Values = [f64; 3];
const TITLES: [&str; 3] = ["attack rate, %", "P_real", "lane distance, m"];
/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// Values of one scene at every mixture, with selection and without.
type OfScene = [Vec<Values>; 2];

pub(crate) fn run(args: &MixturesArgs, registries: &Registries) -> Result<Outcome> {
    let [first, second, third] = &args.experts[..] else {
        bail!("--experts names {} experts; a triangle has three corners", args.experts.len());
    };
    let names = [&**first, &**second, &**third];
    if let Some(k) = (1..3).find(|&k| names[..k].contains(&names[k])) {
        bail!("`{}` is given twice in --experts", names[k]);
    }
    let selection = Selection::of(registries, &args.on.selection, args.on.rule.feasibility.as_ref())?;
    let merger: Arc<dyn Merger> = args.merging.merger.build(&registries.mergers)?.into();
    ensure!(
        merger.keeps_modes(),
        "`{}` changes the modes, so there are no expectations without selection",
        args.merging.merger
    );
    let experts = networks::load_experts(&registries.backbones, &args.on.weights)?;
    let mixtures = triangle::mixtures(args.steps);
    let (mut points, mut models) = (Vec::new(), Vec::<Arc<dyn MotionModel>>::new());
    for weights in &mixtures {
        let named: Vec<(String, f64)> = names.iter().map(|name| (*name).to_owned()).zip(*weights).collect();
        let mixture = experts.mixture(&names.into_iter().zip(*weights).collect::<Vec<_>>())?;
        models.push(merger.merge(&experts, &mixture, args.on.seed)?);
        points.push(OperatingPointSpec::mixed(&named, args.mu)?);
    }
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.on.seed);
    let sage = Part { name: "sage".to_owned(), options: serde_json::Map::new() };
    let built = BuiltGenerator::new(&sage, registries, &inputs, &points)?;
    let lanes = lane_distance(registries)?;
    let measures = Measures::of(&[&lanes], &registries.rewards, &registries.feasibilities)?;
    let lane_distance = measures.expert(&lanes)?;
    let out = Folder::make(&args.on.folder.out, args.on.folder.force)?;
    let scenes = Scenes::of(&args.on.paths, &args.on.split, 0, args.on.seed)?.attackable()?;
    let further = FurtherMeasures::default();
    let one = |data: &SceneData| -> Result<OfScene> {
        let prior = &**experts.prior();
        let rows = MeasuredScene::new(data, prior, &further)?.rows(&built, args.on.seed)?;
        let prepared = PreparedScene::new(prior, data, false, &measures)?.context("it was attackable")?;
        let free = models.iter().map(|model| -> Result<Values> {
            let expected = prepared.expectation(&**model)?;
            let lanes = prepared.expected_value(&**model, &lane_distance)?;
            Ok([100.0 * expected.attack, expected.penalty, lanes])
        });
        Ok([rows.iter().map(of_row).collect(), free.collect::<Result<_>>()?])
    };
    let mut progress = Progress::new("evaluated", scenes.len());
    let all = scenes.map(one, || progress.step())?;
    progress.finish(&format!("{} mixtures", mixtures.len()));
    for (k, (kind, file)) in
        [("with selection", "triangle.svg"), ("without selection", "triangle-policy.svg")]
            .into_iter()
            .enumerate()
    {
        let value = |of: usize| -> Vec<f64> {
            let mean = |at: usize| mean(all.iter().map(|scene| scene[k][at][of]));
            (0..mixtures.len()).map(mean).collect()
        };
        let titles = TITLES.map(|title| format!("{title} ({kind})"));
        let triangles: Vec<Triangle> =
            titles.iter().enumerate().map(|(of, title)| Triangle { title, values: value(of) }).collect();
        out.write(file, triangle::draw(names, args.steps, &triangles)?.as_bytes())?;
    }
    let markdown = table(names, &mixtures, &all)?;
    out.write("table.md", markdown.as_bytes())?;
    out.write("mixtures.csv", csv(names, &mixtures, &all)?.as_bytes())?;
    let record = json!({
        "command": output::command(), "experts": names, "merger": args.merging.merger.to_string(),
        "weights": args.on.weights, "mu": args.mu, "selection": selection.objective.spec(), "seed": args.on.seed,
        "scenes": scenes.describe(), "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "table.md, mixtures.csv, run.json and pictures are in `{}`",
        args.on.folder.out.display()
    ));
    Ok(scenes.outcome())
}

/// Mean lane distance over the whole trajectory as an objective, under the paper's rule as in the tables.
fn lane_distance(registries: &Registries) -> Result<Objective> {
    let spec: ObjectiveSpec = serde_json::from_value(
        json!({"terms": [{"name": "lane-distance", "weight": 1.0, "options": {"phase": "whole"}}]}),
    )?;
    Ok(Objective::new(&spec, &registries.rewards, &registries.feasibilities)?)
}

fn of_row(row: &SceneRow) -> Values {
    let penalty = row.paper.kinematic_penalty + row.paper.behavior_penalty;
    [100.0 * f64::from(u8::from(is_attack(row))), penalty, row.natural.lane_distance]
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len();
    values.sum::<f64>() / count as f64
}

/// Corners, centres of the sides, and the mixture nearest to the centre.
fn table(names: [&str; 3], mixtures: &[[f64; 3]], all: &[OfScene]) -> Result<String> {
    let mut out = format!(
        "Mixtures of three experts on {} scenes.\n\n| {} | {} |\n|{}\n",
        all.len(),
        names.join(" | "),
        TITLES.map(|title| format!("{title} | without selection")).join(" | "),
        " --- |".repeat(names.len() + 2 * TITLES.len()),
    );
    let gap = |at: &[f64; 3]| at.iter().map(|w| (w - 1.0 / 3.0).powi(2)).sum::<f64>();
    let centre = mixtures.iter().enumerate().min_by(|a, b| gap(a.1).total_cmp(&gap(b.1))).map(|(k, _)| k);
    let shown = mixtures.iter().enumerate().filter(|(k, at)| {
        Some(*k) == centre || at.contains(&1.0) || at.iter().filter(|weight| **weight == 0.5).count() == 2
    });
    for (at, weights) in shown {
        let mut cells: Vec<String> = weights.iter().map(|weight| format!("{weight:.3}")).collect();
        for of in 0..TITLES.len() {
            for kind in 0..2 {
                let values: Vec<f64> = all.iter().map(|scene| scene[kind][at][of]).collect();
                let mut rng = Rng::new(0, TITLES[of], "mixtures");
                let estimate = statistics::bootstrap_mean(&values, RESAMPLES, &mut rng);
                cells.push(
                    estimate
                        .map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high)),
                );
            }
        }
        writeln!(out, "| {} |", cells.join(" | "))?;
    }
    out += "\nThe first three columns are weights of the experts. *Attack rate*: share of scenes with a feasible hit; \
        without selection its probability under the policy. *Lane distance*: mean distance to the nearest lane in \
        the direction of motion. Brackets: 95 % intervals, bootstrap over scenes.\n";
    Ok(out)
}

fn csv(names: [&str; 3], mixtures: &[[f64; 3]], all: &[OfScene]) -> Result<String> {
    let mut out = format!("{},selection,attack,penalty,lane_distance\n", names.join(","));
    for (at, [a, b, c]) in mixtures.iter().enumerate() {
        for (kind, selected) in ["yes", "no"].into_iter().enumerate() {
            let value = |of: usize| mean(all.iter().map(|scene| scene[kind][at][of]));
            writeln!(out, "{a},{b},{c},{selected},{},{},{}", value(0), value(1), value(2))?;
        }
    }
    Ok(out)
}
