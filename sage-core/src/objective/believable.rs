//! Whether a person would believe an attack.
//!
//! An attack is believable if the whole plan is feasible by the paper's rule, touches no median at any frame,
//! hits the ego solidly, and does not approach it against the traffic for long. Without contact there is no
//! attack to believe.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::{
    Feasibility, MapFeasibility, Phase, Situation, Violation,
    against_traffic::against_traffic,
    contact_depth::contact_depth,
    map_feasibility::{touches_truly, touching_feature},
    violation::MEDIAN,
};
use crate::motion::DT;

/// Least overlap depth of a believable attack, metres. Replayed in MetaDrive, nearly all contacts deeper than
/// 0.6 m touch the ego, and none below 0.3 m.
pub const MIN_DEPTH: f64 = 0.5;
/// Longest time against the traffic before the contact, seconds.
pub const MAX_AGAINST: f64 = 1.0;

/// Why an attack is not believable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// `contact_depth`, `against_traffic`, or the violated rule.
    pub reason: Cow<'static, str>,
    /// The measured value: depth in metres, time against the traffic in seconds, or time of the first
    /// violation after *now* in seconds.
    pub value: f64,
    /// The limit that it breaks; `None` for a violated rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<f64>,
}

impl Reason {
    fn violated(violation: &Violation) -> Self {
        Self { reason: violation.rule.clone(), value: violation.step as f64 * DT, limit: None }
    }

    /// The reason as words, for tables and captions.
    pub fn words(&self) -> String {
        let value = self.value;
        match (&*self.reason, self.limit) {
            ("contact_depth", _) => format!("contact only {value:.2} m deep"),
            ("against_traffic", _) => format!("{value:.1} s against the traffic"),
            (rule, _) => format!("{} after {value:.1} s", rule.replace('_', " ")),
        }
    }
}

/// A verdict as words, with the reasons; `None` without contact.
pub fn verdict(believable: Option<bool>, reasons: &[Reason]) -> Option<String> {
    let words = || reasons.iter().map(Reason::words).collect::<Vec<_>>().join(", ");
    Some(if believable? { "believable".to_owned() } else { format!("not believable ({})", words()) })
}

/// All reasons against an attack, given the violations of the paper's rule; empty if it is believable. `None`
/// without contact.
pub fn doubts(situation: &Situation, violations: &[Violation]) -> Option<Vec<Reason>> {
    let Situation { candidate, ego, encounter, ctx } = situation;
    encounter.contact?;
    let mut reasons: Vec<Reason> = violations.iter().map(Reason::violated).collect();
    if let Some(contact) = touches_truly(candidate, ctx.index().medians())
        && !reasons.iter().any(|known| known.reason == MEDIAN)
    {
        reasons.push(Reason::violated(&touching_feature(
            candidate,
            ctx,
            MEDIAN,
            contact.step,
            contact.feature,
        )));
    }
    let depth = contact_depth(candidate, ego);
    if depth < MIN_DEPTH {
        reasons.push(Reason { reason: "contact_depth".into(), value: depth, limit: Some(MIN_DEPTH) });
    }
    let against = against_traffic(situation, Phase::Before);
    // Half a step of tolerance: a time is a count of steps.
    if against > MAX_AGAINST + 0.5 * DT {
        reasons.push(Reason { reason: "against_traffic".into(), value: against, limit: Some(MAX_AGAINST) });
    }
    Some(reasons)
}

/// Whether an attack is believable: as [`doubts`], but stops at the first reason. `false` without contact.
pub fn is_believable(situation: &Situation) -> bool {
    let Situation { candidate, ego, encounter, ctx } = situation;
    encounter.contact.is_some()
        && contact_depth(candidate, ego) >= MIN_DEPTH
        && touches_truly(candidate, ctx.index().medians()).is_none()
        && MapFeasibility::default().is_feasible(candidate, ctx)
        && against_traffic(situation, Phase::Before) <= MAX_AGAINST + 0.5 * DT
}
