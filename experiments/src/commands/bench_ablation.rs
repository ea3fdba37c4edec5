//! `sage bench ablation`: what each part of the fine-tuning contributes, in the paper's set-up.

use std::{collections::BTreeMap, fmt::Write as _, sync::Arc};

use anyhow::{Context as _, Result, bail};
use sage_backbones::{
    MotionModel,
    training::{Expectation, Measures},
};
use sage_core::generator::Mixture;
use sage_core::{
    files,
    objective::FurtherMeasures,
    scene::SceneData,
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_merging::Merger;
use serde_json::{Value, json};

use super::finetune;
use crate::{
    Outcome, Registries,
    bench::{
        line_chart::{self, Line},
        open_loop::{self, MeasuredScene, SceneRow, is_attack},
    },
    cli::{AblationArgs, FinetuneArgs, FolderArgs},
    generators::{self, BuiltGenerator},
    networks,
    operating_point::OperatingPointSpec,
    output::{self, Folder},
    part::Part,
    progress::{self, Progress},
    scenes::{self, Scenes},
    selection::Selection,
};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;
/// Size limit of the training curves, bytes.
const CURVES_LIMIT: u64 = 16 << 20;
/// The variant that the others are compared with.
const BASE: &str = "hgpo";
/// Folder of the experts, and their config.
const EXPERTS: &str = "experts";
const CONFIG: &str = "ablation.json";

/// A variant of the tuning: name in tables, name of its expert, options that differ.
type Variant = (&'static str, &'static str, fn() -> Value);

/// The paper's table of ablations, its curves, and margins.
const VARIANTS: [Variant; 11] = [
    ("HGPO", BASE, || json!({})),
    ("without map constraint", "no-map", || json!({"pairing": "reward-only"})),
    ("without realism penalty", "no-realism", || json!({"objective": objective(0.9, 0.0, 0.0)})),
    (
        "weighted map penalty instead of the hierarchy",
        "weighted-map",
        || json!({"pairing": "reward-only", "objective": objective(0.9, 0.1, 0.1)}),
    ),
    ("DPO: best over worst", "dpo", || json!({"pairing": "best-worst"})),
    ("margin 0", "margin-0", || json!({"margin": 0.0})),
    ("margin 1", "margin-1", || json!({"margin": 1.0})),
    ("margin 2", "margin-2", || json!({"margin": 2.0})),
    ("one model, weights 3:7", "weights-3-7", || json!({"objective": objective(0.3, 0.7, 0.0)})),
    ("one model, weights 5:5", "weights-5-5", || json!({"objective": objective(0.5, 0.5, 0.0)})),
    ("one model, weights 7:3", "weights-7-3", || json!({"objective": objective(0.7, 0.3, 0.0)})),
];

fn objective(adversarial: f64, realism: f64, violation: f64) -> Value {
    json!({
        "terms": [{"name": "adversarial", "weight": adversarial}, {"name": "realism", "weight": -realism}],
        "violation_weight": violation, "feasibility": {"name": "paper"},
    })
}

/// Columns of the table: those of the paper, then expectations without selection.
type OfRow = (&'static str, fn(&SceneRow) -> Option<f64>);
const COLUMNS: [OfRow; 6] = [
    ("attack %", |r| Some(100.0 * f64::from(u8::from(is_attack(r))))),
    ("R_adv", |r| Some(r.paper.adversarial_reward)),
    ("P_beh", |r| Some(r.paper.behavior_penalty)),
    ("P_kin", |r| Some(r.paper.kinematic_penalty)),
    ("crash-object", |r| Some(r.paper.crash_object)),
    ("cross-line", |r| r.paper.cross_line),
];
type OfPolicy = (&'static str, fn(&Expectation) -> f64);
const FREE: [OfPolicy; 2] =
    [("feasible %", |e| 100.0 * e.feasible), ("feasible hit %", |e| 100.0 * e.attack)];

/// Results of a variant, by scene.
#[derive(Default)]
struct Tuned {
    rows: Vec<SceneRow>,
    free: Vec<Expectation>,
}

pub(crate) fn run(args: &AblationArgs, registries: &Registries) -> Result<Outcome> {
    // The tuning has a record and a lock of its own in the inner folder, by which it resumes.
    let out = Folder::make(&args.folder.out, true)?;
    let config = config(args)?;
    out.write(CONFIG, format!("{config:#}\n").as_bytes())?;
    let experts = args.folder.out.join(EXPERTS);
    let tuning = FinetuneArgs {
        paths: args.paths.clone(),
        split: args.split.clone(),
        dev: None,
        procedural: args.procedural,
        prior: args.prior.clone(),
        roles: args.roles,
        edges: args.edges,
        config: Some(args.folder.out.join(CONFIG)),
        seed: args.seed,
        folder: FolderArgs { out: experts.clone(), force: args.folder.force },
    };
    let tuning = finetune::run(&tuning, registries)?;
    let (tuned, failed) = measure(args, registries, &experts.display().to_string())?;
    let markdown = table(&tuned, args.seed)?;
    out.write("table.md", markdown.as_bytes())?;
    let curves = files::read_text(&experts.join("finetune.csv"), CURVES_LIMIT)?;
    charts(&out, &curves)?;
    let record = json!({
        "command": output::command(), "variants": VARIANTS.map(|(name, ..)| name), "prior": args.prior,
        "seed": args.seed, "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!("table.md, charts and the experts are in `{}`", args.folder.out.display()));
    Ok(if tuning == Outcome::Done { scenes::outcome_without(failed) } else { tuning })
}

/// The options of all experts: those of the paper's preset, and what each variant changes.
fn config(args: &AblationArgs) -> Result<Value> {
    let mut config = json!({
        "margin": 0.2, "max_pairs": 64, "candidates": 64, "selection": {"nms": {"radius": 3.0}}, "kl_beta": 0.1,
        "epochs": args.epochs, "objective": "paper-adversarial",
    });
    let experts = VARIANTS.iter().map(|(_, expert, options)| ((*expert).to_owned(), options()));
    config["experts"] = Value::Object(experts.collect());
    Ok(config)
}

/// All variants on the evaluation scenes: the selection of the largest reward, and expectations without selection. Also
/// how many scenes failed.
fn measure(args: &AblationArgs, registries: &Registries, folder: &str) -> Result<(Vec<Tuned>, usize)> {
    let selection = Selection::of(registries, "paper-selection", None)?;
    let experts = networks::load_experts(&registries.backbones, folder)?;
    let merger: Arc<dyn Merger> = registries.mergers.build_default("linear")?.into();
    let inputs = generators::inputs(Some(&experts), &merger, &selection, args.seed);
    let sage = Part { name: "sage".to_owned(), options: serde_json::Map::new() };
    let points =
        VARIANTS.map(|(_, expert, _)| OperatingPointSpec::mixed(&[(expert.to_owned(), 1.0)], Some(1.0)));
    let points = points.into_iter().collect::<Result<Vec<_>>>()?;
    let built = BuiltGenerator::new(&sage, registries, &inputs, &points)?;
    let models: Vec<Arc<dyn MotionModel>> = points
        .iter()
        .map(|point| {
            let mixture: Mixture = point.point(Some(&experts))?.mixture;
            Ok(merger.merge(&experts, &mixture, args.seed)?)
        })
        .collect::<Result<_>>()?;
    let scenes =
        Scenes::of(&args.eval, &args.split_of_eval(), args.procedural, args.seed + 1)?.attackable()?;
    let (further, prior) = (FurtherMeasures::default(), &**experts.prior());
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let one = |data: &SceneData| -> Result<(Vec<SceneRow>, Vec<Expectation>)> {
        let rows = MeasuredScene::new(data, prior, &further)?.rows(&built, args.seed)?;
        let free = open_loop::expectations(data, prior, &models, &measures)?;
        Ok((rows, free.context("the scene was attackable")?))
    };
    let mut progress = Progress::new("attacked", scenes.len());
    let all = scenes.map(one, || progress.step())?;
    progress.finish(&format!("{} variants on {}", VARIANTS.len(), progress::count(all.len(), "scene")));
    let mut tuned: Vec<Tuned> = VARIANTS.iter().map(|_| Tuned::default()).collect();
    for (rows, free) in all {
        for ((tuned, row), expectation) in tuned.iter_mut().zip(rows).zip(free) {
            tuned.rows.push(row);
            tuned.free.push(expectation);
        }
    }
    Ok((tuned, scenes.failed()))
}

fn table(tuned: &[Tuned], seed: u64) -> Result<String> {
    let Some(base) = tuned.first() else { bail!("there are no variants") };
    let heads: Vec<&str> =
        COLUMNS.iter().map(|(name, _)| *name).chain(FREE.iter().map(|(name, _)| *name)).collect();
    let mut out = format!(
        "What each part of the fine-tuning contributes, against a replayed ego.\n\n\
         | variant | N | {} | attack minus HGPO's, points | feasible minus HGPO's, points |\n| --- | --- |{} --- | --- |\n",
        heads.join(" | "),
        " --- |".repeat(heads.len())
    );
    let mean = |values: &[f64], what: &str| {
        statistics::bootstrap_mean(values, RESAMPLES, &mut Rng::new(seed, what, "ablation"))
    };
    for ((name, ..), own) in VARIANTS.iter().zip(tuned) {
        let of_rows = COLUMNS
            .map(|(column, value)| mean(&own.rows.iter().filter_map(value).collect::<Vec<_>>(), column));
        let of_policy =
            FREE.map(|(column, value)| mean(&own.free.iter().map(value).collect::<Vec<_>>(), column));
        let cells: Vec<String> = of_rows.iter().chain(&of_policy).map(cell).collect();
        let less = |own: Vec<f64>, base: Vec<f64>, what: &str| {
            let differences: Vec<f64> = own.iter().zip(base).map(|(a, b)| a - b).collect();
            cell(&mean(&differences, what))
        };
        let attack = |tuned: &Tuned| tuned.rows.iter().filter_map(COLUMNS[0].1).collect::<Vec<_>>();
        let feasible = |tuned: &Tuned| tuned.free.iter().map(FREE[0].1).collect::<Vec<_>>();
        let (a, b) = if std::ptr::eq(own, base) {
            ("-".to_owned(), "-".to_owned())
        } else {
            (less(attack(own), attack(base), "attack"), less(feasible(own), feasible(base), "feasible"))
        };
        writeln!(out, "| {name} | {} | {} | {a} | {b} |", own.rows.len(), cells.join(" | "))?;
    }
    out += "\nThe first six columns are of the candidate with the largest R_adv among the feasible ones (w_adv = 1); the last two are \
        expectations under the policy, without selection. One seed of tuning; intervals do not hold its variance. Intervals: 95 %, bootstrap over scenes; differences are paired.\n";
    Ok(out)
}

fn cell(estimate: &Option<Estimate>) -> String {
    estimate.as_ref().map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high))
}

/// Charts of the training curves: one for each quantity, with a line for each variant.
fn charts(out: &Folder, curves: &str) -> Result<()> {
    let mut lines = curves.lines();
    let heads: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| {
        heads
            .iter()
            .position(|head| *head == name)
            .with_context(|| format!("finetune.csv has no column `{name}`"))
    };
    let (expert, epoch) = (column("expert")?, column("epoch")?);
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    for (file, name, axis) in [
        ("loss.svg", "loss", "loss"),
        ("reward.svg", "best_reward", "best R_adv among the feasible candidates"),
        ("feasible.svg", "feasible", "feasible share of the candidates"),
        ("pairs.svg", "pairs", "pairs a scene"),
    ] {
        let value = column(name)?;
        let mut by_expert: BTreeMap<&str, Vec<[f64; 2]>> = BTreeMap::new();
        for row in &rows {
            let number = |k: usize| row.get(k).and_then(|text| text.parse::<f64>().ok());
            if let (Some(name), Some(x), Some(y)) = (row.get(expert), number(epoch), number(value)) {
                by_expert.entry(name).or_default().push([x, y]);
            }
        }
        let named = |(title, expert, _): &Variant| -> Option<Line> {
            Some(((*title).to_owned(), by_expert.get(expert)?.clone()))
        };
        let chart = line_chart::draw(["epoch", axis], VARIANTS.iter().filter_map(named).collect())?;
        out.write(file, chart.as_bytes())?;
    }
    Ok(())
}
