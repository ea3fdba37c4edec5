//! `sage generate`: writes adversarial variants of scenes as a data set.

mod attack;
mod found_row;
mod index;
mod measured;
mod names;
mod plan;
mod row;
mod scored;
mod summary;
mod view;

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::Result;
use rayon::prelude::*;
use sage_core::statistics;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::GenerateArgs,
    output::{self, DatasetRun},
    progress,
    scene_queue::{self, Input, Report, Scenes, is_row_of},
};

use attack::attack_scene;
use found_row::FoundRow;
use names::{INDEX, page_file, picture_file, row_file};
use plan::Plan;
use summary::Tally;

pub(crate) fn run(args: &GenerateArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let plan = Plan::new(args, registries)?;
    let scenes = Scenes::find(&args.scene, &args.reading.options())?;
    let (all, own) = (&scenes.all, scenes.of_shard(args.shard));
    scenes.protect(&args.folder.out, Vec::new())?;
    let out = &args.folder.out;
    let outdated = || {
        let of_scenes = own.iter().flat_map(|input| outputs(&plan, out, input));
        of_scenes.chain([INDEX.to_owned()]).collect()
    };
    let run = DatasetRun::start(out, plan.identity()?, args.folder.force, args.shard, outdated)?;
    output::keep_planner_logs(run.folder(), std::slice::from_ref(&plan.ego))?;
    let report = Report::new(run.folder().path(), args.json, own.len(), ["attacked", "attempt"]);
    let report = if args.quiet { report.quiet() } else { report };
    let attack = |input: &Input| attack_scene(&plan, &run, &input.file, &input.scene);
    let seconds = scene_queue::work(&own, &run, &report, attack)?;
    let [failed, left_out, _] = report.finish(&args.folder.out);
    let (folder, hash) = (run.folder().path().to_owned(), run.hash().to_owned());
    let results = || {
        let done = all.iter().filter(|input| is_done(&plan, &folder, &hash, input)).count();
        json!({"scenes": all.len(), "done": done})
    };
    let is_whole = |results: &Value| results["scenes"] == results["done"];
    let whole = |results: &Value| (is_whole(results) && failed == 0).then(|| clock.elapsed().as_secs_f64());
    let median = statistics::median(&seconds);
    write_index(&plan, &run, all, args.shard.is_some())?;
    let (results, listed) = run.finish(plan.writes_pickles(), results, median, whole)?;
    let others = listed.saturating_sub(all.len() * plan.variants().len());
    if is_whole(&results) && others > 0 {
        let out = args.folder.out.display();
        let others = progress::count(others, "scene");
        progress::say(&format!(
            "note: the summary of `{out}` also lists {others} that other runs left there"
        ));
    }
    if left_out + failed < own.len() {
        print_table(&plan, &folder, &hash, &own, args.json)?;
        if out.join(INDEX).is_file() {
            progress::say(&format!("to look at the attacks, open `{}`", out.join(INDEX).display()));
        }
    }
    scene_queue::outcome([failed, left_out], own.len(), out, "attacked")
}

/// Prints what came of the attacks of this run, and how to find out why one is none.
fn print_table(plan: &Plan, folder: &Path, run_hash: &str, own: &[&Input], json: bool) -> Result<()> {
    // Rows are large, so only what they count for is kept.
    let tallied = |mut tally: Tallied, number: usize| {
        for (variant, row) in rows(plan, folder, run_hash, own[number]) {
            tally.of_variant[variant].add(&row);
            if !row.outcome.is_attack() {
                let file = folder.join(row_file(&row.scene, &row.variant));
                tally.without = tally.without.max(Some((number, variant, file, row.files.is_empty())));
            }
        }
        tally
    };
    let empty = || Tallied { of_variant: vec![Tally::default(); plan.variants().len()], without: None };
    let all = (0..own.len()).into_par_iter().fold(empty, tallied).reduce(empty, Tallied::and);
    if own.len() * plan.variants().len() > 1 {
        output::print_table(&summary::table(plan, &all.of_variant), json)?;
    }
    if let Some((number, _, file, has_no_scene)) = all.without {
        let of = if has_no_scene { format!(" --of {}", own[number].file.display()) } else { String::new() };
        progress::say(&format!("why there is no attack: `sage explain {}{of}`", file.display()));
    }
    Ok(())
}

/// What the rows of a run count for.
struct Tallied {
    of_variant: Vec<Tally>,
    /// The last row without an attack: numbers of scene and variant, its file, and whether it has no scene file.
    without: Option<(usize, usize, PathBuf, bool)>,
}

impl Tallied {
    fn and(self, other: Self) -> Self {
        let sum = |(own, other): (Tally, &Tally)| own.and(other);
        Self {
            of_variant: self.of_variant.into_iter().zip(&other.of_variant).map(sum).collect(),
            without: self.without.max(other.without),
        }
    }
}

/// Rows of a scene that this run has, with the number of their variant.
fn rows<'a>(
    plan: &'a Plan,
    folder: &'a Path,
    run_hash: &'a str,
    input: &'a Input,
) -> impl Iterator<Item = (usize, FoundRow)> + 'a {
    let names = plan.variants().iter().map(|variant| folder.join(row_file(&input.scene, variant)));
    let own = names.enumerate().filter(|(_, path)| is_row_of(path, run_hash));
    own.filter_map(|(variant, path)| Some((variant, FoundRow::read_head(&path)?)))
}

/// Writes the page of the data set. A shard writes it if it is the last.
fn write_index(plan: &Plan, run: &DatasetRun, all: &[Input], is_shard: bool) -> Result<()> {
    let is_done = |input| is_done(plan, run.folder().path(), run.hash(), input);
    if plan.args.no_pages || !all.iter().any(is_done) || (is_shard && !all.iter().all(is_done)) {
        return Ok(());
    }
    index::write(plan, run.folder(), run.hash(), all)
}

/// True if all rows of a scene exist and are of the run with a hash.
fn is_done(plan: &Plan, folder: &Path, run_hash: &str, input: &Input) -> bool {
    let is_row = |variant: &String| is_row_of(&folder.join(row_file(&input.scene, variant)), run_hash);
    plan.variants().iter().all(is_row)
}

/// Existing outputs of a scene: its rows, the scene files that they name, and its picture.
fn outputs(plan: &Plan, folder: &Path, input: &Input) -> Vec<String> {
    let mut names = vec![picture_file(&input.scene), page_file(&input.scene)];
    for variant in plan.variants() {
        let (row, name) = (row_file(&input.scene, variant), format!("{}-{variant}", input.scene));
        let is_own = |file: &String| {
            let is_pickle = file.starts_with("sd_") && file.ends_with(&format!("_{name}.pkl"));
            let is_native = *file == format!("{name}.safetensors");
            let is_scenario = *file == format!("{name}.xosc");
            (is_pickle || is_native || is_scenario) && !file.contains(['/', '\\'])
        };
        // The row is removed last, because it alone knows the names.
        if let Some(found) = FoundRow::read(&folder.join(&row)) {
            names.extend(found.files.into_iter().filter(is_own));
        }
        names.push(row);
    }
    names
}
