//! The first contact of an attacked drive.

use sage_core::motion::NOW;
use serde::{Deserialize, Serialize};

use crate::{
    attack_test::{AttackOutcome, AttackTest},
    fault::FaultClass,
};

/// The first contact of an attacked drive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Met {
    /// Steps after *now* of 0.1 s.
    pub step: i64,
    /// Track of the other road user.
    pub track: String,
    /// Whether it is the adversary.
    pub is_adversary: bool,
    /// Largest overlap, metres.
    pub overlap: f64,
    /// Relative speed, m/s.
    pub impact_speed: f64,
    /// Class by nuPlan's rule.
    pub class: FaultClass,
}

impl Met {
    /// The first contact of an attacked drive.
    pub(super) fn first(outcome: &AttackOutcome, test: &AttackTest) -> Option<Self> {
        let contact = outcome.episode.first_contacts().next()?;
        let other = contact.contact.other.track;
        Some(Self {
            step: contact.contact.step as i64 - NOW as i64,
            track: outcome.track(other).to_owned(),
            is_adversary: test.scene().adversary == Some(other),
            overlap: contact.overlap,
            impact_speed: contact.impact_speed,
            class: contact.class,
        })
    }
}
