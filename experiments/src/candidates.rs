//! Reads candidate trajectories, and the scenes they belong to.

use std::path::Path;

use advsage::rows::attack::{self, AttackRow};
use anyhow::{Context as _, Result, bail};
use sage_core::{
    files,
    geometry::Point,
    motion::{HORIZON, NOW, Trajectory},
    objective::EgoPaths,
    scene::{AdversaryOrigin, Scene},
};
use sage_data::{ReadOptions, Recording, checks};
use sage_run::progress;
use serde::Deserialize;

/// Size limit of a file of candidates, bytes: tens of thousands of trajectories.
const LIMIT: u64 = 64 << 20;

/// A candidate as written in the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CandidateRow {
    name: String,
    trajectory: Vec<Point>,
    ego: Option<Vec<Vec<f64>>>,
}

/// A checked candidate.
pub(crate) struct NamedCandidate {
    pub(crate) name: String,
    pub(crate) trajectory: Trajectory,
    /// The ego's path, if it differs from the logged one.
    pub(crate) ego: Option<EgoPaths>,
}

/// End of the name of the selected candidate of a row.
pub(crate) const SELECTED: &str = ", selected";

/// The candidates of a row of `sage generate`; the selected one alone if the run wrote no others.
fn of_row(row: AttackRow<Vec<attack::CandidateRow<Vec<Point>>>>) -> Vec<CandidateRow> {
    let named = |k: usize, trajectory| CandidateRow {
        name: if k == row.chosen { format!("{k}{SELECTED}") } else { k.to_string() },
        trajectory,
        ego: None,
    };
    if row.candidates.is_empty() {
        return vec![named(row.chosen, row.trajectory.points().to_vec())];
    }
    row.candidates.into_iter().enumerate().map(|(k, candidate)| named(k, candidate.trajectory)).collect()
}

/// Reads a JSON list of candidates, or a row of `sage generate`; `-` is standard input.
///
/// *Errors*: an invalid value, with the file and the candidate.
pub(crate) fn read(path: &Path) -> Result<Vec<NamedCandidate>> {
    let file = path.display();
    let text = files::read_argument_text(path, LIMIT).with_context(|| format!("cannot read `{file}`"))?;
    if text.trim_start().starts_with('{') {
        let row = serde_json::from_str(&text);
        let row = row.with_context(|| format!("`{file}` is no row of `sage generate`"))?;
        return checked(&file.to_string(), of_row(row));
    }
    let rows: Vec<CandidateRow> = serde_json::from_str(&text).with_context(|| {
        format!(r#"`{file}` is not a JSON list of {{"name", "trajectory": [[x, y] × {HORIZON}], "ego"}}; "ego" may be left out"#)
    })?;
    checked(&file.to_string(), rows)
}

/// Checks candidates of a file.
fn checked(file: &str, rows: Vec<CandidateRow>) -> Result<Vec<NamedCandidate>> {
    let checked = rows.into_iter().enumerate().map(|(k, row)| {
        let what = format!("`{file}`: candidate {k} `{}`", row.name);
        let trajectory = Trajectory::new(&format!("{what}: `trajectory`"), row.trajectory)?;
        let ego = row.ego.map(|rows| ego_path(&what, &rows)).transpose()?;
        Ok(NamedCandidate { name: row.name, trajectory, ego })
    });
    checked.collect()
}

/// Builds an ego path from rows that are all positions, or all positions with headings.
fn ego_path(what: &str, rows: &[Vec<f64>]) -> Result<EgoPaths> {
    let with_heading = rows.first().is_some_and(|row| row.len() == 3);
    let width = if with_heading { 3 } else { 2 };
    for (k, row) in rows.iter().enumerate() {
        if row.len() != width {
            bail!(
                "{what}: `ego` row {k} has {} numbers; expected [x, y] in every row, or [x, y, heading] in every row",
                row.len()
            );
        }
        if with_heading && row[2].abs() > 1e6 {
            bail!("{what}: `ego` row {k} has heading {}; expected radians", row[2]);
        }
    }
    let positions = rows.iter().map(|row| [row[0], row[1]]).collect();
    let headings = with_heading.then(|| rows.iter().map(|row| row[2]).collect());
    Ok(EgoPaths::one(&format!("{what}: `ego`"), positions, headings)?)
}

/// Reads a scene with the ego and adversary that the user names. Prints a note on stderr if the
/// adversary was selected by conflict, or if either track is not valid where it is needed.
///
/// *Errors*: the file is not a scene, or a track cannot be ego or adversary.
pub(crate) fn read_scene(
    path: &Path,
    options: &ReadOptions,
    ego: Option<&str>,
    adversary: Option<&str>,
) -> Result<Scene> {
    let scene = Recording::read_as(path, options)?.scene;
    let scene = scene.with_roles(ego, adversary).with_context(|| format!("`{}`", path.display()))?;
    for warning in checks::important(&scene) {
        progress::say(&format!("warning: {warning}"));
    }
    let Some(adversary) = scene.adversary.map(|k| &scene.tracks[k]) else { return Ok(scene) };
    if scene.adversary_origin == AdversaryOrigin::Conflict {
        progress::say(&format!(
            "note: adversary `{}` was selected because its logged path conflicts with the ego's",
            adversary.id.escape_debug()
        ));
    }
    if !adversary.is_valid(NOW) {
        progress::say(&format!(
            "note: adversary `{}` is not valid at frame {NOW}; its pose there is extrapolated from each candidate",
            adversary.id.escape_debug()
        ));
    }
    let horizon = scene.horizon();
    let missing = horizon - scene.ego().count_valid(NOW + 1..NOW + 1 + horizon);
    if missing > 0 {
        progress::say(&format!(
            "note: the ego is not valid in {missing} of {horizon} future frames; no contact is detected there"
        ));
    }
    Ok(scene)
}
