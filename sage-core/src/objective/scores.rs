//! Everything that is measured of a candidate, in one row.

use serde::{Deserialize, Serialize};

use super::{
    Candidate, Context, Convention, DistributionDistances, Encounter, Feasibility, LoggedProfile,
    MapFeasibility, Reason, StrictFeasibility, behavior_penalty, criticality::Criticality, kinematic_penalty,
};
use crate::objective::Rule;

/// Value of `cross_line` where a boundary is touched (published code).
const CROSS_LINE: f64 = 50.0;
/// Value of `crash_object` where another agent is hit (published code).
const CRASH_OBJECT: f64 = 10.0;

/// All measures of one candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Early contact with the ego, else closeness.
    pub adversarial_reward: f64,
    /// Whether ego and adversary touch.
    pub collision: bool,
    /// First step with contact, 1 to 80.
    pub collision_step: Option<usize>,
    /// P_kin.
    pub kinematic_penalty: f64,
    /// P_beh.
    pub behavior_penalty: f64,
    /// 50 if a road boundary is touched, else 0.
    pub cross_line: f64,
    /// 10 if another road user is touched, else 0.
    pub crash_object: f64,
    /// Whether neither is.
    pub feasible: bool,
    /// Whether the strict rule holds as well.
    pub feasible_strict: bool,
    /// Broken rules of `feasible`.
    pub reasons: Vec<Reason>,
    /// Broken rules of `feasible_strict`.
    pub reasons_strict: Vec<Reason>,
    /// Distances from the logged future.
    #[serde(flatten)]
    pub distances: DistributionDistances,
    /// How close and how bad the encounter is.
    #[serde(flatten)]
    pub criticality: Criticality,
}

/// Measures candidates of one context.
pub struct Scorer<'c, 's> {
    ctx: &'c Context<'s>,
    logged: LoggedProfile,
    map: MapFeasibility,
    strict: StrictFeasibility,
}

impl<'c, 's> Scorer<'c, 's> {
    /// A scorer with the default rules.
    pub fn new(ctx: &'c Context<'s>) -> Self {
        let (map, strict) = (MapFeasibility::default(), StrictFeasibility::default());
        Self { ctx, logged: LoggedProfile::of(ctx), map, strict }
    }

    /// All measures of a candidate.
    pub fn scores(&self, candidate: &Candidate) -> Scores {
        let ctx = self.ctx;
        let convention: Convention = ctx.convention();
        let encounter = Encounter::of(candidate, ctx);
        let reasons = self.map.violations(candidate, ctx);
        let reasons_strict = self.strict.violations(candidate, ctx);
        let broken = |rule: Rule| reasons.iter().any(|r| r.rule == rule);
        Scores {
            adversarial_reward: encounter.reward(convention),
            collision: encounter.contact.is_some(),
            collision_step: encounter.contact,
            kinematic_penalty: kinematic_penalty(candidate.profile()),
            behavior_penalty: behavior_penalty(candidate.profile()),
            cross_line: if broken(Rule::RoadEdge) { CROSS_LINE } else { 0.0 },
            crash_object: if broken(Rule::Agent) { CRASH_OBJECT } else { 0.0 },
            feasible: reasons.is_empty(),
            feasible_strict: reasons_strict.is_empty(),
            distances: self.logged.distances(candidate, convention),
            criticality: Criticality::of(candidate, ctx, &encounter),
            reasons,
            reasons_strict,
        }
    }
}
