//! Runs a plan over scenes in parallel, and stores the result of each scene, so that an interrupted run resumes.

use std::sync::Arc;

use rayon::prelude::*;
use sage_core::{
    defect::{self, Defect},
    scene::SceneData,
};
use serde::{Deserialize, Serialize};

use crate::{Error, Result, measure::SceneResult, prepared_study::PreparedStudy, rows::Results};

/// Scenes that are measured in parallel before their results are stored in order.
const WINDOW: usize = 16;

/// A list of scenes, each read when it is needed; `E` is the error of the caller.
pub trait SceneSource<E>: Sync {
    /// Names of the scenes.
    fn names(&self) -> Vec<String>;

    /// Hash of the content of a scene. A stored result counts only for this content.
    fn content(&self, number: usize) -> String;

    /// Reads a scene; `None` if its number gives none.
    ///
    /// *Errors*: it cannot be read.
    fn load(&self, number: usize) -> Result<Option<Arc<SceneData>>, E>;
}

/// Keeps the results of scenes until a run is done.
pub trait Store<E>: Sync {
    /// The stored text of a scene.
    fn read(&self, number: usize) -> Option<String>;

    /// Stores the texts of some scenes, each whole or not at all.
    ///
    /// *Errors*: one cannot be written.
    fn write(&self, texts: &[(usize, String)]) -> Result<(), E>;
}

/// Follows a run.
pub trait Observer<E> {
    /// A scene is done; `before` if an earlier run did it.
    fn done(&mut self, before: bool);

    /// A scene, or some results in it, failed.
    fn failed(&mut self, scene: &str, what: &str, error: &E);

    /// Nothing can be measured for some results in a scene.
    fn left_out(&mut self, scene: &str, reason: &str);
}

/// The stored result of a scene.
#[derive(Serialize, Deserialize)]
struct Stored {
    scene: String,
    content: String,
    result: SceneResult,
}

/// What became of a scene.
enum Measured<E> {
    /// An earlier run measured it.
    Known(Stored),
    New(Stored),
    /// It cannot be read.
    Failed(E),
    /// Its number gives no scene.
    None,
}

/// Measures all scenes. A scene that cannot be read is told to the observer and left out.
///
/// *Errors*: a result cannot be stored.
pub fn run<E: From<Error> + From<Defect> + Send>(
    prepared: &PreparedStudy,
    scenes: &dyn SceneSource<E>,
    store: &dyn Store<E>,
    observer: &mut dyn Observer<E>,
) -> Result<Results, E> {
    let names = scenes.names();
    let mut results = Results {
        study: prepared.study.study.clone(),
        keys: prepared.keys.clone(),
        metrics: prepared.metrics.clone(),
        ..Results::default()
    };
    let known = |number: usize| -> Option<Stored> {
        let stored: Stored = serde_json::from_str(&store.read(number)?).ok()?;
        let is_current = stored.scene == names[number] && stored.content == scenes.content(number);
        is_current.then_some(stored)
    };
    let measured = |number: usize| -> Measured<E> {
        if let Some(stored) = known(number) {
            return Measured::Known(stored);
        }
        let (scene, content) = (names[number].clone(), scenes.content(number));
        let loaded = || scenes.load(number);
        // A defect that one scene brings about costs that scene.
        let measured = defect::caught(|| Ok(loaded()?.map(|data| prepared.measure(&data))));
        match measured.unwrap_or_else(|defect| Err(defect.into())) {
            Ok(Some(result)) => Measured::New(Stored { scene, content, result }),
            Ok(None) => Measured::None,
            // Not stored: the next run may be able to read it.
            Err(error) => Measured::Failed(error),
        }
    };
    for start in (0..names.len()).step_by(WINDOW) {
        let end = names.len().min(start + WINDOW);
        let window: Vec<Measured<E>> = (start..end).into_par_iter().with_max_len(1).map(measured).collect();
        let new = window.iter().enumerate().filter_map(|(k, measured)| match measured {
            Measured::New(stored) => Some(serde_json::to_string(stored).map(|text| (start + k, text))),
            _ => None,
        });
        store.write(&new.collect::<Result<Vec<_>, _>>().map_err(Error::from)?)?;
        for (k, measured) in window.into_iter().enumerate() {
            let is_known = matches!(measured, Measured::Known(_));
            let stored = match measured {
                Measured::Known(stored) | Measured::New(stored) => stored,
                Measured::Failed(error) => {
                    observer.done(false);
                    observer.failed(&names[start + k], "", &error);
                    continue;
                }
                Measured::None => continue,
            };
            observer.done(is_known);
            let Stored { scene, result: SceneResult { cells, left_out }, .. } = stored;
            left_out.iter().for_each(|reason| observer.left_out(&scene, reason));
            // One line for each different reason.
            let mut told: Vec<&str> = Vec::new();
            for cell in cells.iter().filter(|cell| !cell.error.is_empty()) {
                if !told.contains(&&*cell.error) {
                    told.push(&cell.error);
                    let error = Error::Value(cell.error.clone()).into();
                    observer.failed(&scene, prepared.keys[cell.key].stream().trim_end(), &error);
                }
            }
            results.scenes.push(scene);
            results.cells.push(cells);
        }
    }
    Ok(results)
}
