//! `sage search`: searches scenes for what a driver fails at.

mod admitted;
mod estimate;
pub(super) mod found;
mod picture;
mod scene;
mod searcher;
pub(super) mod summary;

use std::path::Path;

use advsage::{
    Registries,
    rows::search::{SceneRow, drives_file, failure_name, row_file, unchanged_file},
};
use anyhow::{Result, bail};
use sage_data::Format;
use sage_run::{
    Outcome,
    output::{self, Counts, DatasetRun, Ended, Extent, MANIFEST},
    progress,
    scene_queue::{self, Input, Report, ReportWords, Scenes, Worked, is_row_of, work_on},
};

use crate::cli::{Keep, SearchArgs};
use scene::picture_file;
use searcher::Searcher;
use summary::Summary;

pub(crate) fn run(args: &SearchArgs, extent: Extent, registries: &Registries) -> Result<Outcome> {
    let searcher = Searcher::new(args, registries)?;
    let scenes = Scenes::find(&args.scene, &args.reading.options())?;
    let (all, own) = (&scenes.all, scenes.of_part(extent));
    check_names(all)?;
    scenes.protect(&args.folder.out, args.ego.files())?;
    let out = &args.folder.out;
    let outdated = || {
        let of_scenes = own.iter().flat_map(|input| outputs(out, input));
        of_scenes.chain([MANIFEST.to_owned()]).collect()
    };
    let run = DatasetRun::start(out, searcher.identity()?, args.folder.force, extent, &[MANIFEST], outdated)?;
    output::keep_planner_logs(run.folder(), extent, std::slice::from_ref(&searcher.ego))?;
    admitted::say(args.admitted.as_deref(), &args.ego)?;
    let report = |count| {
        searcher.estimate.set_scenes(count);
        Report::new(run.folder().path(), args.json, count, ReportWords { done: "searched", result: "scene" })
    };
    let worked = Worked::on(&scenes, extent, &run, report, |input| work_on(&searcher, &run, input))?;
    let (records, shown) = (&worked.records, scenes.reported_by(extent));
    let rows = shown.into_iter().filter_map(|input| done(run.folder().path(), run.hash(), input));
    let summary = Summary::of(rows, searcher.options.require);
    match extent {
        Extent::Shard(shard) => run.finish_shard(shard, records)?,
        Extent::Whole | Extent::Join => {
            let mut results = scene_queue::results(records);
            for (name, value) in summary.json() {
                results[&name] = value;
            }
            run.finish(Ended {
                records,
                shards: &worked.shards,
                results,
                seconds_per_attack: worked.median_seconds(),
                has_pickles: args.format.has(Format::Pickle),
                is_done: Counts::of(records).failure_count() == 0,
            })?;
        }
    }
    progress::say_lines(&summary.text());
    Ok(scene_queue::outcome(records, extent, out, "searched", scene_queue::AGAIN))
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
    let mut names = vec![picture_file(&input.scene), drives_file(&input.scene), unchanged_file(&input.scene)];
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
            Self::Likeliest => row.likeliest().into_iter().collect(),
        }
    }

    /// How many they are.
    pub(super) fn count(self, row: &SceneRow) -> usize {
        if self == Self::All { row.failures() } else { row.failures().min(1) }
    }
}
