//! An attack from a file: a row with a plan, or an attacked scene.

use std::path::Path;

use advsage::rows::{GeneratedBy, ROW_LIMIT};
use anyhow::{Context as _, Result, anyhow, bail, ensure};
use sage_core::{
    files,
    geometry::distance,
    motion::{HORIZON, NOW, Trajectory},
    scene::{Scene, Track},
};
use sage_data::Recording;
use serde::Deserialize;
use serde_json::Value;

/// Way in one step that no vehicle covers, metres.
const FAR: f64 = 10.0;
/// Distance between two positions that are the same, metres. Files store 32-bit numbers.
const SAME: f64 = 0.05;
/// An attack from a file.
pub(super) struct AttackFile {
    name: String,
    /// Hash of the file.
    hash: String,
    content: Content,
    /// How it was generated.
    generated: GeneratedBy,
}

enum Content {
    Row(PlannedRow),
    Scene(Box<Scene>),
}

/// The fields that the rows of an attack, of a failure and of a rate share, as far as a drive needs them.
#[derive(Deserialize)]
#[serde(expecting = "a JSON object")]
struct GeneratedRow {
    scene: String,
    adversary: String,
    source_hash: String,
    trajectory: Option<Value>,
    /// The likeliest failure of a rate.
    likeliest: Option<LikeliestRow>,
    #[serde(flatten)]
    generated: GeneratedBy,
}

#[derive(Deserialize)]
struct LikeliestRow {
    trajectory: Value,
}

/// The plan of a row, and what it is of.
struct PlannedRow {
    scene: String,
    adversary: String,
    source_hash: String,
    trajectory: Trajectory,
}

/// Reads a row with a plan, and how it was made.
fn row(bytes: &[u8]) -> Result<(Content, GeneratedBy)> {
    let GeneratedRow { scene, adversary, source_hash, trajectory, likeliest, generated } =
        serde_json::from_slice(bytes)?;
    let trajectory = trajectory.or(likeliest.map(|likeliest| likeliest.trajectory));
    let trajectory = trajectory.context("it has no `trajectory`, and no `likeliest` failure")?;
    let trajectory = serde_json::from_value(trajectory)
        .map_err(|_| anyhow!("its field `trajectory` is not {HORIZON} times [x, y]"))?;
    Ok((Content::Row(PlannedRow { scene, adversary, source_hash, trajectory }), generated.of_plan()))
}

impl AttackFile {
    /// Reads a row or a scene.
    ///
    /// *Errors*: the file cannot be read, or it is neither.
    pub(super) fn read(file: &Path) -> Result<Self> {
        let name = file.display().to_string();
        ensure!(file.to_str() != Some("-"), "--attack needs a file, not standard input");
        let is_row = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
        let bytes = if is_row {
            files::read(file, ROW_LIMIT).with_context(|| format!("cannot read `{name}`"))?
        } else {
            sage_data::read_bytes(file)?
        };
        let hash = blake3::hash(&bytes).to_hex()[..16].to_owned();
        let (content, generated) = if is_row {
            let (row, generated) = row(&bytes).with_context(|| {
                format!("`{name}` is not a row of `sage generate`; --attack takes a row or an attacked scene")
            })?;
            (row, generated)
        } else {
            let recording = Recording::from_bytes(file, bytes)?;
            let generated = provenance(&recording)?;
            (Content::Scene(Box::new(recording.scene)), generated)
        };
        Ok(Self { name, hash, content, generated })
    }

    /// Hash of the file.
    pub(super) fn hash(&self) -> &str {
        &self.hash
    }

    /// How the attack was generated, as far as the file says.
    pub(super) fn generated(&self) -> &GeneratedBy {
        &self.generated
    }

