//! Many scenes in memory.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, bail};
use sage_backbones::training::SceneData;
use sage_core::{
    motion::NOW,
    objective::{Context, ContextOptions},
};
use sage_data::{
    Recording, folder,
    procedural::{self, Kind},
};

use crate::{
    cli::SplitArgs,
    progress::{self, Progress},
};

/// Reads all scenes under some paths, in parallel, in the order of the files.
///
/// *Errors*: the first file that is no scene.
pub(crate) fn read_all(paths: &[PathBuf]) -> Result<Vec<SceneData>> {
    let mut files = Vec::new();
    for path in paths {
        files.extend(folder::scene_files(path)?);
    }
    // A file named twice is one scene.
    let mut seen = HashSet::new();
    files.retain(|file| seen.insert(file.canonicalize().unwrap_or_else(|_| file.clone())));
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

/// Scenes under some paths, of which a splits file or names may take some; without any path, made ones.
///
/// *Errors*: as [`read_all`]; no such split, or a scene that is not there.
pub(crate) fn read(paths: &[PathBuf], split: &SplitArgs, made: u64, seed: u64) -> Result<Vec<SceneData>> {
    if paths.is_empty() {
        if split.splits.is_some() || !split.scenes.is_empty() {
            bail!("--splits and --scenes choose among recorded scenes; name their folder");
        }
        return Ok(make(made, seed));
    }
    if split.splits.is_none() && split.scenes.is_empty() {
        return read_all(paths);
    }
    let mut files = Vec::new();
    for path in paths {
        files.extend(folder::scene_files(path)?);
    }
    let is_named = |file: &Path, name: &String| file.file_stem().is_some_and(|stem| stem == name.as_str());
    let among = |names: &[String], file: &Path| names.iter().any(|name| is_named(file, name));
    if let Some(missing) = split.scenes.iter().find(|name| !files.iter().any(|file| is_named(file, name))) {
        bail!("no scene `{missing}` among the {} given", files.len());
    }
    if let Some(file) = &split.splits {
        if split.split.is_none() && split.without_split.is_none() {
            bail!("--splits needs --split or --without-split to say which scenes count");
        }
        let with = names_in(file, split.split.as_deref())?;
        let without = names_in(file, split.without_split.as_deref())?;
        files.retain(|file| {
            with.as_ref().is_none_or(|names| among(names, file))
                && !without.as_ref().is_some_and(|names| among(names, file))
        });
    }
    if !split.scenes.is_empty() {
        files.retain(|file| among(&split.scenes, file));
    }
    if files.is_empty() {
        bail!("none of the scenes that --splits and --scenes leave is there");
    }
    read_all(&files)
}

/// The scenes of a split, if one is named.
///
/// *Errors*: the file cannot be read or does not know it.
fn names_in(file: &Path, split: Option<&str>) -> Result<Option<Vec<String>>> {
    let Some(split) = split else { return Ok(None) };
    let mut known = sage_data::split::read_splits(file)?;
    let all = known.keys().cloned().collect::<Vec<_>>().join(", ");
    let found = known.remove(split);
    found.with_context(|| format!("`{}` has no split `{split}`; known: {all}", file.display())).map(Some)
}

/// Those of the scenes that have an adversary in sight and an ego path; says how many have not.
///
/// *Errors*: none has.
pub(crate) fn attackable(mut scenes: Vec<SceneData>) -> Result<Vec<SceneData>> {
    let all = scenes.len();
    scenes.retain(|data| {
        data.scene.adversary().is_ok_and(|adversary| adversary.is_valid(NOW))
            && Context::new(&data.scene, &data.index, &ContextOptions::default()).is_ok()
    });
    if scenes.len() < all {
        progress::say(&format!(
            "note: {} of {all} scenes have no adversary in sight at frame {NOW} or no ego path, and are left out",
            all - scenes.len()
        ));
    }
    if scenes.is_empty() {
        bail!("none of {all} scenes has an adversary in sight at frame {NOW} and an ego path");
    }
    Ok(scenes)
}

/// Number of scenes and a hash of what they show, order included.
pub(crate) fn describe(scenes: &[SceneData]) -> String {
    let mut hasher = blake3::Hasher::new();
    for data in scenes {
        hasher.update(&data.scene.content_hash());
    }
    format!("{} scenes ({})", scenes.len(), &hasher.finalize().to_hex()[..16])
}
