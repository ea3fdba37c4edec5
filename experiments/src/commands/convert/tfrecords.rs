//! TFRecord files of the Waymo Open Motion Dataset.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use sage_core::files::{self, Existing};
use sage_data::{
    repairs,
    stream::{Inputs, Item, map_in_order},
    womd::{self, EncodedScenario},
};
use sage_run::{
    outcome::may_succeed_later,
    output::{DatasetRun, Extent, SceneRecord, State},
    progress::Progress,
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Tally;
use crate::cli::ConvertArgs;

/// Start of the names of the files.
const NAME: &str = "scenes";
/// Table of the ids that are no integers.
const IDS: &str = "ids.json";
/// Folder of what an interrupted run knows of its finished files.
const PARTS: &str = ".sage-rows";
/// Size limit of such a file, bytes.
const PART_LIMIT: u64 = 1 << 30;

/// What is known of a finished file.
#[derive(Default, Serialize, Deserialize)]
struct FileFacts {
    /// Its name.
    file: String,
    scenes: usize,
    /// Why scenes are missing in it.
    failures: Vec<String>,
    /// Its size, bytes.
    bytes: u64,
    /// Ids by number, by the number of the record.
    ids: BTreeMap<usize, Value>,
    notes: BTreeMap<String, usize>,
}

/// Number of scenes, which the names of the files need.
///
/// *Errors*: it is not known.
pub(super) fn total(inputs: &Inputs) -> Result<usize> {
    inputs.count().context(
        "the names of TFRecord files hold the number of files, and the number of scenes in a pipe or a compressed file is not known; save or decompress it first",
    )
}

/// Names of the files of a number of scenes.
pub(super) fn files(total: usize, size: usize) -> Vec<PathBuf> {
    let count = total.div_ceil(size);
    (0..count).map(|number| format!("{NAME}.tfrecord-{number:05}-of-{count:05}").into()).collect()
}

/// Files of earlier runs in a folder, which a run with --force removes.
pub(super) fn outdated(folder: &Path) -> Vec<String> {
    let names = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect::<Vec<_>>()
    };
    let start = format!("{NAME}.tfrecord-");
    let mut outdated: Vec<String> =
        names(folder).into_iter().filter(|name| name.starts_with(&start) || name == IDS).collect();
    let parts = names(&folder.join(PARTS)).into_iter().filter(|name| name.ends_with(".json"));
    outdated.extend(parts.map(|name| format!("{PARTS}/{name}")));
    outdated
}

/// Converts all scenes into files with the same number of scenes each; a part writes its files.
///
/// *Errors*: the number of scenes is not known; a full disk.
pub(super) fn convert(
    args: &ConvertArgs,
    extent: Extent,
    inputs: &Inputs,
    run: &DatasetRun,
    progress: &mut Progress,
    tally: &mut Tally,
) -> Result<()> {
    let size = args.scenes_per_file();
    let parts = run.folder().inner(PARTS.as_ref())?;
    let (mut items, known_files) = (inputs.items(), run.known_files());
    for (number, file) in files(total(inputs)?, size).into_iter().enumerate() {
        let name = file.to_string_lossy().into_owned();
        tally.names.push(name.clone());
        if !extent.holds(&name) {
            for item in items.by_ref().take(size) {
                // The number of its scenes would be wrong, and with it the content of all further files.
                if item.problem().is_some_and(|problem| may_succeed_later(problem)) {
                    item.read(&args.reading.options())?;
                }
            }
            continue;
        }
        let path = run.folder().path().join(&name);
        let known = parts.join(format!("{number:05}.json"));
        let is_changed = || {
            let mut of_manifest = known_files.get(&name).into_iter().flatten();
            let folder = run.folder().path();
            of_manifest.any(|file| !file.holds(folder))
        };
        let found = if args.folder.force { None } else { found(&known, &path).filter(|_| !is_changed()) };
        let known = match found {
            Some(known) => {
                items.by_ref().take(size).for_each(|_| progress.step_found());
                known
            }
            None => {
                let known = write_file(args, &mut items, size, &path, progress)?;
                if known.scenes == 0 {
                    // Readers take a file without records for a damaged one.
                    run.folder().remove(&name)?;
                }
                run.folder().write(&format!("{PARTS}/{number:05}.json"), &serde_json::to_vec(&known)?)?;
                known
            }
        };
        let state = if known.failures.is_empty() { State::Done } else { State::Bad };
        let record = SceneRecord::new(&name, state, known.failures.join("; "));
        let written = (known.scenes > 0).then_some(&*name);
        tally.records.push(record.with_files(run.folder().path(), written)?);
        tally.whole += known.scenes;
        tally.failed += known.failures.len();
        tally.add_notes(known.notes);
    }
    Ok(())
}

