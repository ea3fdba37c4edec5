//! A contact of the ego as results record it.

use sage_core::{motion::NOW, objective::SideHit, scene::Scene};
use sage_sim::{episode::EpisodeContact, fault::FaultClass};
use serde::{Deserialize, Serialize};

/// The first contact with one road user.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ContactRow {
    /// Step; frame 10 is step 0.
    pub step: i64,
    /// Track of the other.
    pub with: String,
    /// Largest overlap of the boxes, metres.
    pub overlap: f64,
    /// Relative speed, m/s.
    pub impact_speed: f64,
    /// Side of the ego that is hit.
    pub side_hit: SideHit,
    /// Whether the ego is at fault; null where the map cannot tell.
    pub at_fault: Option<bool>,
    /// Number of nuPlan's rule that decides, 1 to 5; 0 if the other appeared just before.
    pub rule: u8,
    /// Class by that rule.
    pub class: FaultClass,
}

/// Step of a frame: *now* is step 0.
pub fn step(frame: usize) -> i64 {
    frame as i64 - NOW as i64
}

impl ContactRow {
    /// The row of a contact in a scene.
    pub fn of(contact: &EpisodeContact, scene: &Scene) -> Self {
        let EpisodeContact { contact, overlap, impact_speed, side_hit, class } = contact;
        Self {
            step: step(contact.step),
            with: scene.tracks[contact.other.track].id.clone(),
            overlap: *overlap,
            impact_speed: *impact_speed,
            side_hit: *side_hit,
            at_fault: class.is_at_fault(),
            rule: class.rule(),
            class: *class,
        }
    }
}
