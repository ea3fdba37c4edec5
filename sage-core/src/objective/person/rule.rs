//! The rule for plans of people: within their limits, and through nobody up to the contact.
//!
//! A person may leave the road or step onto it, and cross lanes and medians. What happens after the contact with the ego does not
//! count: nobody walks on. Without a contact on the ego's path all steps count.

use super::PersonLimits;
use crate::{
    geometry::{dot, norm, sub},
    motion::{DT, NOW},
    objective::{
        Candidate, Context, Encounter, Feasibility, Violation,
        violation::{AGENT, AGENT_COST, EDGE_COST},
    },
    registry::{Entry, NoOptions},
    scene::is_one_level,
};

const TOO_FAST: &str = "too_fast";
const HARD_START: &str = "hard_start";
const SHARP_TURN: &str = "sharp_turn";
/// Steps over which accelerations are measured: single steps of recordings are noisy.
const MEAN: usize = 3;
/// Tolerance of accelerations, m/s².
const ROUNDING: f64 = 0.1;

/// The rule `person`.
#[derive(Clone, Copy, Debug, Default)]
pub struct PersonFeasibility;

impl Entry<dyn Feasibility> for PersonFeasibility {
    const NAME: &'static str = "person";
    const SUMMARY: &'static str =
        "of a pedestrian or cyclist: within human limits, through nobody up to the contact";
    const SOURCE: &'static str = "this project; speeds of Euro NCAP, UN R152 and UN R157";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Feasibility>, String> {
        Ok(Box::new(Self))
    }
}

impl Feasibility for PersonFeasibility {
    fn violations(&self, candidate: &Candidate, ctx: &Context) -> Vec<Violation> {
        let contact = Encounter::of(candidate, ctx.ego()).contact;
        violations_before(candidate, ctx, contact.unwrap_or(candidate.horizon()))
    }
}

/// Violations of a plan up to a step.
pub(super) fn violations_before(candidate: &Candidate, ctx: &Context, last: usize) -> Vec<Violation> {
    // A car has the rules of cars.
    let limits = PersonLimits::of(&ctx.adversary().kind);
    let beyond = limits.into_iter().flat_map(|limits| beyond(candidate, ctx, &limits, last));
    beyond.chain(touched(candidate, ctx, last)).collect()
}

/// Limits that a plan breaks up to a step, each at its first step.
fn beyond(candidate: &Candidate, ctx: &Context, limits: &PersonLimits, last: usize) -> Vec<Violation> {
    // A recorded person who is faster *now* may be so: it slows down.
    let now = norm(ctx.adversary().velocity[NOW]);
    let top = limits.top_speed.max(now + ROUNDING);
    let [mut fast, mut hard, mut sharp] = [None; 3];
    for step in 1..=last.min(candidate.horizon()) {
        let velocity = candidate.velocity(step);
        if norm(velocity) > top {
            fast = fast.or(Some(step));
        }
        let before = match step.checked_sub(MEAN) {
            None => continue,
            Some(0) if ctx.adversary().is_valid(NOW) => ctx.adversary().velocity[NOW],
            Some(before) => candidate.velocity(before.max(1)),
        };
        let change = sub(velocity, before).map(|x| x / (MEAN as f64 * DT));
        let speed = norm(velocity);
        // Who stands turns on the spot.
        let (along, across) = if speed < 0.5 {
            (norm(change), 0.0)
        } else {
            let along = dot(change, velocity) / speed;
            (along, (dot(change, change) - along * along).max(0.0).sqrt())
        };
        if along.abs() > limits.acceleration + ROUNDING {
            hard = hard.or(Some(step));
        }
        if across > limits.lateral + ROUNDING {
            sharp = sharp.or(Some(step));
        }
    }
    let at = |step: Option<usize>, rule| Some(Violation::at(candidate, step?, rule, EDGE_COST, ""));
    [at(fast, TOO_FAST), at(hard, HARD_START), at(sharp, SHARP_TURN)].into_iter().flatten().collect()
}

/// The first road user that a plan touches up to a step.
fn touched(candidate: &Candidate, ctx: &Context, last: usize) -> Option<Violation> {
    let last = last.min(candidate.horizon());
    let is_level = |track: usize, step: usize| {
        let own = ctx.adversary();
        let now = if own.is_valid(NOW) { own.ground(NOW) } else { return true };
        is_one_level(ctx.scene().tracks[track].ground(NOW + step), now)
    };
    let first = |other: &crate::objective::OtherAgent| {
        let step = (1..=last).find(|step| {
            other.at(*step).is_some_and(|area| {
                area.intersects(&candidate.boxes()[step - 1]) && is_level(other.track, *step)
            })
        })?;
        Some((step, other.track))
    };
    let near = ctx.others().iter().filter(|other| other.bounds().meets(candidate.bounds()));
    let (step, track) = near.filter_map(first).min()?;
    Some(Violation::at(candidate, step, AGENT, AGENT_COST, &*ctx.scene().tracks[track].id))
}
