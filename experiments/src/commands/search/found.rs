//! What a search has found, read from its folder.

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use advsage::rows::{
    failure::FailureRow,
    search::{SceneRow, failure_name, row_file, unchanged_file},
};
use anyhow::{Context as _, Result, bail, ensure};
use sage_core::{
    files,
    geometry::OrientedBox,
    motion::{DT, HORIZON, MAX_COORDINATE, NOW},
    objective::{Candidate, Context, ContextOptions, EgoPaths, PartSpec},
    scene::{Scene, SceneIndex},
    text::natural_order,
};
use sage_data::Recording;
use sage_run::{
    output::{self, RECORD},
    progress,
    scene_queue::is_row_of,
};
use sage_sim::{
    episode::LAST_FRAME,
    fault::FaultRule,
    policy::Shown,
    search::{Circumstances, Features, SearchOptions, suite::MOST_TESTS},
    vehicle::Motion,
};
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::Value;

/// Size limit of a row, bytes.
const LIMIT: u64 = 1 << 24;

/// What is wrong with a failure whose contact is nowhere on its path.
const NOT_WITHIN: &str = "its `contact` is not within its `ego_path`";

/// The folder of a search.
pub(in crate::commands) struct Found<'a> {
    pub(in crate::commands) folder: &'a Path,
    pub(in crate::commands) record: SearchRecord,
    /// Rows of all scenes that are done.
    pub(in crate::commands) rows: Vec<SceneRow>,
    /// Scenes that failed.
    pub(in crate::commands) failed: usize,
}

/// What other commands need of the record of a search.
#[derive(Deserialize)]
pub(in crate::commands) struct SearchRecord {
    pub(in crate::commands) search: SearchOptions,
    pub(in crate::commands) feasibility: PartSpec,
    /// Names of the reference drivers.
    pub(in crate::commands) references: Vec<String>,
    /// The rule that says who is at fault.
    pub(in crate::commands) fault: FaultRule,
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
            let folder = folder.display();
            progress::say(&format!("note: scenes of the search in `{folder}` failed, or are not done"));
        }
        let failed = record["results"]["failed"].as_u64().unwrap_or_default() as usize;
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
        rows.sort_by(|a, b| natural_order(a.scene(), b.scene()));
        for row in &rows {
            let failures = row.failures();
            ensure!(failures <= MOST_TESTS, "scene `{}`: its row counts {failures} failures", row.scene());
            check_poses("unattacked_path", row.unattacked_path(), 0..=LAST_FRAME + 1)
                .with_context(|| format!("scene `{}`", row.scene()))?;
        }
        Ok(Self { folder, record, rows, failed })
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
    pub(in crate::commands) fn failure(&self, row: &SceneRow, number: usize) -> Result<FailureRow> {
        let path = self.folder.join(row_file(&format!("{}-{}", row.scene(), failure_name(number))));
        let failure: FailureRow = json(&path).context("search again with this version")?;
        let check = || -> Result<()> {
            check_poses("ego_history", &failure.ego_history, NOW + 1..=NOW + 1)?;
            check_poses("ego_path", &failure.ego_path, 1..=HORIZON)?;
            check_shown(&failure.shown)?;
            check_poses("witness", failure.avoidable.witness.as_deref().unwrap_or_default(), 0..=HORIZON)
        };
        check().with_context(|| format!("`{}`", path.display()))?;
        Ok(failure)
    }
}

/// Checks the poses of a row, which may come from anywhere.
///
/// *Errors*: another number than expected, or one that is not finite or too far away.
pub(in crate::commands) fn check_poses(
    field: &str,
    poses: &[[f64; 3]],
    count: RangeInclusive<usize>,
) -> Result<()> {
    let (least, most) = (count.start(), count.end());
    let expected = if least == most { least.to_string() } else { format!("{least} to {most}") };
    ensure!(count.contains(&poses.len()), "`{field}` has {} poses; expected {expected}", poses.len());
    let is_usable = |pose: &[f64; 3]| pose.iter().all(|x| x.abs() <= MAX_COORDINATE);
    let wrong = poses.iter().position(|pose| !is_usable(pose));
    ensure!(wrong.is_none(), "`{field}`: pose {} is out of range", wrong.unwrap_or_default());
    Ok(())
}

