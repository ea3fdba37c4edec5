//! Runs a plan over scenes: in parallel, window by window, so that an interrupted run resumes.

use std::sync::Arc;

use anyhow::{Result, bail};
use rayon::prelude::*;
use sage_core::scene::SceneData;
use serde::{Deserialize, Serialize};

use crate::{measure::SceneResult, plan::Plan, rows::Results};

/// Scenes per stored window.
const WINDOW: usize = 16;

/// A list of scenes, each read when it is needed.
pub trait SceneSource: Sync {
    /// Names of the scenes.
    fn names(&self) -> Vec<String>;

    /// Reads a scene; `None` if its number gives none.
    ///
    /// *Errors*: it cannot be read.
    fn load(&self, number: usize) -> Result<Option<Arc<SceneData>>>;
}

/// Keeps the results of windows until a run is done.
pub trait Store {
    /// The stored text of a window.
    fn read(&self, window: usize) -> Option<String>;

    /// Stores the text of a window, whole or not at all.
    ///
    /// *Errors*: it cannot be written.
    fn write(&self, window: usize, text: &str) -> Result<()>;
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
    result: Option<SceneResult>,
    /// Why there is no result.
    error: String,
}

/// Measures all scenes. A scene that cannot be read is told to the observer and left out.
///
/// *Errors*: a window cannot be stored; every scene fails.
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
    for (number, window) in names.chunks(WINDOW).enumerate() {
        let known = store.read(number).and_then(|text| serde_json::from_str::<Vec<Stored>>(&text).ok());
        let is_whole = |known: &Vec<Stored>| {
            known.len() == window.len()
                && known.iter().zip(window).all(|(stored, name)| stored.scene == *name)
        };
        let known = known.filter(is_whole);
        let before = known.is_some();
        let all = match known {
            Some(known) => known,
            None => {
                let one = |(k, name): (usize, &String)| -> Option<Stored> {
                    let (scene, number) = (name.clone(), number * WINDOW + k);
                    match scenes.load(number) {
                        Ok(data) => {
                            let result = plan.measure(&*data?);
                            Some(Stored { scene, result: Some(result), error: String::new() })
                        }
                        Err(error) => Some(Stored { scene, result: None, error: format!("{error:#}") }),
                    }
                };
                let all: Vec<Option<Stored>> =
                    window.par_iter().with_max_len(1).enumerate().map(one).collect();
                let all: Vec<Stored> = all.into_iter().flatten().collect();
                store.write(number, &serde_json::to_string(&all)?)?;
                all
            }
        };
        for Stored { scene, result, error } in all {
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
    let has_values = results.cells.iter().flatten().any(|cell| cell.error.is_empty());
    if !has_values {
        bail!("nothing could be measured in any of {} scenes", names.len());
    }
    Ok(results)
}
