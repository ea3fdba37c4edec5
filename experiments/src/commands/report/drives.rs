//! The page of a scene: its failures in the player, from their rows alone.

use advsage::rows::{failure::FailureRow, search::SceneRow};
use anyhow::Result;
use sage_core::{
    motion::{DT, NOW},
    scene::Track,
};
use sage_sim::vehicle::Motion;
use sage_view::player::{self, Meeting, Page, Panel};

use super::{FILE, entry::Entry};
use crate::commands::search::found::{FailureScene, without_folders};

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
            motions: motions(&driven.copied().collect::<Vec<_>>()),
            meeting: Meeting { frame: NOW + step, areas: scene.driven(failure)?.boxes_at(step)? },
            adversary: scene.scene().adversary()?.following(&failure.trajectory),
            evasion: failure.avoidable.evasion(step).map(|(_, poses)| poses.to_vec()),
        });
    }
    let panels: Vec<Panel> =
        parts.iter().zip(entries).map(|(part, entry)| panel(part, entry, &unattacked)).collect();
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

fn panel<'p>(part: &'p Parts, entry: &Entry, unattacked: &'p [Motion]) -> Panel<'p> {
    let plan = match entry.lambda {
        Some(lambda) => format!("{}, λ {lambda}", entry.plan),
        None => entry.plan.clone(),
    };
    Panel {
        name: format!("{}: {}", entry.name, entry.cluster),
        id: entry.name.clone(),
        sweep: None,
        motions: &part.motions,
        end: part.motions.len().saturating_sub(1),
        shown: &[],
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
        ending: entry.words(),
    }
}

/// What the panel of a failure shows.
struct Parts {
    motions: Vec<Motion>,
    meeting: Meeting,
    adversary: Track,
    evasion: Option<Vec<[f64; 3]>>,
}

/// Motions of poses at consecutive frames.
fn motions(poses: &[[f64; 3]]) -> Vec<Motion> {
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
