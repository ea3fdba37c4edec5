//! `sage search`: searches scenes for what a driver fails at.

mod picture;
mod row;
mod scene;
mod searcher;
mod summary;

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Result, bail};
use sage_core::statistics;
use sage_data::folder;
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    cli::SearchArgs,
    input,
    output::{self, DatasetRun, Inputs},
    part::PolicyPart,
    progress,
    scene_queue::{self, Input, Report, is_row_of},
};

use row::{SceneRow, failure_name, row_file};
use scene::{picture_file, search_scene};
use searcher::Searcher;
use summary::Summary;

pub(crate) fn run(args: &SearchArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let searcher = Searcher::new(args, registries)?;
    let files = folder::scene_files(&args.scene)?;
    input::check_single(&files)?;
    let all = scene_queue::inputs(&args.scene, &files, &args.reading.options());
    check_names(&all)?;
    let own: Vec<&Input> =
        all.iter().filter(|input| args.shard.is_none_or(|shard| shard.holds(&input.scene))).collect();
    // Input files must not be in the output folder, even if no output has the same name.
    let names: Vec<PathBuf> = files
        .iter()
        .flat_map(|file| [Some(file.clone()), file.canonicalize().ok()])
        .flatten()
        .filter_map(|file| file.file_name().map(PathBuf::from))
        .collect();
    let mut read = files.clone();
    read.extend(PolicyPart::files(&args.ego));
    output::protect_inputs(std::slice::from_ref(&args.scene), &read, &args.folder.out, &names)?;
    Inputs::of_command_line().refuse_folder(&args.folder.out)?;
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
        results
    };
    let is_whole = |results: &Value| results["scenes"] == results["done"];
    let whole = |results: &Value| (is_whole(results) && failed == 0).then(|| clock.elapsed().as_secs_f64());
    run.finish(searcher.writes_pickles(), results, statistics::median(&seconds), whole)?;
    progress::say_lines(&summary.text());
    match failed {
        0 if left_out == own.len() && left_out > 0 => bail!("no scene could be searched: all are left out"),
        0 => Ok(Outcome::Done),
        1 if own.len() == 1 => bail!("the scene could not be searched"),
        all if all == own.len() => bail!("no scene of {all} could be searched"),
        some => {
            progress::say(&format!(
                "{some} of {} scenes failed; the others are in `{}`; remove the cause and run the same command again",
                own.len(),
                out.display()
            ));
            Ok(Outcome::Partial)
        }
    }
}

/// Refuses scenes one of whose files would have the name of a file of another.
fn check_names(inputs: &[Input]) -> Result<()> {
    for input in inputs {
        let cut = ["-drives", "-failure"].iter().find_map(|word| {
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
    let mut names = vec![picture_file(&input.scene), row::drives_file(&input.scene)];
    if let Some(found) = SceneRow::read(&folder.join(&row)) {
        let start = format!("{}-{}", input.scene, failure_name(1).trim_end_matches('1'));
        let is_own = |file: &String| file.contains(&start) && !file.contains(['/', '\\']);
        names.extend(found.files.into_iter().filter(is_own));
    }
    names.push(row);
    names
}
