//! `sage bench open-loop`.

use std::{path::PathBuf, time::Instant};

use anyhow::{Result, bail};
use sage_backbones::{
    Backbone,
    training::{Expectation, SceneData},
};
use sage_core::{files, generator::Generator};
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
    networks,
    output::{self, Run, State},
    progress::{self, Progress},
    scenes::Scenes,
};

/// Folder of the results that a run goes on from if it was broken off.
const RESULTS: &str = ".sage-rows";
/// Scenes whose results are kept together.
const WINDOW: usize = 16;
/// Largest file of results that is read, bytes.
const RESULTS_LIMIT: u64 = 256 << 20;
/// The table, for people.
const TABLE: &str = "table.md";
/// What a run leaves, pictures aside.
const FILES: [&str; 4] = [TABLE, "table.csv", "scenes.csv", "index.html"];

/// What came of one scene.
#[derive(Serialize, Deserialize)]
struct SceneResult {
    scene: String,
    /// A row a generator, or its error.
    rows: Vec<Result<SceneRow, String>>,
    /// Expectations under each policy, without any choice.
    expectations: Option<Vec<Expectation>>,
}

pub(crate) fn run(args: &OpenLoopArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    let merger = registries.mergers.build_default(&args.dial.merger)?;
    let places = args.dial.places(&args.weights, &experts, args.choice.into(), &[0.0, 0.5, 1.0])?;
    let generators = generators(args, registries, &places, &experts, &*merger)?;
    let policies = policies(&places, &experts, &*merger)?;
    let paths = [&args.paths[..], &args.data].concat();
    let scenes = Scenes::of(&paths, &args.split, 0, args.seed)?.attackable()?;
    let identity = identity(args, &experts, &scenes, &generators, &places)?;
    let (run, state) = Run::start(&args.folder.out, identity, args.folder.force, &[RESULTS], &[], &FILES)?;
    if state == State::Done {
        output::print(&files::read_text(&run.folder().path().join(TABLE), RESULTS_LIMIT)?)?;
        return Ok(Outcome::Done);
    }
    let results = run.folder().inner(RESULTS.as_ref())?;
    let one = |data: &SceneData| -> Result<SceneResult> {
        let row = |generator: &dyn Generator| {
            let row = open_loop::run(data, generator, experts.prior(), args.seed);
            row.map_err(|error| format!("{error:#}"))
        };
        let networks = policies.iter().map(|(_, network)| &**network);
        Ok(SceneResult {
            scene: data.name.clone(),
            rows: generators.iter().map(|generator| row(&**generator)).collect(),
            expectations: open_loop::expectations(data, experts.prior(), networks)?,
        })
    };
    let mut progress = Progress::new("ran", scenes.len());
    let mut all: Vec<SceneResult> = Vec::with_capacity(scenes.len());
    for (number, window) in scenes.windows(WINDOW).enumerate() {
        all.extend(results_of(
            &run,
            results.join(format!("{number:06}.json")),
            &window,
            generators.len(),
            &one,
            || progress.step(),
        )?);
    }
    progress.finish(&format!("{} rows on {} scenes", generators.len(), scenes.len()));
    let failures = report_errors(&all, &generators);
    let table = table(&all, &generators);
    if table.iter().all(|(_, rows)| rows.is_empty()) {
        bail!("no scene came out");
    }
    let expectations = by_policy(&all, &policies);
    let markdown = report::markdown(&table, &expectations)?;
    let folder = run.folder();
    folder.write("table.csv", report::csv(&table, &expectations)?.as_bytes())?;
    folder.write("scenes.csv", report::scenes_csv(&table)?.as_bytes())?;
    gallery::write(folder, &scenes, &table, &markdown)?;
    folder.write(TABLE, markdown.as_bytes())?;
    run.finish(&Value::Null, clock.elapsed().as_secs_f64())?;
    output::print(&markdown)?;
    progress::say(&format!(
        "table.md, table.csv, scenes.csv, run.json and index.html with pictures are in `{}`",
        args.folder.out.display()
    ));
    Ok(if failures == 0 { Outcome::Done } else { Outcome::Partial })
}

