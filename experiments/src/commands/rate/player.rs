//! The page on which the likeliest failure of a row is played beside the drive without an attack.

use advsage::rows::{
    contact::step,
    rate::{LikeliestFailure, RateRow},
    search::RowHead,
};
use anyhow::{Context as _, Result};
use sage_core::scene::{Scene, Track};
use sage_run::progress;
use sage_sim::{
    attack_test::{AttackOutcome, AttackTest},
    drive::Drive,
    rate::Given,
};
use sage_view::player::{self, Meeting, Page, Panel, shown_part};

use super::index;

/// The page; `None` without a failure, or if a driver that is not the same each time does not drive it again.
///
/// *Errors*: a scene without an adversary.
pub(super) fn page(row: &RateRow, test: &AttackTest, scene: &Scene) -> Result<Option<String>> {
    let Some(likeliest) = &row.likeliest else { return Ok(None) };
    let first = likeliest.contact.as_ref().map(|met| met.step);
    let same = |attacked: &AttackOutcome| {
        let again = attacked.episode.contacts.first();
        again.map(|contact| step(contact.contact.step)) == first
    };
    let attacked = test.attack(&likeliest.trajectory, true);
    let problem = match &attacked {
        Ok(attacked) if same(attacked) => String::new(),
        Ok(_) => "its first contact is another one".to_owned(),
        Err(error) => error.to_string(),
    };
    let Some(attacked) = attacked.ok().filter(|_| problem.is_empty()) else {
        let RowHead { scene, ego, .. } = &row.head;
        progress::say(&format!(
            "warning: {scene} {ego}: the likeliest failure is not played, because the driver does not drive it again: {problem}"
        ));
        return Ok(None);
    };
    let recorded = scene.adversary()?;
    let planned = recorded.following(&likeliest.trajectory);
    let drive = &attacked.episode.drive;
    let panels = [
        Panel {
            contact: attacked.episode.first_contacts().next().map(Meeting::from),
            unattacked: Some(shown_part(test.unattacked())),
            verdict: Some(true),
            badge: Some("failure"),
            ending: ending(likeliest, row.given).context("the failure has no contact")?,
            ..panel("likeliest failure", drive, &planned)
        },
        panel("without an attack", test.unattacked(), recorded),
    ];
    let page = Page {
        scene,
        title: &row.head.scene,
        subtitle: &format!("{}, the likeliest failure", row.head.ego),
        panels: &panels,
        paths: &[],
        columns: panels.len(),
        back: Some(index::FILE),
    };
    Ok(Some(player::page(&page)?))
}

fn panel<'p>(name: &str, drive: &'p Drive, adversary: &'p Track) -> Panel<'p> {
    Panel {
        name: name.to_owned(),
        id: String::new(),
        sweep: None,
        motions: shown_part(drive),
        end: drive.motions.len() - 1,
        shown: &drive.shown,
        contact: None,
        adversary: Some(adversary),
        unattacked: None,
        evasion: None,
        verdict: None,
        is_failed: false,
        others: Vec::new(),
        marks: Vec::new(),
        badge: None,
        note: String::new(),
        ending: String::new(),
    }
}

fn ending(likeliest: &LikeliestFailure, given: Given) -> Option<String> {
    let met = likeliest.contact.as_ref()?;
    Some(format!(
        "contact after {:.1} s at {:.1} m/s; probability of the plan, given {given}: {:.2} %",
        met.step as f64 / 10.0,
        met.impact_speed,
        100.0 * likeliest.probability
    ))
}
