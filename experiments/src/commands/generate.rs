//! `sage generate`: writes adversarial variants of scenes as a data set.

mod attack;
mod plan;
mod row;

use std::{path::Path, time::Instant};

use anyhow::Result;
use sage_core::statistics;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::GenerateArgs,
    output::{self, DatasetRun},
    progress,
    scene_queue::{self, Input, Report, Scenes, is_row_of},
};

use attack::{attack_scene, picture_file};
use plan::Plan;
use row::{FoundRow, row_file};

pub(crate) fn run(args: &GenerateArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let plan = Plan::new(args, registries)?;
    let scenes = Scenes::find(&args.scene, &args.reading.options())?;
    let (all, own) = (&scenes.all, scenes.of_shard(args.shard));
    scenes.protect(&args.folder.out, Vec::new())?;
    let out = &args.folder.out;
    let outdated = || own.iter().flat_map(|input| outputs(&plan, out, input)).collect();
    let run = DatasetRun::start(out, plan.identity()?, args.folder.force, args.shard, outdated)?;
    output::keep_planner_logs(run.folder(), std::slice::from_ref(&plan.ego))?;
    let report = Report::new(run.folder().path(), args.json, own.len(), ["attacked", "attack"]);
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
    let (results, listed) = run.finish(plan.writes_pickles(), results, median, whole)?;
    let others = listed.saturating_sub(all.len() * plan.variants().len());
    if is_whole(&results) && others > 0 {
        let out = args.folder.out.display();
        let others = progress::count(others, "scene");
        progress::say(&format!(
            "note: the summary of `{out}` also lists {others} that other runs left there"
        ));
    }
    scene_queue::outcome([failed, left_out], own.len(), out, "attacked")
}

/// True if all rows of a scene exist and are of the run with a hash.
fn is_done(plan: &Plan, folder: &Path, run_hash: &str, input: &Input) -> bool {
    let is_row = |variant: &String| is_row_of(&folder.join(row_file(&input.scene, variant)), run_hash);
    plan.variants().iter().all(is_row)
}

/// Existing outputs of a scene: its rows, the scene files that they name, and its picture.
fn outputs(plan: &Plan, folder: &Path, input: &Input) -> Vec<String> {
    let mut names = vec![picture_file(&input.scene)];
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
