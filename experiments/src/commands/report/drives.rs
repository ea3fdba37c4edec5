//! The page of a scene: its failures in the player, from their rows alone.

use advsage::rows::{failure::FailureRow, search::SceneRow};
use anyhow::Result;
use sage_core::{motion::NOW, scene::Track};
use sage_sim::{policy::Shown, vehicle::Motion};
use sage_view::player::{self, Meeting, Page, Panel};

use super::{FILE, entry::Entry};
use crate::commands::search::found::{FailureScene, motions, without_folders};

/// Drives in a row.
const COLUMNS: usize = 3;

/// The page. `entries` describe the failures.
///
/// *Errors*: a row is not as a search writes it.
pub(super) fn page(
    scene: &FailureScene,
    row: &SceneRow,
    failures: &[(usize, FailureRow)],
    entries: &[Entry],
) -> Result<String> {
    let unattacked = motions(row.unattacked_path());
    let mut parts = Vec::with_capacity(failures.len());
    for (_, failure) in failures {
        let step =
            failure.evaluated.contact.as_ref().map_or(0, |met| usize::try_from(met.step).unwrap_or_default());
        let driven = failure.ego_history.iter().chain(failure.ego_path.iter().take(step));
        parts.push(Parts {
            shown: &failure.shown,
            motions: motions(&driven.copied().collect::<Vec<_>>()),
            meeting: Meeting { frame: NOW + step, areas: scene.driven(failure)?.boxes_at(step)? },
            adversary: scene.scene().adversary()?.following(&failure.trajectory),
            evasion: failure.avoidable.evasion(step).map(|(_, poses)| poses.to_vec()),
        });
    }
    let adversary = scene.scene().adversary()?;
    let first = unattacked_panel(&unattacked, adversary);
    let panels: Vec<Panel> = first
        .into_iter()
        .chain(parts.iter().zip(entries).map(|(part, entry)| panel(part, entry, &unattacked)))
        .collect();
    let back = format!("../{FILE}");
    let page = Page {
        scene: scene.scene(),
        title: row.scene(),
        subtitle: &format!("failures of {}", without_folders(row.ego())),
        panels: &panels,
        paths: &[],
        columns: COLUMNS,
        back: Some(&back),
    };
    Ok(player::page(&page)?)
}

/// What the driver does while the adversary drives as recorded.
fn unattacked_panel<'p>(motions: &'p [Motion], adversary: &'p Track) -> Option<Panel<'p>> {
    let words = "The adversary drives as recorded.";
    (!motions.is_empty()).then(|| Panel {
        name: "without an attack".to_owned(),
        id: "unattacked".to_owned(),
        sweep: None,
        motions,
        end: motions.len() - 1,
        shown: &[],
        contact: None,
        adversary: Some(adversary),
        unattacked: None,
        evasion: None,
        verdict: None,
        is_failed: false,
        others: Vec::new(),
        marks: Vec::new(),
        badge: None,
        note: words.to_owned(),
        ending: words.to_owned(),
    })
}

fn panel<'p>(part: &'p Parts<'p>, entry: &Entry, unattacked: &'p [Motion]) -> Panel<'p> {
    let plan = match entry.lambda {
        Some(lambda) => format!("{}, λ {lambda}", entry.plan),
        None => entry.plan.clone(),
    };
    Panel {
        name: format!(
            "{}{}: {}",
            entry.name,
            entry.role.map_or(String::new(), |r| format!(" ({r})")),
            entry.cluster
        ),
        id: entry.name.clone(),
        sweep: None,
        motions: &part.motions,
        end: part.motions.len().saturating_sub(1),
        shown: part.shown,
        contact: Some(part.meeting),
        adversary: Some(&part.adversary),
        unattacked: Some(unattacked).filter(|motions| !motions.is_empty()),
        evasion: part.evasion.as_deref(),
        verdict: Some(true),
        is_failed: false,
        others: Vec::new(),
        marks: Vec::new(),
        badge: Some("failure"),
        note: format!("{}. Plan: {plan}.", entry.words()),
        ending: entry.sentence.clone().unwrap_or_else(|| entry.words()),
    }
}

/// What the panel of a failure shows.
struct Parts<'p> {
    shown: &'p [Shown],
    motions: Vec<Motion>,
    meeting: Meeting,
    adversary: Track,
    evasion: Option<Vec<[f64; 3]>>,
}
