//! An attack from a file: a row of `sage generate`, or an attacked scene.

use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use sage_core::{
    files,
    geometry::distance,
    motion::{HORIZON, NOW, Trajectory},
    scene::Scene,
};
use sage_data::Recording;
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::scene_queue::ROW_LIMIT;

/// Distance between an adversary *now* and one step later that no vehicle covers, metres.
const FAR: f64 = 10.0;
/// Distance between two positions of the history that are the same, metres. Files store 32-bit numbers.
const SAME: f64 = 0.05;
/// Fields that describe how an attack was generated.
const DESCRIPTION: [&str; 7] = ["method", "options", "lambda", "mu", "aggression", "mix", "merger"];

/// An attack from a file.
pub(super) struct AttackFile {
    name: String,
    /// Hash of the file.
    hash: String,
    content: Content,
}

enum Content {
    Row(Box<GeneratedRow>),
    Scene(Box<Scene>, Map<String, Value>),
}

/// The part of a row of `sage generate` that a drive needs.
#[derive(Deserialize)]
struct GeneratedRow {
    scene: String,
    source_hash: String,
    trajectory: Trajectory,
    #[serde(flatten)]
    others: Map<String, Value>,
}

impl AttackFile {
    /// Reads a row or a scene.
    ///
    /// *Errors*: the file cannot be read, or it is neither.
    pub(super) fn read(file: &Path) -> Result<Self> {
        let name = file.display().to_string();
        let is_row = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
        let bytes = if is_row {
            files::read(file, ROW_LIMIT).with_context(|| format!("cannot read `{name}`"))?
        } else {
            sage_data::read_bytes(file)?
        };
        let hash = blake3::hash(&bytes).to_hex()[..16].to_owned();
        let content = if is_row {
            let row = serde_json::from_slice(&bytes);
            Content::Row(row.with_context(|| format!("`{name}` is not a row of `sage generate`"))?)
        } else {
            let recording = Recording::from_bytes(file, bytes)?;
            let known = provenance(&recording)?;
            Content::Scene(Box::new(recording.scene), known)
        };
        Ok(Self { name, hash, content })
    }

    /// Hash of the file.
    pub(super) fn hash(&self) -> &str {
        &self.hash
    }

    /// The adversary's trajectory in a scene.
    ///
    /// *Errors*: the attack is of another scene, or its adversary is not there throughout.
    pub(super) fn trajectory(
        &self,
        scene: &Scene,
        scene_name: &str,
        source_hash: &str,
    ) -> Result<Trajectory> {
        let adversary = scene.adversary_index()?;
        let name = &self.name;
        match &self.content {
            Content::Row(row) => {
                let is_same_file = row.source_hash == source_hash;
                let is_near = scene.tracks[adversary].is_valid(NOW)
                    && distance(scene.tracks[adversary].point(NOW), row.trajectory.points()[0]) < FAR;
                ensure!(
                    is_same_file || (row.scene == scene_name && is_near),
                    "the attack in `{name}` is on scene `{}`, not on `{scene_name}`",
                    row.scene
                );
                Ok(row.trajectory.clone())
            }
            Content::Scene(attacked, _) => {
                ensure!(
                    attacked.id == scene.id && attacked.frames == scene.frames,
                    "the attack in `{name}` is on scene `{}` with {} frames, not on `{}` with {}",
                    attacked.id,
                    attacked.frames,
                    scene.id,
                    scene.frames
                );
                let id = &scene.tracks[adversary].id;
                let Some(track) = attacked.tracks.iter().find(|track| track.id == *id) else {
                    bail!("`{name}` has no track `{id}`, the adversary of `{scene_name}`");
                };
                let own = &scene.tracks[adversary];
                let differs = |f: &usize| own.is_valid(*f) && distance(own.point(*f), track.point(*f)) > SAME;
                if let Some(frame) = (0..=NOW).find(differs) {
                    bail!(
                        "the adversary `{id}` of `{name}` is elsewhere at frame {frame}; the attack is on another scene"
                    );
                }
                let frames = NOW + 1..=NOW + HORIZON;
                if let Some(frame) = frames.clone().find(|frame| !track.is_valid(*frame)) {
                    bail!(
                        "the adversary `{id}` of `{name}` is not valid at frame {frame}; an attack needs frames 11 to 90"
                    );
                }
                Ok(Trajectory::new(name, frames.map(|frame| track.point(frame)).collect())?)
            }
        }
    }

    /// How the attack was generated, as far as the file says.
    pub(super) fn described(&self) -> Map<String, Value> {
        match &self.content {
            Content::Row(row) => description(&row.others),
            Content::Scene(_, known) => known.clone(),
        }
    }
}

/// How the attack in a scene was generated, as far as its file says.
///
/// *Errors*: a native file whose source is damaged.
pub(super) fn provenance(recording: &Recording) -> Result<Map<String, Value>> {
    let text = recording.provenance()?;
    // Another program may have written something else there.
    let all: Option<Map<String, Value>> = text.and_then(|text| serde_json::from_str(&text).ok());
    Ok(description(&all.unwrap_or_default()))
}

/// The fields that describe how an attack was generated.
fn description(all: &Map<String, Value>) -> Map<String, Value> {
    let field = |key: &&str| Some(((*key).to_owned(), all.get(*key)?.clone()));
    DESCRIPTION.iter().filter_map(field).collect()
}
