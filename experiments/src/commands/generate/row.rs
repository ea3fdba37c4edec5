//! The row of one attack, as its JSON file holds it.

use std::num::NonZeroUsize;

use advsage::selection_outcome::{CandidateCounts, SelectionOutcome};
use sage_core::{
    motion::Trajectory,
    objective::{Scores, Violation},
};
use sage_run::terminal;
use sage_sim::{avoidable::Avoidable, reference::Answer};
use serde::Serialize;
use serde_json::{Map, Value, value::RawValue};

/// One attack, as its file records it.
#[derive(Serialize)]
pub(super) struct VariantRow<'r> {
    /// Hash of the run's identity. The first field, so that it can be checked without reading the row.
    pub(super) run_hash: &'r str,
    /// Name of the input file without its ending.
    pub(super) scene: &'r str,
    /// Name of the operating point, as in file names.
    pub(super) variant: &'r str,
    /// Hash of the input file.
    pub(super) source_hash: &'r str,
    /// The scene files of this attack.
    pub(super) files: Vec<String>,
    pub(super) seed: u64,
    /// Track of the adversary.
    pub(super) adversary: &'r str,
    #[serde(flatten)]
    pub(super) described: Map<String, Value>,
    pub(super) trajectory: &'r Trajectory,
    pub(super) chosen: usize,
    /// Feasibility by the rule of the selection, like `violations`.
    pub(super) feasible: bool,
    pub(super) violations: Vec<Violation>,
    /// What came of the selection, and what its candidates do.
    pub(super) outcome: SelectionOutcome,
    pub(super) counts: &'r CandidateCounts,
    pub(super) note: Option<String>,
    /// Drives of the driver that the generator asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) queries: Option<NonZeroUsize>,
    pub(super) scores: ChosenScores<'r>,
    /// The last field, so that the others can be read without it.
    pub(super) candidates: Vec<CandidateRow<'r>>,
}

/// The row of a scene in which no attack can be measured.
#[derive(Serialize)]
pub(super) struct LeftOutRow<'r> {
    pub(super) run_hash: &'r str,
    pub(super) scene: &'r str,
    pub(super) variant: &'r str,
    pub(super) source_hash: &'r str,
    /// None.
    pub(super) files: [String; 0],
    /// Why.
    pub(super) left_out: &'r str,
}

impl LeftOutRow<'_> {
    /// The printed line.
    pub(super) fn line(&self) -> String {
        let [scene, variant] = [self.scene, self.variant].map(terminal::escaped_name);
        format!("{scene} {variant}: left out, contact now")
    }
}

/// Whether the only reference prevents a contact; `None` without one, or if it cannot drive.
pub(super) fn prevented(answers: &[Answer]) -> Option<bool> {
    answers.last()?.prevents
}

/// Scores of the chosen candidate, and whether a driver could have avoided it.
#[derive(Serialize)]
pub(super) struct ChosenScores<'r> {
    #[serde(flatten)]
    pub(super) scores: &'r Scores,
    #[serde(flatten)]
    pub(super) avoidable: &'r Avoidable,
    /// Whether the reference driver `r157` prevents the contact; empty without one.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    pub(super) references: &'r [Answer],
    /// The same; the earlier name of this field, for one version.
    pub(super) r157_avoids: Option<bool>,
}

/// One candidate of an attack.
#[derive(Serialize)]
pub(super) struct CandidateRow<'r> {
    pub(super) log_prob: Option<f64>,
    /// Negative log-likelihood under the prior, nats, if the selection needs it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) nll: Option<f64>,
    pub(super) goal: Option<[f64; 2]>,
    pub(super) trajectory: &'r RawValue,
    pub(super) scores: &'r RawValue,
}
