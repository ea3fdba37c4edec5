//! A row of `sage generate` with its scene.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use advsage::{
    AdversarySpec, Registries,
    rows::{
        ROW_LIMIT,
        attack::{AttackRow, CandidateRow},
    },
};
use anyhow::{Context as _, Result, bail, ensure};
use sage_core::{
    files,
    generator::{Attack, Proposal},
    motion::Trajectory,
    objective::{Objective, ObjectiveSpec},
    scene::Scene,
};
use sage_data::{Format, ReadOptions, Recording};

/// A row with the candidates that the attack was selected from.
type Row = AttackRow<Vec<CandidateRow<Trajectory>>>;

/// An attack that a row records, in its scene.
pub(super) struct RecordedAttack {
    pub(super) method: String,
    pub(super) variant: String,
    pub(super) mu: f64,
    pub(super) scene: Arc<Scene>,
    pub(super) attack: Attack,
    selection: ObjectiveSpec,
}

impl RecordedAttack {
    /// Reads a row, and its scene: the given one, else that of a scene file beside the row.
    ///
    /// *Errors*: it is no such row, or has no scene.
    pub(super) fn read(path: &Path, given: Option<&Path>, options: &ReadOptions) -> Result<Self> {
        let text =
            files::read_text(path, ROW_LIMIT).with_context(|| format!("cannot read `{}`", path.display()))?;
        let row: Row = serde_json::from_str(&text).with_context(|| {
            format!(
                "`{}` is no row of an attack by `sage generate`, and none of a scene by `sage search`",
                path.display()
            )
        })?;
        ensure!(
            !row.candidates.is_empty(),
            "`{}` was written with --no-candidates; explain its scene instead: `sage explain SCENE` with the options of the run",
            path.display()
        );
        let recording = match given {
            Some(given) => source(&row, given, options)?,
            None => Recording::read(&scene_file(&row, path)?)?,
        };
        let placed = row.generated.placed.as_ref();
        let scene = Arc::new(AdversarySpec::of_row(placed, recording, &row.adversary)?.scene);
        let proposal = |CandidateRow { log_prob, nll, goal, trajectory, .. }: CandidateRow<Trajectory>| {
            Proposal { trajectory, log_prob, goal, nll }
        };
        let candidates = row.candidates.into_iter().map(proposal).collect();
        let attack = Attack::of(candidates, row.chosen, None);
        Ok(Self {
            method: row.generated.method.unwrap_or_default(),
            variant: row.variant,
            mu: row.generated.mu.context("the row has no `mu`")?,
            scene,
            attack,
            selection: row.generated.selection.context("the row has no `selection`")?,
        })
    }

    /// The objective that selected.
    ///
    /// *Errors*: a part of it is not registered here.
    pub(super) fn objective(&self, registries: &Registries) -> Result<Objective> {
        let objective = Objective::new(&self.selection, &registries.rewards, &registries.feasibilities);
        objective.context("the selection of the row")
    }
}

/// The scene that was attacked.
///
/// *Errors*: it is another scene, or the row attacks another drive of the ego than the recorded one.
fn source(row: &Row, path: &Path, options: &ReadOptions) -> Result<Recording> {
    if let Some(ego) = &row.generated.ego {
        bail!(
            "the row attacks a drive of `{ego}`, which the scene does not hold; attack again with --format pickle"
        );
    }
    let bytes = sage_data::read_bytes(path)?;
    let hash = options.source_hash(&bytes);
    ensure!(
        hash.starts_with(&row.source_hash),
        "`{}` is not the scene `{}` that the row attacks: its hash is another, or its --ego-track",
        path.display(),
        row.scene
    );
    Ok(Recording::from_bytes_as(path, bytes, options)?)
}

/// The attacked scene beside the row.
fn scene_file(row: &Row, path: &Path) -> Result<PathBuf> {
    let is_scene = |name: &&String| {
        [Format::Pickle, Format::Native].iter().any(|format| name.ends_with(format.ending()))
    };
    let is_plain = |name: &&String| !name.contains(['/', '\\']);
    let file = row.files.iter().filter(is_plain).find(is_scene);
    let found = file.map(|name| path.with_file_name(name)).filter(|file| file.is_file());
    found.with_context(|| {
        format!(
            "there is no scene file beside `{}`; name the scene that it attacks with --of FILE",
            path.display()
        )
    })
}
