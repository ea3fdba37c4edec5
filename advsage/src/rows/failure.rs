//! The row of a failure that a search found.

use sage_core::motion::Trajectory;
use sage_sim::{
    avoidable::Avoidable,
    policy::Shown,
    search::{Circumstances, Deviation, Evaluated, Explanation, Pool, SearchResult},
};
use serde::{Deserialize, Serialize};

use super::{
    GeneratedBy,
    evaluated::EvaluatedRow,
    plan::PlanRow,
    search::{RowHead, failure_name, sentence},
};
use crate::operating_point::RowKey;

/// The row of a failure: like that of `sage generate`, and as `sage simulate --attack` reads it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FailureRow {
    /// What every row begins with.
    #[serde(flatten)]
    pub head: RowHead,
    /// Name of the failure, as in file names.
    pub variant: String,
    /// The scene files of this attack.
    pub files: Vec<String>,
    /// How its plan was made.
    #[serde(flatten)]
    pub generated: Option<GeneratedBy>,
    /// The adversary's plan.
    pub trajectory: Trajectory,
    /// Whether the plan is feasible.
    pub feasible: bool,
    /// Its drive, 1 the first.
    pub drive: usize,
    /// Where its plan comes from.
    pub plan: PlanRow,
    /// What the attacked drive was found to be.
    #[serde(flatten)]
    pub evaluated: EvaluatedRow,
    /// Where the adversary comes from, red lights, solid lines and the right of way.
    pub circumstances: Option<Circumstances>,
    /// How the plan differs from the recording of the adversary.
    #[serde(default)]
    pub deviation: Option<Deviation>,
    /// Probability that the adversary stays within 2 m of the plan up to the contact, among all plans of the nominal
    /// density of the weights.
    #[serde(default)]
    pub probability: Option<f64>,
    /// What explains the failure, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sentence: Option<String>,
    /// What explains it, if that was asked: `--explain-failures`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub explanation: Option<Explanation>,
    /// What the driver showed of its steps: plans and logs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shown: Vec<Shown>,
    /// Box centre and heading of the ego at frames 0 to *now*.
    pub ego_history: Vec<[f64; 3]>,
    /// The ego's path in the attacked drive, after the contact at constant velocity: `ego` of `sage score`.
    pub ego_path: Vec<[f64; 3]>,
    /// Whether an evasive manoeuvre exists.
    #[serde(flatten)]
    pub avoidable: Avoidable,
}

/// A failure among the results of a search.
#[derive(Clone, Copy)]
pub struct FailureOf<'a> {
    /// The plans of the search.
    pub pool: &'a Pool,
    /// What it found.
    pub result: &'a SearchResult,
    /// Number of the failure, 0 the first found.
    pub number: usize,
}

impl FailureOf<'_> {
    /// The attacked drive.
    pub fn evaluated(&self) -> &Evaluated {
        &self.result.driven[self.result.failures[self.number].drive]
    }
}

impl FailureRow {
    /// The row of a failure without its files; `source` is that of its plan.
    pub fn new(
        head: &RowHead,
        FailureOf { pool, result, number }: FailureOf,
        generated: Option<GeneratedBy>,
        source: Option<&RowKey>,
    ) -> Self {
        let failure = &result.failures[number];
        let evaluated = &result.driven[failure.drive];
        let path = failure.path.positions.iter().zip(&failure.path.headings);
        Self {
            head: head.clone(),
            variant: failure_name(number + 1),
            files: Vec::new(),
            generated,
            trajectory: pool.plans[evaluated.plan].proposal.trajectory.clone(),
            feasible: true,
            drive: failure.drive + 1,
            plan: PlanRow::new(pool, evaluated.plan, source),
            evaluated: EvaluatedRow::of(evaluated),
            circumstances: failure.circumstances,
            deviation: failure.deviation,
            probability: failure.probability,
            sentence: sentence(&head.ego, evaluated, failure),
            explanation: failure.explanation.clone(),
            shown: failure.shown.clone(),
            ego_history: failure.path.history.to_vec(),
            ego_path: path.map(|([x, y], heading)| [*x, *y, *heading]).collect(),
            avoidable: failure.avoidable.clone(),
        }
    }

    /// The reference driver that prevents the contact.
    pub fn prevented_by(&self) -> Option<&str> {
        let prevents = self.evaluated.references.iter().find(|answer| answer.prevents == Some(true));
        prevents.map(|answer| &*answer.reference)
    }

    /// The reference drivers that were asked and do not prevent it.
    pub fn not_prevented_by(&self) -> impl Iterator<Item = &str> {
        let asked = self.evaluated.references.iter();
        asked.filter(|answer| answer.prevents != Some(true)).map(|answer| &*answer.reference)
    }
}
