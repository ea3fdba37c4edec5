//! Part of a trajectory relative to the first contact with the ego.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::Encounter;

/// Steps that a measure considers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// All steps.
    #[default]
    Whole,
    /// Steps up to the first contact; all steps without contact.
    Before,
    /// Steps after the first contact; none without contact.
    After,
}

impl Phase {
    /// The steps, from 1; possibly none.
    pub fn steps(self, encounter: &Encounter) -> RangeInclusive<usize> {
        let contact = encounter.contact.unwrap_or(encounter.steps);
        match self {
            Self::Whole => 1..=encounter.steps,
            Self::Before => 1..=contact,
            Self::After => contact + 1..=encounter.steps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::HORIZON;

    #[test]
    fn the_contact_belongs_to_what_leads_to_it_and_the_parts_make_the_whole() {
        for contact in [None, Some(1), Some(30), Some(HORIZON)] {
            let encounter = Encounter { contact, least_distance: 0.0, steps: HORIZON };
            let steps = |phase: Phase| phase.steps(&encounter);
            assert_eq!(steps(Phase::Before).last(), contact.or(Some(HORIZON)));
            assert!(steps(Phase::Before).chain(steps(Phase::After)).eq(steps(Phase::Whole)));
        }
    }
}
