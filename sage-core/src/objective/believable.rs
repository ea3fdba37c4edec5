//! Whether a person would believe an attack.
//!
//! An attack is believable if the whole plan is feasible by the paper's rule, touches no median at any frame, turns no more
//! tightly than a car can nor from the wrong lane, and accelerates, brakes, corners and speeds no more than recorded cars do;
//! if it hits the ego solidly; and does not approach it for long against or across the lanes, nor by a U-turn that no lane
//! offers. Without contact there is no attack to believe.
//!
//! It is a verdict, not an objective: its limits are fixed, so that figures of different objectives compare.
//!
//! `believable-1` is the definition before: without dynamics, turns, U-turns and the time across the lanes.
//!
//! Of pedestrians and cyclists all this is asked by [`person`](super::person) instead.

use super::{
    Candidate, Context, Feasibility, MapFeasibility, Phase, Situation, Violation,
    against_lanes::{across_lanes, turn_from_wrong_lane, u_turn},
    against_traffic::against_traffic,
    contact_depth::contact_depth,
    dynamics::{ACCELERATION, BRAKING, SPEEDING, hard_acceleration, hard_braking, speeding},
    map_feasibility::{touches_truly, touching_feature},
    person,
    reason::{
        ACROSS_LANES, AGAINST_TRAFFIC, HARD_ACCELERATION, HARD_BRAKING, MIN_DEPTH, Reason, SPEEDS, U_TURN,
        WRONG_LANE,
    },
    turning::{Excess, LATERAL, TURN, fast_turn, tight_turn},
    violation::{LATERAL_ACCELERATION, MEDIAN, TURNING_CIRCLE},
};
use crate::motion::DT;

/// Longest time against the traffic before the contact, seconds.
pub const MAX_AGAINST: f64 = 1.0;

/// Longest time across the lanes before the contact, seconds: 1.5 % of 861 recorded vehicles that follow a lane *now* take
/// longer (`cargo run --release -p sage-data --example recorded_limits`).
pub const MAX_ACROSS: f64 = 2.5;
/// Reasons that `believable-1` does not know.
const NEW: [&str; 8] = [
    TURNING_CIRCLE,
    LATERAL_ACCELERATION,
    HARD_ACCELERATION,
    HARD_BRAKING,
    SPEEDS,
    ACROSS_LANES,
    U_TURN,
    WRONG_LANE,
];

/// All reasons against an attack, given the violations of the paper's rule; empty if it is believable. `None`
/// without contact.
pub fn doubts(situation: &Situation, violations: &[Violation]) -> Option<Vec<Reason>> {
    let Situation { candidate, ego, encounter, ctx } = situation;
    encounter.contact?;
    if ctx.adversary().kind.is_person() {
        return person::doubts(situation);
    }
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
        reasons.push(Reason::shallow(depth));
    }
    let against = against_traffic(situation, Phase::Before);
    // Half a step of tolerance: a time is a count of steps.
    if against > MAX_AGAINST + 0.5 * DT {
        reasons.push(Reason { reason: AGAINST_TRAFFIC.into(), value: against, limit: Some(MAX_AGAINST) });
    }
    let beyond = LIMITS.iter().filter_map(|(reason, exceeds)| {
        let Excess { value, limit, .. } = exceeds(candidate, ctx)?;
        Some(Reason { reason: (*reason).into(), value, limit: Some(limit) })
    });
    reasons.extend(beyond);
    let before = || Phase::Before.steps(encounter);
    let across = across_lanes(candidate, ctx, before());
    if across > MAX_ACROSS + 0.5 * DT {
        reasons.push(Reason { reason: ACROSS_LANES.into(), value: across, limit: Some(MAX_ACROSS) });
    }
    if let Some(step) = u_turn(candidate, ctx, before()) {
        reasons.push(Reason { reason: U_TURN.into(), value: step as f64 * DT, limit: None });
    }
    if let Some(step) = turn_from_wrong_lane(candidate, ctx) {
        reasons.push(Reason { reason: WRONG_LANE.into(), value: step as f64 * DT, limit: None });
    }
    Some(reasons)
}

/// Whether an attack with these reasons against it is believable by `believable-1`.
pub fn holds_1(reasons: &[Reason]) -> bool {
    reasons.iter().all(|reason| NEW.contains(&&*reason.reason))
}

/// Whether an attack is believable: as [`doubts`], but stops at the first reason. `false` without contact.
pub fn is_believable(situation: &Situation) -> bool {
    if situation.ctx.adversary().kind.is_person() {
        return person::doubts(situation).is_some_and(|doubts| doubts.is_empty());
    }
    is_believable_1(situation) && drives_believably(situation)
}

/// What an attack that is believable by `believable-1` needs besides.
pub fn drives_believably(situation: &Situation) -> bool {
    let Situation { candidate, encounter, ctx, .. } = situation;
    let before = || Phase::Before.steps(encounter);
    LIMITS.iter().all(|(_, exceeds)| exceeds(candidate, ctx).is_none())
        && across_lanes(candidate, ctx, before()) <= MAX_ACROSS + 0.5 * DT
        && u_turn(candidate, ctx, before()).is_none()
        && turn_from_wrong_lane(candidate, ctx).is_none()
}

/// How a plan exceeds a limit of a car or of its driver.
type Exceeds = fn(&Candidate, &Context) -> Option<Excess>;

/// Limits of a car and of its driver.
const LIMITS: [(&str, Exceeds); 5] = [
    (TURNING_CIRCLE, |plan, _| tight_turn(plan, TURN)),
    (LATERAL_ACCELERATION, |plan, _| fast_turn(plan, LATERAL)),
    (HARD_ACCELERATION, |plan, ctx| hard_acceleration(plan, ctx, ACCELERATION)),
    (HARD_BRAKING, |plan, ctx| hard_braking(plan, ctx, BRAKING)),
    (SPEEDS, |plan, ctx| speeding(plan, ctx, SPEEDING)),
];

/// Whether an attack is believable by `believable-1`.
pub fn is_believable_1(situation: &Situation) -> bool {
    let Situation { candidate, ego, encounter, ctx } = situation;
    encounter.contact.is_some()
        && contact_depth(candidate, ego) >= MIN_DEPTH
        && touches_truly(candidate, ctx.index().medians()).is_none()
        && MapFeasibility::default().is_feasible(candidate, ctx)
        && against_traffic(situation, Phase::Before) <= MAX_AGAINST + 0.5 * DT
}
