//! The scenes that a study measures, and their results on the disk until the report is written.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context as _, Result};
use sage_bench::runner::{SceneSource, Store};
use sage_core::{files, scene::SceneData};
use sage_run::{
    input,
    output::{Folder, SceneRecord, State},
    progress::count,
    scenes::Scenes,
};
use serde_json::json;

use super::LIMIT;

/// Folder of the results of scenes.
pub(super) const RESULTS: &str = ".sage-rows";

/// Names of scenes in results: short, and apart where two are equal.
pub(super) fn short_names(paths: &[String]) -> Vec<String> {
    let short = |path: &String| input::scene_name(Path::new(path)).unwrap_or_else(|_| path.clone());
    let short: Vec<String> = paths.iter().map(short).collect();
    let mut counts: HashMap<&str, usize> = HashMap::new();
    short.iter().for_each(|name| *counts.entry(name).or_default() += 1);
    let apart = |(path, name): (&String, &String)| match counts[&name[..]] {
        1 => name.clone(),
        _ => sage_data::folder::name_apart(name, Path::new(path)),
    };
    paths.iter().zip(&short).map(apart).collect()
}

/// Number and hash of the names of scenes.
pub(super) fn described(names: &[String]) -> String {
    let hash = blake3::hash(json!(names).to_string().as_bytes());
    format!("{} ({})", count(names.len(), "scene"), &hash.to_hex()[..16])
}

/// Scenes with their names in results.
pub(super) struct ChosenScenes<'s> {
    scenes: &'s Scenes,
    pub(super) names: Vec<String>,
}

impl<'s> ChosenScenes<'s> {
    pub(super) fn new(scenes: &'s Scenes, all: &[String]) -> Self {
        let name = |number| all[scenes.number_in_list(number)].clone();
        Self { scenes, names: (0..scenes.len()).map(name).collect() }
    }
}

impl SceneSource<anyhow::Error> for ChosenScenes<'_> {
    fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    fn content(&self, number: usize) -> String {
        self.scenes.content(number)
    }

    fn load(&self, number: usize) -> Result<Option<Arc<SceneData>>> {
        Ok(self.scenes.load(number)?)
    }
}

/// Results of scenes in the folder of a run, a file a scene, named by its number in the whole list.
pub(super) struct StoredResults<'f> {
    pub(super) folder: &'f Folder,
    pub(super) scenes: &'f Scenes,
}

impl StoredResults<'_> {
    fn file(&self, number: usize) -> String {
        result_file(self.scenes.number_in_list(number))
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join(RESULTS)
    }
}

/// File of the result of a scene by its number in the whole list.
pub(super) fn result_file(number: usize) -> String {
    format!("{number:07}.json")
}

impl Store<anyhow::Error> for StoredResults<'_> {
    fn read(&self, number: usize) -> Option<String> {
        files::read_text(&self.path().join(self.file(number)), LIMIT).ok()
    }

    fn write(&self, texts: &[(usize, String)]) -> Result<()> {
        let named: Vec<(String, &[u8])> =
            texts.iter().map(|(number, text)| (self.file(*number), text.as_bytes())).collect();
        files::write_all(&self.path(), named.iter().map(|(name, bytes)| (&name[..], *bytes)))
            .or_else(|(path, error)| Err(error).with_context(|| format!("cannot write `{}`", path.display())))
    }
}

/// What became of the scenes with some numbers. A scene that cannot be read is known by its path.
pub(super) fn records(
    scenes: &Scenes,
    numbers: &[usize],
    paths: &[String],
    names: &[String],
) -> Vec<SceneRecord> {
    let record = |number: &usize| {
        let name = &names[*number];
        let failed = scenes.failure(name).or_else(|| scenes.failure(&paths[*number]));
        match (failed, scenes.not_kept().get(number)) {
            (Some(failed), _) => {
                let state = if failed.may_pass { State::Retry } else { State::Bad };
                SceneRecord::new(name, state, failed.reason)
            }
            (None, Some(reason)) => SceneRecord::new(name, State::LeftOut, reason.clone()),
            (None, None) => SceneRecord::new(name, State::Done, String::new()),
        }
    };
    numbers.iter().map(record).collect()
}
