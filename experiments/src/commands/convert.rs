//! `sage convert`: converts scenes between formats, in parallel and in order.

mod scenes;
mod shards;

use std::{
    collections::{BTreeMap, HashSet},
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Result, bail};
use sage_data::stream::Inputs;
use serde_json::{Value, json};

use crate::{
    Outcome,
    cli::{ConvertArgs, ConvertFormat},
    output::{self, DatasetRun},
    progress::{self, Progress, count},
};

/// Notes that are printed. Those of an OpenSCENARIO file are also in its map.
const MOST_NOTES: usize = 12;

/// What a run has done.
#[derive(Default)]
struct Tally {
    /// Scenes that are converted, by this run or an earlier one.
    whole: usize,
    failed: usize,
    /// What could not be kept, and how often.
    notes: BTreeMap<String, usize>,
}

impl Tally {
    fn add_notes(&mut self, notes: impl IntoIterator<Item = String>) {
        for note in notes {
            *self.notes.entry(note).or_default() += 1;
        }
    }
}

pub(crate) fn run(args: &ConvertArgs) -> Result<Outcome> {
    let clock = Instant::now();
    args.check()?;
    let inputs = Inputs::under(&args.paths)?;
    let names: Vec<PathBuf> = inputs.names().collect();
    let distinct: HashSet<&PathBuf> = names.iter().collect();
    if distinct.len() < names.len() {
        bail!("several inputs would become one file; convert them into separate folders");
    }
    if args.to == ConvertFormat::Womd {
        shards::total(&inputs)?;
    }
    let out = &args.folder.out;
    let files: Vec<PathBuf> = inputs.files().map(Path::to_owned).collect();
    let outputs: Vec<PathBuf> = names.iter().map(|name| name.with_extension(ending(args.to))).collect();
    output::protect_inputs(&args.paths, &files, out, &outputs)?;
    let run = DatasetRun::start(out, identity(args, &inputs), args.folder.force, args.shard, Vec::new)?;
    let mut progress = Progress::new("converted", inputs.count().filter(|_| args.shard.is_none()));
    let mut tally = Tally::default();
    let outcome = match args.to {
        ConvertFormat::Womd => shards::convert(args, &inputs, &run, &mut progress, &mut tally),
        _ => scenes::convert(args, &inputs, &run, &mut progress, &mut tally),
    };
    let Tally { whole, failed, notes } = tally;
    if let Err(error) = outcome {
        let sum = format!("{} converted in `{}`", count(whole, "scene"), out.display());
        return Err(match output::is_disk_full(&error) {
            true => {
                error.context(format!("the disk is full; {sum}; free space and run the same command again"))
            }
            false => error.context(sum),
        });
    }
    for (note, count) in notes.iter().take(MOST_NOTES) {
        let scenes = if *count > 1 { format!(" ({count} scenes)") } else { String::new() };
        progress.say(&format!("note: {note}{scenes}"));
    }
    if notes.len() > MOST_NOTES {
        progress.say(&format!("note: and {} more of this kind", notes.len() - MOST_NOTES));
    }
    let results = || json!({"scenes": whole, "failed": failed});
    let seconds = |_: &Value| (failed == 0 && args.shard.is_none()).then(|| clock.elapsed().as_secs_f64());
    run.finish(args.to == ConvertFormat::Pickle, results, None, seconds)?;
    progress.finish(&format!("{} in `{}`, {failed} failed", count(whole, "scene"), out.display()));
    if let Some(shard) = args.shard {
        progress::say(&format!("note: this is part {} of {}", shard.number, shard.of));
    }
    Ok(if failed > 0 { Outcome::Partial } else { Outcome::Done })
}

/// Ending of the files of a format.
fn ending(format: ConvertFormat) -> &'static str {
    match format {
        ConvertFormat::Native => "safetensors",
        ConvertFormat::Pickle => "pkl",
        ConvertFormat::Womd => "tfrecord",
        ConvertFormat::Openscenario => "xosc",
    }
}

/// What identifies a run: the options and the inputs. A run with --force is another one, because files of earlier runs
/// do not count as its own.
fn identity(args: &ConvertArgs, inputs: &Inputs) -> Value {
    let size = |file: &Path| std::fs::metadata(file).map_or(0, |found| found.len());
    let is_scenario = args.to == ConvertFormat::Openscenario;
    json!({
        "convert": ending(args.to),
        "standard": is_scenario.then(|| args.standard.unwrap_or_default().name()),
        "ego": is_scenario.then(|| args.ego.unwrap_or_default().name()),
        "shard_size": (args.to == ConvertFormat::Womd).then(|| args.shard_size()),
        "paths": args.paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
        "files": inputs.files().count(),
        "bytes": inputs.files().map(size).sum::<u64>(),
        "keep_going": args.keep_going,
        "force": args.folder.force,
        "program": output::program(),
    })
}
