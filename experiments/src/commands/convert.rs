//! `sage convert`: converts scenes between formats, in parallel and in order.

mod rows;
mod scenes;
mod tfrecords;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use anyhow::Result;
use sage_data::{Format, ReadOptions, stream::Inputs, womd};
use sage_run::{
    Outcome, input,
    output::{self, Counts, DatasetRun, Ended, Extent, MANIFEST, SceneRecord, ShardState},
    progress::{Progress, count},
};
use serde::Serialize;
use serde_json::json;

use crate::cli::ConvertArgs;

/// Notes that are printed. Those of an OpenSCENARIO file are also in its map.
const MOST_NOTES: usize = 12;

/// What a part of a run has done.
#[derive(Default)]
struct Tally {
    /// Scenes that are converted, by this run or an earlier one.
    whole: usize,
    failed: usize,
    /// What could not be kept, and how often.
    notes: BTreeMap<String, usize>,
    /// Names of all outputs of the run, in their order: those of scenes, or of TFRecord files.
    names: Vec<String>,
    /// What became of those of this part.
    records: Vec<SceneRecord>,
}

impl Tally {
    fn add_notes(&mut self, notes: impl IntoIterator<Item = (String, usize)>) {
        for (note, count) in notes {
            *self.notes.entry(note).or_default() += count;
        }
    }
}

pub(crate) fn run(args: &ConvertArgs, extent: Extent) -> Result<Outcome> {
    args.check()?;
    args.paths.iter().try_for_each(|path| input::check_single(std::slice::from_ref(path)))?;
    if let Some(of) = &args.of {
        return rows::run(args, of, extent);
    }
    let inputs = Inputs::under(&args.paths).map_err(|error| rows::explained(error.into(), &args.paths))?;
    let suffix = args.reading.options().suffix();
    let names: Vec<PathBuf> = inputs.names().map(|name| with_suffix(&name, &suffix)).collect();
    let out = &args.folder.out;
    let files: Vec<PathBuf> = inputs.files().map(Path::to_owned).collect();
    let mut outputs: Vec<PathBuf> = match args.to {
        Format::TfRecord => tfrecords::files(tfrecords::total(&inputs)?, args.scenes_per_file()),
        format => names.iter().map(|name| file_name(name, format)).collect(),
    };
    outputs.push(MANIFEST.into());
    output::protect_inputs(&args.paths, &files, out, &outputs)?;
    let outdated = || if args.to == Format::TfRecord { tfrecords::outdated(out) } else { Vec::new() };
    let run = DatasetRun::start(
        out,
        serde_json::to_value(identity(args, &inputs))?,
        args.folder.force,
        extent,
        &[MANIFEST],
        outdated,
    )?;
    if extent == Extent::Join {
        return join(args, run);
    }
    let mut progress = Progress::new("converted", inputs.count().filter(|_| extent == Extent::Whole));
    let mut tally = Tally::default();
    let outcome = match args.to {
        Format::TfRecord => tfrecords::convert(args, extent, &inputs, &run, &mut progress, &mut tally),
        _ => scenes::convert(args, extent, &inputs, &run, &mut progress, &mut tally),
    };
    let Tally { whole, failed, notes, names, records } = tally;
    if let Err(error) = outcome {
        let of = inputs.count().map_or(String::new(), |all| format!(" of {all}"));
        let sum = format!("{whole}{of} scenes are converted in `{}`", out.display());
        return Err(match output::is_disk_full(error.as_ref()) {
            true => {
                error.context(format!("the disk is full; {sum}; free space and run the same command again"))
            }
            false => error.context(sum),
        });
    }
    for (note, count) in notes.iter().take(MOST_NOTES) {
        let times = if *count > 1 { format!(" ({count} times)") } else { String::new() };
        progress.say(&format!("note: {note}{times}"));
    }
    if notes.len() > MOST_NOTES {
        progress.say(&format!("note: and {} more of this kind", notes.len() - MOST_NOTES));
    }
    progress.finish(&format!("{} in `{}`, {failed} failed", count(whole, "scene"), out.display()));
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    match extent {
        Extent::Shard(shard) => {
            run.agree_on_scenes(&names)?;
            run.finish_shard(shard, &records)?;
        }
        Extent::Whole | Extent::Join => finish(args, run, &records, &[])?,
    }
    Ok(outcome_of(&records))
}

/// Completes the folder of shards.
fn join(args: &ConvertArgs, run: DatasetRun) -> Result<Outcome> {
    let names = run.agreed_scenes()?;
    let (records, shards) = run.joined(&names.iter().map(String::as_str).collect::<Vec<_>>())?;
    finish(args, run, &records, &shards)?;
    Ok(outcome_of(&records))
}

/// Writes what belongs to no single scene.
fn finish(args: &ConvertArgs, run: DatasetRun, records: &[SceneRecord], shards: &[ShardState]) -> Result<()> {
    let results = match args.to {
        Format::TfRecord => {
            let total = tfrecords::finish(&run, records.len())?;
            json!({"scenes": total.scenes, "failed": total.failed})
        }
        _ => {
            let counts = Counts::of(records);
            json!({"scenes": counts.done, "failed": counts.failure_count()})
        }
    };
    let has_pickles = args.to == Format::Pickle;
    let is_done = Counts::of(records).failure_count() == 0;
    run.finish(Ended { records, shards, results, seconds_per_attack: None, has_pickles, is_done })?;
    Ok(())
}

fn outcome_of(records: &[SceneRecord]) -> Outcome {
    let counts = Counts::of(records);
    match (counts.retry, counts.bad) {
        (0, 0) => Outcome::Done,
        (0, _) => Outcome::BadScenes,
        _ => Outcome::Retry,
    }
}

/// A name for an output with the suffix of a window.
fn with_suffix(name: &Path, suffix: &str) -> PathBuf {
    let mut name = name.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Name of the file of a scene in a format.
fn file_name(name: &Path, format: Format) -> PathBuf {
    // Names may hold dots, after which an extension would be replaced.
    let mut file = name.as_os_str().to_owned();
    file.push(".");
    file.push(format.ending());
    file.into()
}

/// What identifies a run: the options and the inputs.
#[derive(Serialize)]
struct Identity {
    convert: &'static str,
    standard: Option<&'static str>,
    ego: Option<&'static str>,
    reading: Option<ReadOptions>,
    scenes_per_file: Option<usize>,
    /// Hash of the names, lengths and times of all files.
    inputs: String,
    /// Files of earlier runs do not count as those of a run with --force.
    force: bool,
    program: String,
}

fn identity(args: &ConvertArgs, inputs: &Inputs) -> Identity {
    let is_scenario = args.to == Format::OpenScenario;
    let mut hasher = blake3::Hasher::new();
    for file in inputs.files() {
        let found = std::fs::metadata(womd::shard_of(file).as_deref().unwrap_or(file)).ok();
        let changed = found.as_ref().and_then(|found| found.modified().ok()?.duration_since(UNIX_EPOCH).ok());
        let described = (file, found.map(|found| found.len()), changed.map(|time| time.as_nanos()));
        hasher.update(format!("{described:?}").as_bytes());
    }
    Identity {
        convert: args.to.ending(),
        standard: is_scenario.then(|| args.standard.unwrap_or_default().name()),
        ego: is_scenario.then(|| args.ego.unwrap_or_default().name()),
        reading: output::reading_identity(args.reading.options()),
        scenes_per_file: (args.to == Format::TfRecord).then(|| args.scenes_per_file()),
        inputs: hasher.finalize().to_hex()[..16].to_owned(),
        force: args.folder.force,
        program: output::program(),
    }
}
