//! What an attacked drive was found to be, as rows hold it.

use sage_core::objective::PersonMet;
use sage_sim::{
    reference::Answer,
    search::{Clauses, Evaluated, Met, Variation},
};
use serde::{Deserialize, Serialize};

/// What an attacked drive was found to be.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EvaluatedRow {
    /// The first contact.
    pub contact: Option<Met>,
    /// Which clauses hold.
    pub clauses: Clauses,
    /// Reward of the search.
    pub reward: f64,
    /// Latest start within the limits of UN R157's driver, s before the contact.
    pub latest_start_r157: Option<f64>,
    /// Seconds from the onset of the plan to the latest start; of a person, from when it is in sight and walks to the last full braking.
    pub human_time: Option<f64>,
    /// The contact with a pedestrian or cyclist, if the adversary is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub person: Option<PersonMet>,
    /// The reference drivers that were asked whether they prevent the contact.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<Answer>,
    /// What becomes of the failure in each variant of the drive, if that was asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variations: Vec<Variation>,
}

impl EvaluatedRow {
    /// The row of a drive.
    pub fn of(evaluated: &Evaluated) -> Self {
        let Evaluated { contact, clauses, reward, human_time, person, references, variations, .. } =
            evaluated;
        Self {
            contact: contact.clone(),
            clauses: *clauses,
            reward: *reward,
            latest_start_r157: evaluated.latest_start_r157,
            human_time: *human_time,
            person: *person,
            references: references.clone(),
            variations: variations.clone(),
        }
    }
}
