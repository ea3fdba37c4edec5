//! `sage bench open-loop`.

use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use sage_backbones::{
    Backbone,
    training::{SceneData, TunedScene},
};
use sage_core::generator::Generator;
use sage_merging::{Experts, Merger};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    bench::{
        gallery,
        open_loop::{self, SceneRow},
        open_loop_report::{self as report, Policies, Table},
    },
    cli::OpenLoopArgs,
    methods::{self, Place},
    networks, output,
    progress::{self, Progress},
    scenes,
};

/// What is kept of one generator once it has run on all scenes, so that a run can go on.
#[derive(Serialize, Deserialize)]
struct Finished {
    method: String,
    rows: Vec<SceneRow>,
    /// Scenes that failed, with their errors.
    errors: Vec<(String, String)>,
}

pub(crate) fn run(args: &OpenLoopArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    let merger = registries.mergers.build_default(&args.dial.merger)?;
    let places = args.dial.places(&args.weights, &experts, args.choice.into(), &[0.0, 0.5, 1.0])?;
    let runs = generators(args, registries, &places, &experts, &*merger)?;
    let paths = [&args.paths[..], &args.data].concat();
    let scenes = scenes::attackable(scenes::read(&paths, &args.split, 0, args.seed)?)?;
    let record = record(args, &experts, &scenes, &runs, &places)?;
    start(args, &record)?;
    let mut progress = Progress::new("ran", runs.len());
    let mut table = Table::new();
    let mut failures = 0;
    for (k, generator) in runs.iter().enumerate() {
        let finished = one(args, k, &**generator, &scenes, experts.prior())?;
        for (scene, error) in &finished.errors {
            progress.say(&format!("error: {}: `{scene}`: {error}", finished.method));
        }
        failures += finished.errors.len();
        table.push((finished.method, finished.rows));
        progress.step();
    }
    progress.finish(&format!("{} rows on {} scenes", runs.len(), scenes.len()));
    if table.iter().all(|(_, rows)| rows.is_empty()) {
        bail!("no scene came out");
    }
    let policies = policies(&places, &experts, &*merger, &scenes)?;
    let markdown = report::markdown(&table, &policies)?;
    let file =
        |name: &str, text: &str| output::write_file(&args.folder.out.join(name), text.as_bytes(), true);
    file("table.md", &markdown)?;
    file("table.csv", &report::csv(&table, &policies)?)?;
    file("scenes.csv", &report::scenes_csv(&table)?)?;
    gallery::write(&args.folder.out, &scenes, &table, &markdown)?;
    finish(args, &record, clock.elapsed().as_secs_f64())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "table.md, table.csv, scenes.csv, run.json and index.html with pictures are in `{}`",
        args.folder.out.display()
    ));
    Ok(if failures == 0 { Outcome::Done } else { Outcome::Partial })
}

/// The generators in the order of the table.
fn generators(
    args: &OpenLoopArgs,
    registries: &Registries,
    places: &[Place],
    experts: &Experts,
    merger: &dyn Merger,
) -> Result<Vec<Box<dyn Generator>>> {
    if args.raw && !args.methods.iter().any(|name| name == "rule") {
        bail!("--raw is for the method `rule`, which is not among --methods");
    }
    let mut runs = Vec::new();
    for name in &args.methods {
        let options = if args.raw && name == "rule" { json!({"raw": true}) } else { json!({}) };
        let method = registries.methods.build(name, &options)?;
        let hardest = places.iter().max_by(|a, b| a.mu.total_cmp(&b.mu));
        let places: Vec<&Place> =
            if method.stands_once() { hardest.into_iter().collect() } else { places.iter().collect() };
        for place in places {
            runs.push(methods::build(&*method, *place, args.choosing.with(args.choice), experts, merger)?);
        }
    }
    Ok(runs)
}

/// Rows of one generator: kept ones where it ran before.
fn one(
    args: &OpenLoopArgs,
    number: usize,
    generator: &dyn Generator,
    scenes: &[SceneData],
    prior: &dyn Backbone,
) -> Result<Finished> {
    let file = args.folder.out.join(KEPT).join(format!("{number:03}.json"));
    let kept = std::fs::read_to_string(&file).ok().and_then(|text| serde_json::from_str(&text).ok());
    if let Some(kept) = kept.filter(|kept: &Finished| kept.method == generator.name()) {
        return Ok(kept);
    }
    let mut finished = Finished { method: generator.name(), rows: Vec::new(), errors: Vec::new() };
    for (data, row) in scenes.iter().zip(open_loop::run(scenes, generator, prior, args.seed)) {
        match row {
            Ok(row) => finished.rows.push(row),
            Err(error) => finished.errors.push((data.name.clone(), format!("{error:#}"))),
        }
    }
    output::write_file(&file, serde_json::to_string(&finished)?.as_bytes(), true)?;
    Ok(finished)
}

/// Folder of what is kept while a run goes on.
const KEPT: &str = ".sage-rows";

/// What tells one run from another.
fn record(
    args: &OpenLoopArgs,
    experts: &Experts,
    scenes: &[SceneData],
    runs: &[Box<dyn Generator>],
    places: &[Place],
) -> Result<Value> {
    let hash = |p: &sage_backbones::Parameters| p.hash();
    Ok(json!({
        "methods": runs.iter().map(|g| g.name()).collect::<Vec<_>>(),
        "merger": args.dial.merger, "choice": format!("{:?}", args.choosing.with(args.choice)), "seed": args.seed,
        "scenes": scenes::describe(scenes),
        "weights": [hash(experts.prior().parameters())?, hash(experts.realistic())?, hash(experts.adversarial())?],
        "places": places, "raw": args.raw, "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    }))
}

/// Makes the folder, or goes on in one that holds the same run unfinished.
fn start(args: &OpenLoopArgs, record: &Value) -> Result<()> {
    let kept = args.folder.out.join(KEPT);
    if !output::start_run(&args.folder.out, record, args.folder.force)? && kept.exists() {
        std::fs::remove_dir_all(&kept).with_context(|| format!("cannot clear `{}`", kept.display()))?;
    }
    std::fs::create_dir_all(&kept).with_context(|| format!("cannot make `{}`", kept.display()))
}

/// Says how long it took, and drops what was kept to go on from.
fn finish(args: &OpenLoopArgs, record: &Value, seconds: f64) -> Result<()> {
    output::finish_run(&args.folder.out, record, &Value::Null, seconds)?;
    let kept = args.folder.out.join(KEPT);
    std::fs::remove_dir_all(&kept).with_context(|| format!("cannot clear `{}`", kept.display()))
}

/// Expectations of the prior and of the mixtures at all λ.
fn policies(
    places: &[Place],
    experts: &Experts,
    merger: &dyn Merger,
    scenes: &[SceneData],
) -> Result<Policies> {
    let prior = experts.prior();
    let prepared = TunedScene::all(prior, scenes, false)?;
    let mut policies = vec![("prior".to_owned(), open_loop::expectations(&prepared, prior)?)];
    for place in places {
        let network: Box<dyn Backbone> = prior.rebuilt(merger.merge(experts, place.lambda)?)?;
        let all = open_loop::expectations(&prepared, &*network)?;
        policies.push((format!("sage, lambda {:.2}", place.lambda), all));
    }
    Ok(policies)
}
