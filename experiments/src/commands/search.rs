//! `sage search`: searches scenes for what a driver fails at.

pub(super) mod found;
mod picture;
mod row;
mod scene;
mod searcher;
mod summary;

use std::{path::Path, time::Instant};

use anyhow::{Result, bail};
use sage_core::statistics;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::{Keep, SearchArgs},
    output::{self, DatasetRun},
    progress,
    scene_queue::{self, Input, Report, Scenes, is_row_of},
};

pub(super) use row::{SceneRow, failure_name, row_file, unchanged_file};
use scene::{picture_file, search_scene};
use searcher::Searcher;
use summary::Summary;

pub(crate) fn run(args: &SearchArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let searcher = Searcher::new(args, registries)?;
    let scenes = Scenes::find(&args.scene, &args.reading.options())?;
    let (all, own) = (&scenes.all, scenes.of_shard(args.shard));
    check_names(all)?;
    scenes.protect(&args.folder.out, args.ego.files())?;
    let out = &args.folder.out;
    let outdated = || own.iter().flat_map(|input| outputs(out, input)).collect();
    let run = DatasetRun::start(out, searcher.identity()?, args.folder.force, args.shard, outdated)?;
    output::keep_planner_logs(run.folder(), std::slice::from_ref(&searcher.ego))?;
    let report = Report::new(run.folder().path(), args.json, own.len(), ["searched", "scene"]);
    let seconds = scene_queue::work(&own, &run, &report, |input| search_scene(&searcher, &run, input))?;
    let [failed, left_out, _] = report.finish(out);
    let (folder, hash) = (run.folder().path().to_owned(), run.hash().to_owned());
    let summary = Summary::of(all.iter().filter_map(|input| done(&folder, &hash, input)), args.require);
    let results = || {
        let mut results = summary.json();
        results["scenes"] = json!(all.len());
        if left_out > 0 {
            results["left_out"] = json!(left_out);
        }
        results
    };
    let whole = |results: &Value| {
        let done = results["done"].as_u64().unwrap_or_default() as usize;
        (all.len() == done + left_out && failed == 0).then(|| clock.elapsed().as_secs_f64())
    };
    run.finish(searcher.writes_pickles(), results, statistics::median(&seconds), whole)?;
    progress::say_lines(&summary.text());
    scene_queue::outcome([failed, left_out], own.len(), out, "searched")
}

/// Refuses scenes one of whose files would have the name of a file of another.
fn check_names(inputs: &[Input]) -> Result<()> {
    for input in inputs {
        let cut = ["-drives", "-failure", "-unchanged"].iter().find_map(|word| {
            let (before, after) = input.scene.rsplit_once(word)?;
            after.chars().all(|c| c.is_ascii_digit()).then_some(before)
        });
        if let Some(other) = cut.and_then(|name| inputs.iter().find(|other| other.scene == name)) {
            bail!(
                "outputs of the scenes `{}` and `{}` would have the same name; rename one of them",
                other.scene,
                input.scene
            );
        }
    }
    Ok(())
}

/// The row of a scene, if the run has finished it.
fn done(folder: &Path, run_hash: &str, input: &Input) -> Option<SceneRow> {
    let path = folder.join(row_file(&input.scene));
    if is_row_of(&path, run_hash) { SceneRow::read(&path) } else { None }
}

/// Existing outputs of a scene: the files that its row names, and the row, which is removed last.
fn outputs(folder: &Path, input: &Input) -> Vec<String> {
    let row = row_file(&input.scene);
    let mut names =
        vec![picture_file(&input.scene), row::drives_file(&input.scene), unchanged_file(&input.scene)];
    if let Some(found) = SceneRow::read(&folder.join(&row)) {
        let start = format!("{}-{}", input.scene, failure_name(1).trim_end_matches('1'));
        let is_own = |file: &String| file.contains(&start) && !file.contains(['/', '\\']);
        names.extend(found.files.into_iter().filter(is_own));
    }
    names.push(row);
    names
}

impl Keep {
    /// Numbers of the failures of a scene that are kept.
    pub(super) fn numbers(self, row: &SceneRow) -> Vec<usize> {
        match self {
            Self::All => (1..=row.failures()).collect(),
            Self::Worst => row.worst().into_iter().collect(),
            Self::Mildest => row.mildest().into_iter().collect(),
        }
    }

    /// How many they are.
    pub(super) fn count(self, row: &SceneRow) -> usize {
        if self == Self::All { row.failures() } else { row.failures().min(1) }
    }
}
