//! Shards of the Waymo Open Motion Dataset.

use std::{collections::BTreeMap, io, path::Path};

use anyhow::{Context as _, Result};
use sage_core::files::{self, Existing};
use sage_data::{
    stream::{Inputs, Item, map_in_order},
    womd::{self, EncodedScenario},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Tally;
use crate::{cli::ConvertArgs, output::DatasetRun, progress::Progress};

/// Name of the shards.
const NAME: &str = "scenes";
/// Table of the ids that are no integers.
const IDS: &str = "ids.json";
/// Folder of what an interrupted run knows of its finished shards.
const PARTS: &str = ".sage-rows";
/// Size limit of such a file, bytes.
const PART_LIMIT: u64 = 1 << 30;

/// What is known of a finished shard.
#[derive(Default, Serialize, Deserialize)]
struct Part {
    scenes: usize,
    failed: usize,
    /// Ids by number, by the path of the scene.
    ids: BTreeMap<String, Value>,
    notes: BTreeMap<String, usize>,
}

/// Number of scenes, which the names of shards need.
///
/// *Errors*: it is not known.
pub(super) fn total(inputs: &Inputs) -> Result<usize> {
    inputs.count().context(
        "the names of shards hold the number of shards, and the number of scenes in a pipe or a compressed shard is not known; save or decompress it first",
    )
}

/// Converts all scenes into shards with the same number of scenes each.
///
/// *Errors*: the number of scenes is not known; a record that cannot be read, without --keep-going; a full disk.
pub(super) fn convert(
    args: &ConvertArgs,
    inputs: &Inputs,
    run: &DatasetRun,
    progress: &mut Progress,
    tally: &mut Tally,
) -> Result<()> {
    let total = total(inputs)?;
    let size = args.shard_size();
    let shards = total.div_ceil(size);
    let parts = run.folder().inner(PARTS.as_ref())?;
    let mut items = inputs.items();
    let mut ids = BTreeMap::new();
    for number in 0..shards {
        let name = format!("{NAME}.tfrecord-{number:05}-of-{shards:05}");
        let known = parts.join(format!("{number:05}.json"));
        let found = if args.folder.force { None } else { found(&known, &run.folder().path().join(&name)) };
        let part = match found {
            Some(part) => {
                items.by_ref().take(size).for_each(|_| progress.step_found());
                part
            }
            None => {
                let part = write_shard(args, &mut items, size, &run.folder().path().join(&name), progress)?;
                run.folder().write(&format!("{PARTS}/{number:05}.json"), &serde_json::to_vec(&part)?)?;
                part
            }
        };
        tally.whole += part.scenes;
        tally.failed += part.failed;
        for (note, count) in part.notes {
            *tally.notes.entry(note).or_default() += count;
        }
        ids.extend(part.ids);
    }
    if !ids.is_empty() {
        run.folder().write(IDS, format!("{:#}\n", serde_json::to_value(&ids)?).as_bytes())?;
    }
    Ok(())
}

/// What is known of a shard that an earlier run finished.
fn found(known: &Path, shard: &Path) -> Option<Part> {
    let text = files::read_text(known, PART_LIMIT).ok()?;
    serde_json::from_str(&text).ok().filter(|_| shard.is_file())
}

/// Writes the next scenes into a shard.
fn write_shard(
    args: &ConvertArgs,
    items: &mut (impl Iterator<Item = Item> + Send),
    size: usize,
    path: &Path,
    progress: &mut Progress,
) -> Result<Part> {
    let mut part = Part::default();
    let mut stopped = None;
    let encode = |item: Item| {
        let (path, is_record) = (item.path().display().to_string(), item.is_record());
        let encoded = item.read().and_then(|recording| recording.to_scenario());
        (path, is_record, encoded.map(|encoded| (womd::frame(&encoded.data), encoded)))
    };
    let written = files::write_with(path, Existing::Replace, |out| {
        map_in_order(items.take(size), Item::size, encode, |(path, is_record, encoded)| {
            progress.step();
            match encoded {
                Ok((framed, EncodedScenario { ids, notes, .. })) => {
                    out.write_all(&framed)?;
                    part.scenes += 1;
                    part.ids.extend(ids.map(|ids| (path, ids)));
                    for note in notes {
                        *part.notes.entry(note).or_default() += 1;
                    }
                }
                Err(error) if is_record && !args.keep_going => {
                    stopped = Some(anyhow::Error::from(error));
                    // Only ends the shard, which is then not renamed to its final name.
                    return Err(io::ErrorKind::InvalidData.into());
                }
                Err(error) => {
                    part.failed += 1;
                    progress.say(&format!("error: {:#}", anyhow::Error::from(error)));
                }
            }
            Ok(())
        })
    });
    if let Some(error) = stopped {
        return Err(error.context("a record cannot be converted; --keep-going skips it"));
    }
    written.with_context(|| format!("cannot write `{}`", path.display()))?;
    Ok(part)
}
