//! Results of many scenes, a file for each window of them, so that an interrupted run resumes.

use anyhow::Result;
use sage_core::{files, scene::SceneData};
use serde::{Serialize, de::DeserializeOwned};

use crate::{output::Run, scenes::Scenes};

/// Folder of the results from which an interrupted run resumes.
pub(crate) const RESULTS: &str = ".sage-rows";
/// Scenes per file of results.
const WINDOW: usize = 16;
/// Size limit of a file of results, bytes.
const RESULTS_LIMIT: u64 = 256 << 20;

/// The result of one scene.
pub(crate) trait SceneOutcome: Serialize + DeserializeOwned + Send {
    /// Name of the scene.
    fn scene(&self) -> &str;
}

/// Results of all scenes in their order: those of an interrupted run for which `fits` holds, the others by `one`.
/// Calls `done` after each scene.
///
/// *Errors*: a scene cannot be read, `one` fails, or the folder cannot be written to.
pub(crate) fn results<T: SceneOutcome>(
    run: &Run,
    scenes: &Scenes,
    fits: impl Fn(&T) -> bool,
    one: impl Fn(&SceneData) -> Result<T> + Sync,
    mut done: impl FnMut(),
) -> Result<Vec<T>> {
    let folder = run.folder().inner(RESULTS.as_ref())?;
    let mut all = Vec::with_capacity(scenes.len());
    for (number, window) in scenes.windows(WINDOW).enumerate() {
        let file = folder.join(format!("{number:06}.json"));
        let before = files::read_text(&file, RESULTS_LIMIT).ok();
        let before = before.and_then(|text| serde_json::from_str::<Vec<T>>(&text).ok());
        let is_whole = |before: &Vec<T>| {
            before.iter().map(SceneOutcome::scene).eq(window.names()) && before.iter().all(&fits)
        };
        if let Some(before) = before.filter(is_whole) {
            before.iter().for_each(|_| done());
            all.extend(before);
            continue;
        }
        let results = window.map_each(&one, &mut done)?;
        let name = file.strip_prefix(run.folder().path()).unwrap_or(&file).display().to_string();
        run.folder().write(&name, serde_json::to_string(&results)?.as_bytes())?;
        all.extend(results);
    }
    Ok(all)
}
