//! Many scenes in memory.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use sage_backbones::training::SceneData;
use sage_data::{
    Recording, folder,
    procedural::{self, Kind},
};

use crate::progress::Progress;

/// Reads all scenes under some paths, in parallel, in the order of the files.
///
/// *Errors*: the first file that is no scene.
pub(crate) fn read_all(paths: &[PathBuf]) -> Result<Vec<SceneData>> {
    let mut files = Vec::new();
    for path in paths {
        files.extend(folder::scene_files(path)?);
    }
    let mut progress = Progress::new("read", files.len());
    let mut scenes = Vec::with_capacity(files.len());
    folder::in_order(
        &files,
        |file| {
            Recording::read(file).map(|recording| SceneData::new(file.display().to_string(), recording.scene))
        },
        |_, scene| {
            scenes.push(scene?);
            progress.step();
            Ok::<(), anyhow::Error>(())
        },
    )?;
    progress.finish(&format!("read {} scenes", scenes.len()));
    Ok(scenes)
}

/// Makes scenes of all kinds in turn. A number that gives no scene is passed over.
pub(crate) fn make(count: u64, seed: u64) -> Vec<SceneData> {
    use rayon::prelude::*;
    let made = |number: u64| {
        let kind = Kind::ALL[(number % Kind::ALL.len() as u64) as usize];
        let scene = procedural::generate(kind, seed, number)?;
        Some(SceneData::new(scene.id.clone(), scene))
    };
    (0..count).into_par_iter().filter_map(made).collect()
}

/// Scenes under some paths, only those whose file names a split of a splits file lists, if one is given.
///
/// *Errors*: as [`read_all`]; no such split, or none of its scenes there.
pub(crate) fn read_split(
    paths: &[PathBuf],
    splits: Option<&Path>,
    split: Option<&str>,
) -> Result<Vec<SceneData>> {
    let (Some(splits), Some(split)) = (splits, split) else { return read_all(paths) };
    let known = sage_data::split::read_splits(splits)?;
    let Some(names) = known.get(split) else {
        let all: Vec<&str> = known.keys().map(String::as_str).collect();
        bail!("`{}` has no split `{split}`; known: {}", splits.display(), all.join(", "));
    };
    let mut files = Vec::new();
    for path in paths {
        files.extend(folder::scene_files(path)?);
    }
    files.retain(|file| file.file_stem().is_some_and(|stem| names.iter().any(|n| stem == n.as_str())));
    if files.is_empty() {
        bail!("none of the scenes of split `{split}` is there");
    }
    read_all(&files)
}

/// Number of scenes and a hash of what they show, order included.
pub(crate) fn describe(scenes: &[SceneData]) -> String {
    let mut hasher = blake3::Hasher::new();
    for data in scenes {
        hasher.update(&data.scene.content_hash());
    }
    format!("{} scenes ({})", scenes.len(), &hasher.finalize().to_hex()[..16])
}
