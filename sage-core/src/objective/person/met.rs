//! A contact with a person in a scene: what it looks like, for how long the person was in sight, and why a person would not believe it.

use serde::{Deserialize, Serialize};

use super::{LEAST_SEEN, PersonContact, PersonLimits, rule, seen_for};
use crate::{
    motion::DT,
    objective::{
        Candidate, Context, EgoPath, Reason, Situation,
        reason::{NOT_BY_FRONT, UNSEEN},
    },
    scene::TrackKind,
};

/// A contact with a person in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PersonMet {
    /// What it looks like.
    #[serde(flatten)]
    pub contact: PersonContact,
    /// Seconds for which the person is in sight before it without a break, counted from *now* at most ([`seen_for`]).
    pub seen: f64,
}

impl PersonMet {
    /// The contact of a plan with a path of the ego at a step; `None` if the ego has no box up to there.
    pub fn at(plan: &Candidate, ego: &EgoPath, ctx: &Context, step: usize) -> Option<Self> {
        let contact = PersonContact::at(plan, ego, step)?;
        Some(Self { contact, seen: seen_for(plan, ego, ctx, step) })
    }

    /// Seconds before the contact from which on somebody can know that the person crosses: it is in sight, and walks.
    pub fn noticeable_for(&self) -> f64 {
        self.seen.min(self.contact.walking)
    }

    /// Whether the person was no faster than the clause `strict` allows.
    pub fn is_strict(&self, kind: &TrackKind) -> bool {
        PersonLimits::of(kind).is_some_and(|limits| self.contact.top_speed <= limits.strict_speed)
    }

    /// Why a person would not believe it; empty if it is believable.
    pub fn doubts(&self, plan: &Candidate, ctx: &Context) -> Vec<Reason> {
        let because = |reason: &'static str, value, limit| Reason {
            reason: reason.into(),
            value,
            limit: Some(limit).filter(|_| reason != NOT_BY_FRONT),
        };
        let broken = self.contact.conditions().into_iter().filter(|(_, holds, ..)| !holds);
        let mut doubts: Vec<Reason> =
            broken.map(|(reason, _, value, limit)| because(reason, value, limit)).collect();
        // Half a step of tolerance: a time is a count of steps.
        if self.seen < LEAST_SEEN - 0.5 * DT {
            doubts.push(because(UNSEEN, self.seen, LEAST_SEEN));
        }
        doubts.extend(rule::violations_before(plan, ctx, self.contact.step).iter().map(Reason::violated));
        doubts
    }
}

/// All reasons against an attack by a person; `None` without contact.
pub fn doubts(situation: &Situation) -> Option<Vec<Reason>> {
    let Situation { candidate, ego, encounter, ctx } = situation;
    let met = PersonMet::at(candidate, ego, ctx, encounter.contact?)?;
    Some(met.doubts(candidate, ctx))
}
