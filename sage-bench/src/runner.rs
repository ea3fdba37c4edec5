//! Runs a plan over scenes in parallel, and stores the result of each scene, so that an interrupted run resumes.

use std::sync::Arc;

use anyhow::Result;
use rayon::prelude::*;
use sage_core::scene::SceneData;
use serde::{Deserialize, Serialize};

use crate::{measure::SceneResult, plan::Plan, rows::Results};

/// Scenes that are measured in parallel before their results are stored in order.
const WINDOW: usize = 16;

/// A list of scenes, each read when it is needed.
pub trait SceneSource: Sync {
    /// Names of the scenes.
    fn names(&self) -> Vec<String>;

    /// Hash of the content of a scene. A stored result counts only for this content.
    fn content(&self, number: usize) -> String;

    /// Reads a scene; `None` if its number gives none.
    ///
    /// *Errors*: it cannot be read.
    fn load(&self, number: usize) -> Result<Option<Arc<SceneData>>>;
}

/// Keeps the results of scenes until a run is done.
pub trait Store {
    /// The stored text of a scene.
    fn read(&self, number: usize) -> Option<String>;

    /// Stores the texts of some scenes, each whole or not at all.
    ///
    /// *Errors*: one cannot be written.
    fn write(&self, texts: &[(usize, String)]) -> Result<()>;
}

/// Follows a run.
pub trait Observer {
    /// A scene is done; `before` if an earlier run did it.
    fn done(&mut self, before: bool);

    /// A scene, or some results in it, failed.
    fn failed(&mut self, scene: &str, what: &str, error: &str);

    /// Nothing can be measured for some results in a scene.
    fn left_out(&mut self, scene: &str, reason: &str);
}

/// The stored result of a scene.
#[derive(Serialize, Deserialize)]
struct Stored {
    scene: String,
    content: String,
    result: Option<SceneResult>,
    /// Why there is no result.
    error: String,
}

/// Measures all scenes. A scene that cannot be read is told to the observer and left out.
///
/// *Errors*: a result cannot be stored.
pub fn run(
    plan: &Plan,
    scenes: &dyn SceneSource,
    store: &dyn Store,
    observer: &mut dyn Observer,
) -> Result<Results> {
    let names = scenes.names();
    let mut results = Results {
        study: plan.study.study.clone(),
        keys: plan.keys.clone(),
        metrics: plan.metrics.clone(),
        ..Results::default()
    };
    let known = |number: usize| -> Option<Stored> {
        let stored: Stored = serde_json::from_str(&store.read(number)?).ok()?;
        let is_current = stored.scene == names[number] && stored.content == scenes.content(number);
        is_current.then_some(stored)
    };
    let measured = |number: usize| -> Option<Stored> {
        let (scene, content) = (names[number].clone(), scenes.content(number));
        match scenes.load(number) {
            Ok(data) => {
                let result = plan.measure(&*data?);
                Some(Stored { scene, content, result: Some(result), error: String::new() })
            }
            Err(error) => Some(Stored { scene, content, result: None, error: format!("{error:#}") }),
        }
    };
    for start in (0..names.len()).step_by(WINDOW) {
        let mut window: Vec<(Option<Stored>, bool)> = (start..names.len().min(start + WINDOW))
            .map(|number| known(number).map_or((None, false), |stored| (Some(stored), true)))
            .collect();
        window
            .par_iter_mut()
            .with_max_len(1)
            .enumerate()
            .filter(|(_, (_, before))| !before)
            .for_each(|(k, (stored, _))| *stored = measured(start + k));
        let texts = window.iter().enumerate().filter_map(|(k, (stored, before))| {
            // What could not be read now may be readable in the next run.
            let new = stored.as_ref().filter(|stored| !before && stored.result.is_some());
            let text = new.map(serde_json::to_string)?;
            Some(text.map(|text| (start + k, text)))
        });
        store.write(&texts.collect::<Result<Vec<_>, _>>()?)?;
        for (stored, before) in window {
            let Some(Stored { scene, result, error, .. }) = stored else { continue };
            observer.done(before);
            let Some(SceneResult { cells, left_out }) = result else {
                observer.failed(&scene, "", &error);
                continue;
            };
            left_out.iter().for_each(|reason| observer.left_out(&scene, reason));
            // One line for each different reason.
            let mut told: Vec<&str> = Vec::new();
            for cell in cells.iter().filter(|cell| !cell.error.is_empty()) {
                if !told.contains(&&*cell.error) {
                    told.push(&cell.error);
                    observer.failed(&scene, plan.keys[cell.key].stream().trim_end(), &cell.error);
                }
            }
            results.scenes.push(scene);
            results.cells.push(cells);
        }
    }
    Ok(results)
}