    /// Adversary (a track id) and trajectory of the attack in a scene. `wanted` is the adversary that the user
    /// names.
    ///
    /// *Errors*: the attack is of another scene or another adversary, or there is none.
    pub(super) fn attack(
        &self,
        scene: &Scene,
        scene_name: &str,
        source_hash: &str,
        wanted: Option<&str>,
    ) -> Result<(String, Trajectory)> {
        let name = &self.name;
        let (adversary, trajectory) = match &self.content {
            Content::Row(row) => self.of_row(row, scene, scene_name, source_hash)?,
            Content::Scene(attacked) => {
                let track = self.changed_track(attacked, scene, scene_name)?;
                (track.id.clone(), self.future(track)?)
            }
        };
        if let Some(wanted) = wanted.filter(|wanted| *wanted != adversary) {
            bail!("the adversary of `{name}` is `{adversary}`, not `{wanted}`");
        }
        Ok((adversary, trajectory))
    }

    fn of_row(
        &self,
        row: &PlannedRow,
        scene: &Scene,
        scene_name: &str,
        source_hash: &str,
    ) -> Result<(String, Trajectory)> {
        let name = &self.name;
        ensure!(
            row.source_hash == source_hash || row.scene == scene_name,
            "the attack in `{name}` is on scene `{}`, not on `{scene_name}`",
            row.scene
        );
        let track = scene.tracks.iter().find(|track| track.id == row.adversary);
        let starts_there = |track: &&Track| {
            track.is_valid(NOW) && distance(track.point(NOW), row.trajectory.points()[0]) < FAR
        };
        let track = track.filter(starts_there).with_context(|| {
            format!(
                "the attack in `{name}` does not begin at a car of `{scene_name}`; it is on another scene"
            )
        })?;
        Ok((track.id.clone(), row.trajectory.clone()))
    }

    /// The track that drives elsewhere than in the scene.
    fn changed_track<'a>(&self, attacked: &'a Scene, scene: &Scene, scene_name: &str) -> Result<&'a Track> {
        let name = &self.name;
        ensure!(
            attacked.id == scene.id && attacked.frames == scene.frames,
            "the attack in `{name}` is on scene `{}` with {} frames, not on `{scene_name}` (`{}`) with {}",
            attacked.id,
            attacked.frames,
            scene.id,
            scene.frames
        );
        let mut changed = Vec::new();
        for track in &attacked.tracks {
            let Some(own) = scene.tracks.iter().find(|own| own.id == track.id) else {
                bail!("`{name}` has a track `{}`, which `{scene_name}` has not", track.id);
            };
            let differs = |f: &usize| {
                own.is_valid(*f) != track.is_valid(*f)
                    || own.is_valid(*f) && distance(own.point(*f), track.point(*f)) > SAME
            };
            match (0..scene.frames).find(differs) {
                Some(frame) if frame <= NOW => bail!(
                    "track `{}` of `{name}` is elsewhere at frame {frame}; the attack is on another scene",
                    track.id
                ),
                Some(_) => changed.push(track),
                None => {}
            }
        }
        match changed[..] {
            [track] => Ok(track),
            [] => bail!("`{name}` holds no attack: every track drives as in `{scene_name}`"),
            [first, second, ..] => bail!(
                "`{name}` holds no attack of one adversary: the tracks `{}` and `{}` both drive elsewhere",
                first.id,
                second.id
            ),
        }
    }

    fn future(&self, track: &Track) -> Result<Trajectory> {
        let (name, last) = (&self.name, (NOW + HORIZON).min(track.valid.len() - 1));
        let frames = NOW + 1..=last;
        if let Some(frame) = frames.clone().find(|frame| !track.is_valid(*frame)) {
            bail!(
                "the adversary `{}` of `{name}` is not valid at frame {frame}; an attack needs frames {} to {last}",
                track.id,
                NOW + 1
            );
        }
        // Beyond the recording nothing is driven; the trajectory stays at its last position.
        let position = |frame: usize| track.point(frame.min(last));
        Ok(Trajectory::new(name, (NOW + 1..=NOW + HORIZON).map(position).collect())?)
    }
}

/// How the attack in a scene was generated, as far as its file says.
///
/// *Errors*: a native file whose source is damaged.
pub(super) fn provenance(recording: &Recording) -> Result<GeneratedBy> {
    let text = recording.provenance()?;
    // Another program may have written something else there.
    let all: Option<GeneratedBy> = text.and_then(|text| serde_json::from_str(&text).ok());
    Ok(all.unwrap_or_default().of_plan())
}
