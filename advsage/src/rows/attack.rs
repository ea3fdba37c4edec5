//! The row of one attack, as its JSON file holds it.

use std::num::NonZeroUsize;

use sage_core::{
    motion::Trajectory,
    objective::{Scores, Violation},
    selection_outcome::{CandidateCounts, SelectionOutcome},
    text::escaped_name,
};
use sage_sim::{avoidable::Avoidable, reference::Answer};
use serde::Serialize;
use serde_json::{Map, Value, value::RawValue};

/// One attack, as its file records it.
#[derive(Serialize)]
pub struct VariantRow<'r> {
    /// Hash of the run's identity. The first field, so that it can be checked without reading the row.
    pub run_hash: &'r str,
    /// Name of the input file without its ending.
    pub scene: &'r str,
    /// Name of the operating point, as in file names.
    pub variant: &'r str,
    /// Hash of the input file.
    pub source_hash: &'r str,
    /// The scene files of this attack.
    pub files: Vec<String>,
    /// Seed of the run.
    pub seed: u64,
    /// Track of the adversary.
    pub adversary: &'r str,
    /// How it was generated.
    #[serde(flatten)]
    pub described: Map<String, Value>,
    /// The adversary's plan.
    pub trajectory: &'r Trajectory,
    /// Number of the candidate that is selected.
    pub chosen: usize,
    /// Feasibility by the rule of the selection, like `violations`.
    pub feasible: bool,
    /// Violations of that rule.
    pub violations: Vec<Violation>,
    /// What came of the selection, and what its candidates do.
    pub outcome: SelectionOutcome,
    /// What its candidates do.
    pub counts: &'r CandidateCounts,
    /// What the generator says of it.
    pub note: Option<String>,
    /// Drives of the driver that the generator asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub queries: Option<NonZeroUsize>,
    /// Scores of the selected candidate.
    pub scores: ChosenScores<'r>,
    /// The last field, so that the others can be read without it.
    pub candidates: Vec<CandidateRow<'r>>,
}

/// The row of a scene in which no attack can be measured.
#[derive(Serialize)]
pub struct LeftOutRow<'r> {
    /// Hash of the run's identity.
    pub run_hash: &'r str,
    /// Name of the input file without its ending.
    pub scene: &'r str,
    /// Name of the operating point, as in file names.
    pub variant: &'r str,
    /// Hash of the input file.
    pub source_hash: &'r str,
    /// None.
    pub files: [String; 0],
    /// Why.
    pub left_out: &'r str,
}

impl LeftOutRow<'_> {
    /// The printed line.
    pub fn line(&self) -> String {
        let [scene, variant] = [self.scene, self.variant].map(escaped_name);
        format!("{scene} {variant}: left out, contact now")
    }
}

/// Whether the only reference prevents a contact; `None` without one, or if it cannot drive.
pub fn prevented(answers: &[Answer]) -> Option<bool> {
    answers.last()?.prevents
}

/// Scores of the chosen candidate, and whether a driver could have avoided it.
#[derive(Serialize)]
pub struct ChosenScores<'r> {
    /// Scores of the selected candidate.
    #[serde(flatten)]
    pub scores: &'r Scores,
    /// Whether an evasive manoeuvre exists.
    #[serde(flatten)]
    pub avoidable: &'r Avoidable,
    /// Whether the reference driver `r157` prevents the contact; empty without one.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    pub references: &'r [Answer],
    /// The same; the earlier name of this field, for one version.
    pub r157_avoids: Option<bool>,
}

/// One candidate of an attack.
#[derive(Serialize)]
pub struct CandidateRow<'r> {
    /// Log-probability under the network, if it has one.
    pub log_prob: Option<f64>,
    /// Negative log-likelihood under the prior, nats, if the selection needs it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nll: Option<f64>,
    /// Goal, metres.
    pub goal: Option<[f64; 2]>,
    /// The adversary's plan.
    pub trajectory: &'r RawValue,
    /// Scores of the selected candidate.
    pub scores: &'r RawValue,
}
