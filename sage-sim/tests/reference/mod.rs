//! Reference files outside the project: `SAGE_REFERENCE` and `SAGE_DATA` name their folders. Tests without
//! them say so and pass.

#![allow(dead_code, clippy::unwrap_used, clippy::print_stderr)] // Each test uses some of it.

use std::{env, fs, path::PathBuf};

use serde_json::Value;

/// A JSON fixture, or `None` without `SAGE_REFERENCE`.
pub fn json(name: &str) -> Option<Value> {
    let Ok(folder) = env::var("SAGE_REFERENCE") else {
        eprintln!("left out: SAGE_REFERENCE is not set");
        return None;
    };
    let path = PathBuf::from(folder).join("fixtures").join(name);
    let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    Some(serde_json::from_str(&text).unwrap())
}

/// A recorded scene by its number, or `None` without `SAGE_DATA`.
pub fn scene(number: u64) -> Option<std::sync::Arc<sage_core::scene::Scene>> {
    let Ok(folder) = env::var("SAGE_DATA") else {
        eprintln!("left out: SAGE_DATA is not set");
        return None;
    };
    let folder = PathBuf::from(folder);
    let mut files =
        ["pretrain", "dev", "val"].map(|split| folder.join(split).join(format!("{number}.pkl"))).into_iter();
    let file = files
        .find(|file| file.is_file())
        .unwrap_or_else(|| panic!("no scene {number} in {}", folder.display()));
    Some(std::sync::Arc::new(sage_data::Recording::read(&file).unwrap().scene))
}

/// All recorded scenes of some splits; none without `SAGE_DATA`.
pub fn scenes(splits: &[&str]) -> Vec<std::sync::Arc<sage_core::scene::Scene>> {
    let Ok(folder) = env::var("SAGE_DATA") else {
        eprintln!("recorded scenes are left out: SAGE_DATA is not set");
        return Vec::new();
    };
    let files = splits
        .iter()
        .flat_map(|split| sage_data::folder::scene_files(&PathBuf::from(&folder).join(split)).unwrap());
    files.map(|file| std::sync::Arc::new(sage_data::Recording::read(&file).unwrap().scene)).collect()
}