/// Numbers of scenes in all files.
#[derive(Default)]
pub(super) struct Total {
    pub(super) scenes: usize,
    pub(super) failed: usize,
}

/// Writes the table of the ids that are no integers, and returns what is in all files of a run.
///
/// *Errors*: what a run knows of a file cannot be read.
pub(super) fn finish(run: &DatasetRun, count: usize) -> Result<Total> {
    let (mut total, mut ids) = (Total::default(), BTreeMap::new());
    run.folder().inner(PARTS.as_ref())?;
    for number in 0..count {
        let path = run.folder().path().join(PARTS).join(format!("{number:05}.json"));
        let shown = || format!("cannot read `{}`", path.display());
        let text = files::read_text(&path, PART_LIMIT).with_context(shown)?;
        let facts: FileFacts = serde_json::from_str(&text).with_context(shown)?;
        total.scenes += facts.scenes;
        total.failed += facts.failures.len();
        ids.extend(facts.ids.into_iter().map(|(record, ids)| (format!("{}#{record}", facts.file), ids)));
    }
    if !ids.is_empty() {
        run.folder().write(IDS, format!("{:#}\n", serde_json::to_value(&ids)?).as_bytes())?;
    }
    Ok(total)
}

/// What is known of a file that an earlier run finished.
fn found(known: &Path, file: &Path) -> Option<FileFacts> {
    let text = files::read_text(known, PART_LIMIT).ok()?;
    let size = std::fs::metadata(file).map_or(0, |found| found.len());
    serde_json::from_str(&text).ok().filter(|facts: &FileFacts| facts.bytes == size)
}

/// Writes the next scenes into a file.
fn write_file(
    args: &ConvertArgs,
    items: &mut (impl Iterator<Item = Item> + Send),
    size: usize,
    path: &Path,
    progress: &mut Progress,
) -> Result<FileFacts> {
    let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut facts = FileFacts { file, ..FileFacts::default() };
    let mut stopped = None;
    let encode = |item: Item| {
        item.read_and(&args.reading.options(), |recording| {
            let mut encoded = recording.to_scenario()?;
            encoded.notes.extend(repairs::notes_of(&recording).map(|note| (note, 1)));
            Ok(encoded)
        })
    };
    let written = files::write_with(path, Existing::Replace, |out| {
        map_in_order(items.take(size), Item::size, encode, |encoded| {
            progress.step();
            match encoded {
                Ok(EncodedScenario { data, ids, notes }) => {
                    facts.bytes += womd::write_frame(out, &data)?;
                    facts.ids.extend(ids.map(|ids| (facts.scenes, ids)));
                    facts.scenes += 1;
                    for (note, count) in notes {
                        *facts.notes.entry(note).or_default() += count;
                    }
                }
                // Stored as missing it would stay so; the next run reads it again.
                Err(error) if may_succeed_later(&error) => {
                    stopped = Some(error);
                    return Err(std::io::ErrorKind::Other.into());
                }
                Err(error) => {
                    let error = format!("{:#}", anyhow::Error::from(error));
                    progress.say(&format!("error: {error}"));
                    facts.failures.push(error);
                }
            }
            Ok(())
        })
    });
    if let Some(error) = stopped {
        return Err(error.into());
    }
    written.with_context(|| format!("cannot write `{}`", path.display()))?;
    Ok(facts)
}