/// Checks what a driver showed, in a row that may come from anywhere.
///
/// *Errors*: a step that no drive has, or a number that is too large.
pub(in crate::commands) fn check_shown(shown: &[Shown]) -> Result<()> {
    let is_usable = |shown: &Shown| {
        let numbers = shown.plan.as_flattened();
        shown.step <= LAST_FRAME && numbers.iter().all(|x| x.abs() <= MAX_COORDINATE)
    };
    let wrong = shown.iter().position(|shown| !is_usable(shown));
    ensure!(wrong.is_none(), "`shown`: entry {} is out of range", wrong.unwrap_or_default());
    Ok(())
}

/// The words of a driver without the folders of its files: suites and reports are passed on, and folders are nobody's
/// business.
pub(in crate::commands) fn without_folders(ego: &str) -> String {
    let Some((kind, rest)) =
        ego.split_once(':').filter(|(kind, _)| ["cmd", "path", "ppo", "td3"].contains(kind))
    else {
        return ego.to_owned();
    };
    let name = |word: &str| word.rsplit('/').next().unwrap_or_default().to_owned();
    format!("{kind}:{}", rest.split(' ').map(name).collect::<Vec<_>>().join(" "))
}

/// A failure on its scene: the attacked drive and its plan.
pub(in crate::commands) struct DrivenFailure {
    ctx: Context,
    plan: Candidate,
}

impl DrivenFailure {
    /// Features of a failure.
    ///
    /// *Errors*: its contact is not within its path.
    pub(in crate::commands) fn features(&self, failure: &FailureRow) -> Result<Features> {
        let met = failure.evaluated.contact.as_ref().context("it has no `contact`")?;
        Features::of(&self.ctx, &self.plan, met, failure.avoidable.latest_start).context(NOT_WITHIN)
    }

    /// Circumstances of a failure; none if the adversary is a person.
    ///
    /// *Errors*: its contact is not within its path.
    pub(in crate::commands) fn circumstances(&self, failure: &FailureRow) -> Result<Option<Circumstances>> {
        if failure.evaluated.person.is_some() {
            return Ok(None);
        }
        let met = failure.evaluated.contact.as_ref().context("it has no `contact`")?;
        Circumstances::of(&self.ctx, &self.plan, met).map(Some).context(NOT_WITHIN)
    }

    /// Boxes of the ego and of the adversary at a step, 1 or later.
    ///
    /// *Errors*: the step is not within the path.
    pub(in crate::commands) fn boxes_at(&self, step: usize) -> Result<[OrientedBox; 2]> {
        let at = step.checked_sub(1).context(NOT_WITHIN)?;
        let own = self.ctx.ego().boxes().get(at).copied().flatten().context(NOT_WITHIN)?;
        Ok([own, *self.plan.boxes().get(at).context(NOT_WITHIN)?])
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

    /// A failure on this scene.
    ///
    /// *Errors*: its path is not as a search writes it.
    pub(in crate::commands) fn driven(&self, failure: &FailureRow) -> Result<DrivenFailure> {
        let positions = failure.ego_path.iter().map(|[x, y, _]| [*x, *y]).collect();
        let headings = failure.ego_path.iter().map(|pose| pose[2]).collect();
        let ctx = self.0.with_ego(&EgoPaths::one("`ego_path`", positions, Some(headings))?)?;
        Ok(DrivenFailure { plan: ctx.candidate(failure.trajectory.clone()), ctx })
    }
}

/// Motions of poses at consecutive frames.
pub(in crate::commands) fn motions(poses: &[[f64; 3]]) -> Vec<Motion> {
    let motion = |k: usize| {
        // The first pose has the velocity of the second.
        let from = k.max(1) - 1;
        let to = (from + 1).min(poses.len() - 1);
        let [x, y, heading] = poses[k];
        let velocity = [0, 1].map(|axis| (poses[to][axis] - poses[from][axis]) / DT);
        Motion { position: [x, y], heading, velocity, yaw_rate: 0.0 }
    };
    (0..poses.len()).map(motion).collect()
}

/// Reads a JSON file of a search.
///
/// *Errors*: the file cannot be read, or holds something else.
pub(in crate::commands) fn json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let shown = || format!("cannot read `{}`", path.display());
    let bytes = files::read(path, LIMIT).with_context(shown)?;
    match serde_json::from_slice(&bytes) {
        Ok(value) => Ok(value),
        Err(error) => bail!("`{}` is not as `sage search` writes it: {error}", path.display()),
    }
}
