//! What a search has found, read from its folder.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail, ensure};
use sage_core::{
    files,
    geometry::OrientedBox,
    motion::Trajectory,
    objective::{Candidate, Context, ContextOptions, EgoPaths, PartSpec},
    scene::{Scene, SceneIndex},
};
use sage_data::Recording;
use sage_sim::search::{Clauses, Features, Met, SearchOptions, suite::MOST_TESTS};
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::{Map, Value};

use super::{SceneRow, failure_name, row_file, unchanged_file};
use crate::{
    output::{self, RECORD},
    progress,
    scene_queue::{ROW_LIMIT, is_row_of},
};

/// What is wrong with a failure whose contact is nowhere on its path.
const NOT_WITHIN: &str = "its `contact` is not within its `ego_path`";

/// The folder of a search.
pub(in crate::commands) struct Found<'a> {
    pub(in crate::commands) folder: &'a Path,
    pub(in crate::commands) record: SearchRecord,
    /// Rows of all scenes that are done.
    pub(in crate::commands) rows: Vec<SceneRow>,
}

/// What other commands need of the record of a search.
#[derive(Deserialize)]
pub(in crate::commands) struct SearchRecord {
    pub(in crate::commands) search: SearchOptions,
    pub(in crate::commands) feasibility: PartSpec,
}

/// What other commands need of the row of a failure.
#[derive(Deserialize)]
pub(in crate::commands) struct FailureFile {
    pub(in crate::commands) ego: String,
    pub(in crate::commands) adversary: String,
    pub(in crate::commands) seed: u64,
    pub(in crate::commands) trajectory: Trajectory,
    pub(in crate::commands) plan: Map<String, Value>,
    pub(in crate::commands) contact: Option<Met>,
    pub(in crate::commands) clauses: Clauses,
    pub(in crate::commands) reward: f64,
    #[serde(default)]
    pub(in crate::commands) avoidable_r157: Option<bool>,
    /// Box centre and heading of the ego at frames 0 to *now*.
    #[serde(default)]
    pub(in crate::commands) ego_history: Vec<[f64; 3]>,
    /// The same at steps 1 to 80.
    pub(in crate::commands) ego_path: Vec<[f64; 3]>,
    #[serde(default)]
    pub(in crate::commands) time_to_react: Option<f64>,
    #[serde(default)]
    pub(in crate::commands) witness: Option<Vec<[f64; 3]>>,
    #[serde(flatten)]
    pub(in crate::commands) described: Map<String, Value>,
}

impl<'a> Found<'a> {
    /// Reads the record of a search and the rows of its scenes.
    ///
    /// *Errors*: it is no search, or cannot be read.
    pub(in crate::commands) fn read(folder: &'a Path) -> Result<Self> {
        Self::read_folder(folder).with_context(|| format!("`{}`", folder.display()))
    }

    fn read_folder(folder: &'a Path) -> Result<Self> {
        const NO_SEARCH: &str = "it is no output of `sage search`";
        let record: Value = json(&folder.join(RECORD)).context(NO_SEARCH)?;
        let hash = output::run_hash(&record["run"]);
        if record["seconds"].is_null() {
            progress::say(&format!("note: the search in `{}` is not complete", folder.display()));
        }
        let record: SearchRecord = serde_json::from_value(record["run"].clone()).context(NO_SEARCH)?;
        let mut rows: Vec<SceneRow> = Vec::new();
        for entry in std::fs::read_dir(folder)? {
            let name = entry?.file_name().to_string_lossy().into_owned();
            if name.ends_with(".json") && name != RECORD {
                // Rows of another run remain after --force with fewer scenes.
                let path = folder.join(&name);
                let row = if is_row_of(&path, &hash) { SceneRow::read(&path) } else { None };
                rows.extend(row.filter(|row| row_file(row.scene()) == name));
            }
        }
        rows.sort_by(|a, b| sage_data::folder::natural_order(a.scene(), b.scene()));
        for row in &rows {
            let (scene, failures) = (row.scene(), row.failures());
            ensure!(failures <= MOST_TESTS, "scene `{scene}`: its row counts {failures} failures");
        }
        Ok(Self { folder, record, rows })
    }

    /// File of the unchanged scene of a row.
    ///
    /// *Errors*: it is missing.
    pub(in crate::commands) fn unchanged(&self, row: &SceneRow) -> Result<PathBuf> {
        let file = unchanged_file(row.scene());
        let path = self.folder.join(&file);
        ensure!(path.is_file(), "`{file}` is missing; search again without --format none");
        Ok(path)
    }

    /// A failure by its number, 1 the first found.
    ///
    /// *Errors*: it cannot be read.
    pub(in crate::commands) fn failure(&self, row: &SceneRow, number: usize) -> Result<FailureFile> {
        json(&self.folder.join(row_file(&format!("{}-{}", row.scene(), failure_name(number)))))
    }
}

/// A scene in which failures are described.
pub(in crate::commands) struct FailureScene(Context);

impl FailureScene {
    /// Prepares a recording whose adversary is a track.
    ///
    /// *Errors*: the scene has no such track, or cannot be attacked.
    pub(in crate::commands) fn new(recording: &Recording, adversary: &str) -> Result<Self> {
        let scene = recording.scene.clone().with_roles(None, Some(adversary))?;
        let index = SceneIndex::new(scene.map.clone());
        Ok(Self(Context::new(&scene.into(), &index, &ContextOptions::default())?))
    }

    /// The scene with its roles.
    pub(in crate::commands) fn scene(&self) -> &Scene {
        self.0.scene()
    }

    /// Features of a failure.
    ///
    /// *Errors*: its path or its contact is not as a search writes it.
    pub(in crate::commands) fn features(&self, failure: &FailureFile) -> Result<Features> {
        let (ctx, plan) = self.driven(failure)?;
        let met = failure.contact.as_ref().context("it has no `contact`")?;
        Features::of(&ctx, &plan, met, failure.time_to_react).context(NOT_WITHIN)
    }

    /// Boxes of the ego and of the adversary at a step, 1 or later.
    ///
    /// *Errors*: as [`FailureScene::features`].
    pub(in crate::commands) fn boxes_at(
        &self,
        failure: &FailureFile,
        step: usize,
    ) -> Result<[OrientedBox; 2]> {
        let (ctx, plan) = self.driven(failure)?;
        let at = step.checked_sub(1).context(NOT_WITHIN)?;
        let own = ctx.ego().boxes().get(at).copied().flatten().context(NOT_WITHIN)?;
        Ok([own, *plan.boxes().get(at).context(NOT_WITHIN)?])
    }

    /// The scene with the path of an attacked drive, and its plan.
    fn driven(&self, failure: &FailureFile) -> Result<(Context, Candidate)> {
        let positions = failure.ego_path.iter().map(|[x, y, _]| [*x, *y]).collect();
        let headings = failure.ego_path.iter().map(|pose| pose[2]).collect();
        let ctx = self.0.with_ego(&EgoPaths::one("`ego_path`", positions, Some(headings))?)?;
        let plan = ctx.candidate(failure.trajectory.clone());
        Ok((ctx, plan))
    }
}

/// Reads a JSON file of a search.
///
/// *Errors*: the file cannot be read, or holds something else.
pub(in crate::commands) fn json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let shown = || format!("cannot read `{}`", path.display());
    let bytes = files::read(path, ROW_LIMIT).with_context(shown)?;
    match serde_json::from_slice(&bytes) {
        Ok(value) => Ok(value),
        Err(error) => bail!("`{}` is not as `sage search` writes it: {error}", path.display()),
    }
}
