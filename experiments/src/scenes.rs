//! Many scenes in memory.

use std::path::PathBuf;

use anyhow::Result;
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
