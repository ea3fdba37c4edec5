//! The panel of a drive.

use sage_core::scene::Track;
use sage_sim::{episode::Episode, vehicle::Motion};

use sage_view::player::{Meeting, Panel, shown_part};

use super::drive::DriveRow;

impl DriveRow {
    /// The drive of this row on a page; `unattacked` is the drive without the attack.
    pub fn panel<'p>(
        &'p self,
        name: String,
        episode: &'p Episode,
        adversary: Option<&'p Track>,
        unattacked: Option<&'p [Motion]>,
    ) -> Panel<'p> {
        let attack = self.attack.as_ref();
        Panel {
            name,
            id: String::new(),
            sweep: None,
            motions: shown_part(&episode.drive),
            end: episode.drive.motions.len() - 1,
            shown: &episode.drive.shown,
            contact: episode.first_contacts().next().map(Meeting::from),
            adversary,
            unattacked,
            evasion: self.contacts.first().and_then(|contact| {
                let step = usize::try_from(contact.step).ok()?;
                Some(attack?.avoidable.evasion(step)?.1)
            }),
            verdict: self.verdict().map(|verdict| verdict.is_attack),
            is_failed: false,
            others: Vec::new(),
            marks: Vec::new(),
            badge: None,
            note: self.note(),
            ending: self.ending(),
        }
    }
}
