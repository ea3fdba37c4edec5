//! The panel of a drive.

use advsage::rows::drive::DriveRow;
use sage_core::scene::Track;
use sage_sim::{episode::Episode, vehicle::Motion};

use super::{Meeting, Panel, shown_part};

impl<'p> Panel<'p> {
    /// The drive of a row; `unattacked` is the drive without the attack.
    pub fn of_drive(
        row: &'p DriveRow,
        name: String,
        episode: &'p Episode,
        adversary: Option<&'p Track>,
        unattacked: Option<&'p [Motion]>,
    ) -> Self {
        let attack = row.attack.as_ref();
        Self {
            name,
            id: String::new(),
            sweep: None,
            motions: shown_part(&episode.drive),
            end: episode.drive.motions.len() - 1,
            shown: &episode.drive.shown,
            contact: episode.first_contacts().next().map(Meeting::from),
            adversary,
            unattacked,
            evasion: row.contacts.first().and_then(|contact| {
                let step = usize::try_from(contact.step).ok()?;
                Some(attack?.avoidable.evasion(step)?.1)
            }),
            verdict: row.verdict().map(|verdict| verdict.is_attack),
            is_failed: false,
            others: Vec::new(),
            marks: Vec::new(),
            badge: None,
            note: row.note(),
            ending: row.ending(),
        }
    }
}