/// Results of some scenes: those in the file if a run before left them there, else new ones.
fn results_of(
    run: &Run,
    file: PathBuf,
    scenes: &Scenes,
    generators: usize,
    one: &(impl Fn(&SceneData) -> Result<SceneResult> + Sync),
    mut done: impl FnMut(),
) -> Result<Vec<SceneResult>> {
    let before = files::read_text(&file, RESULTS_LIMIT).ok();
    let before = before.and_then(|text| serde_json::from_str::<Vec<SceneResult>>(&text).ok());
    let fits = |before: &Vec<SceneResult>| {
        let names = before.iter().map(|result| &result.scene);
        names.eq(&scenes.names()) && before.iter().all(|result| result.rows.len() == generators)
    };
    if let Some(before) = before.filter(fits) {
        before.iter().for_each(|_| done());
        return Ok(before);
    }
    let results = scenes.map(one, done)?;
    let name = file.strip_prefix(run.folder().path()).unwrap_or(&file).display().to_string();
    run.folder().write(&name, serde_json::to_string(&results)?.as_bytes())?;
    Ok(results)
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
    let mut generators = Vec::new();
    for name in &args.methods {
        let options = if args.raw && name == "rule" { json!({"raw": true}) } else { json!({}) };
        let method = registries.methods.build(name, &options)?;
        let hardest = places.iter().max_by(|a, b| a.mu.total_cmp(&b.mu));
        let places: Vec<&Place> =
            if method.stands_once() { hardest.into_iter().collect() } else { places.iter().collect() };
        for place in places {
            let choosing = args.choosing.with(args.choice);
            generators.push(methods::build(&*method, *place, choosing, experts, merger)?);
        }
    }
    Ok(generators)
}

/// The prior and the mixtures at all λ, by name.
fn policies(
    places: &[Place],
    experts: &Experts,
    merger: &dyn Merger,
) -> Result<Vec<(String, Box<dyn Backbone>)>> {
    let prior = experts.prior();
    let mut policies = vec![("prior".to_owned(), prior.rebuilt(prior.parameters().clone())?)];
    for place in places {
        let network = prior.rebuilt(merger.merge(experts, place.lambda)?)?;
        policies.push((format!("sage, lambda {:.2}", place.lambda), network));
    }
    Ok(policies)
}

/// What tells one run from another.
fn identity(
    args: &OpenLoopArgs,
    experts: &Experts,
    scenes: &Scenes,
    generators: &[Box<dyn Generator>],
    places: &[Place],
) -> Result<Value> {
    let hash = |p: &sage_backbones::Parameters| p.hash();
    Ok(json!({
        "methods": generators.iter().map(|g| g.name()).collect::<Vec<_>>(),
        "merger": args.dial.merger, "choice": format!("{:?}", args.choosing.with(args.choice)), "seed": args.seed,
        "scenes": scenes.describe(), "names": scenes.names(),
        "weights": [hash(experts.prior().parameters())?, hash(experts.realistic())?, hash(experts.adversarial())?],
        "places": places, "raw": args.raw, "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    }))
}

/// Says which generator failed in which scene; how many times.
fn report_errors(all: &[SceneResult], generators: &[Box<dyn Generator>]) -> usize {
    let mut failures = 0;
    for result in all {
        for (row, generator) in result.rows.iter().zip(generators) {
            if let Err(error) = row {
                progress::say(&format!("error: {}: `{}`: {error}", generator.name(), result.scene));
                failures += 1;
            }
        }
    }
    failures
}

/// Rows by generator.
fn table(all: &[SceneResult], generators: &[Box<dyn Generator>]) -> Table {
    let rows = |k: usize| all.iter().filter_map(move |result| result.rows.get(k)?.as_ref().ok().cloned());
    generators.iter().enumerate().map(|(k, generator)| (generator.name(), rows(k).collect())).collect()
}

/// Expectations by policy.
fn by_policy(all: &[SceneResult], policies: &[(String, Box<dyn Backbone>)]) -> Policies {
    let of = |k: usize| all.iter().filter_map(move |result| result.expectations.as_ref()?.get(k).copied());
    policies.iter().enumerate().map(|(k, (name, _))| (name.clone(), of(k).collect())).collect()
}
