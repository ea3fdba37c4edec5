//! A failure in a few sentences, from the fields of its explanation alone.

use std::f64::consts::{FRAC_PI_4, PI};

use sage_core::objective::{CollisionType, PersonMet};

use super::{
    Approach, Braking, Deviation, Driving, ExplainedPerson, Explanation, Needed, NeededRoadUser, Shrunk,
    braking::ROUNDING,
};
use crate::search::{Reason, manoeuvre::Manoeuvre};

/// Difference along the way from which a difference across it says nothing, metres.
const FAR: f64 = 10.0;
/// Turn of the ego that is mentioned, rad.
const TURN: f64 = PI / 12.0;
/// Differences that are not mentioned: of places (metres), of speeds (m/s), of turns (rad).
const NEAR: f64 = 0.3;
const SAME_SPEED: f64 = 1.0;
/// Least excess of a speed in between that is mentioned, m/s.
const PASSING: f64 = 0.5;
/// Side-by-side distance that is mentioned however far it is along, metres; length of a long vehicle, metres; braking that is weak, m/s².
const ASIDE: f64 = 1.0;
const LONG: f64 = 7.0;
const WEAK: f64 = 5.0;
const SAME_TURN: f64 = PI / 9.0;
/// Speed below which a car stands, m/s.
const STANDING: f64 = 0.5;
/// Road users that are named.
const NAMED: usize = 3;

impl Explanation {
    /// The failure of a driver with a contact so many seconds after *now*; `deviation` is that of its plan.
    pub fn sentence(&self, ego: &str, after: f64, deviation: Option<&Deviation>) -> String {
        let Driving { speed_now, speed, speeds, turned, manoeuvre } = self.ego;
        if let Some(person) = &self.person {
            return [
                self.person_sentence(person, ego, after),
                self.braking.sentence(),
                self.needed.sentence(),
            ]
            .join(" ");
        }
        let mut does = vec![goes("going", speed_now, speed, speeds)];
        match manoeuvre {
            _ if turned.abs() >= TURN => does.push(format!("turning {}", angle(turned))),
            Some(Manoeuvre::MovesLeft) => does.push("moving left".to_owned()),
            Some(Manoeuvre::MovesRight) => does.push("moving right".to_owned()),
            _ => {}
        }
        let noun = if self.length >= LONG { "long vehicle" } else { "car" };
        let mut who = match (self.approach, self.collision) {
            (None, _) => "the adversary".to_owned(),
            // It has turned since.
            (Some(Approach::Oncoming), Some(collision)) if collision != CollisionType::Oncoming => {
                format!("the {noun} that was oncoming")
            }
            (Some(approach), _) => approach.words(noun),
        };
        if let Some(deviation) = deviation {
            who += &format!(" ({:.1} m/s)", deviation.speed);
        }
        let meets = match self.collision {
            None => format!("collides with {who}"),
            Some(CollisionType::RearEnd) => format!("runs into the rear of {who}"),
            Some(CollisionType::CutIn) => format!("runs into {who}"),
            Some(CollisionType::Crossing | CollisionType::TurningAcross) => {
                format!("meets {who} at an angle")
            }
            Some(CollisionType::Oncoming) => format!("meets {who}, both in opposite directions"),
            Some(CollisionType::Sideswipe) => format!("meets {who}, both in the same direction"),
            Some(CollisionType::RearEnded) => format!("is hit from behind by {who}"),
        };
        let mut sentences = vec![format!("After {after:.1} s {ego}, {}, {meets}.", does.join(" and "))];
        let differs = deviation.map_or("is not recorded up to there".to_owned(), differences);
        sentences.push(format!("That {noun} {differs}."));
        sentences.push(self.braking.sentence());
        sentences.push(self.needed.sentence());
        sentences.extend(self.shrunk.as_ref().and_then(Shrunk::sentence));
        sentences.join(" ")
    }
}

impl Explanation {
    /// Who is met, where and how, and what could be seen of it.
    fn person_sentence(&self, person: &ExplainedPerson, ego: &str, after: f64) -> String {
        let Driving { speed_now, speed, speeds, .. } = self.ego;
        let PersonMet { contact, seen } = person.met;
        let kind = person.kind.to_lowercase();
        let moves = if kind == "cyclist" { "rides" } else { "walks" };
        let beside = 100.0 * contact.offset.abs();
        let place = if beside < 5.0 {
            "the middle of its front".to_owned()
        } else {
            let side = if contact.offset > 0.0 { "left" } else { "right" };
            format!("its front, {beside:.0} % of its width to the {side} of the middle")
        };
        format!(
            "After {after:.1} s {ego}, {}, meets a {kind} from the {} ({:.1} m/s) with {place}. Before the contact the {kind} is in sight for \
             {seen:.1} s and {moves} for {:.1} s.",
            goes("going", speed_now, speed, speeds),
            if contact.from_left { "left" } else { "right" },
            contact.speed,
            contact.walking
        )
    }
}

/// Speeds in words: from, by way of, to.
fn goes(verb: &str, from: f64, to: f64, [low, high]: [f64; 2]) -> String {
    let by = if low < from.min(to) - PASSING {
        format!(" by way of {low:.1}")
    } else if high > from.max(to) + PASSING {
        format!(" by way of {high:.1}")
    } else {
        String::new()
    };
    if by.is_empty() && from.max(to) < STANDING {
        return if verb == "goes" { "stands".to_owned() } else { "standing".to_owned() };
    }
    if by.is_empty() && (from - to).abs() < SAME_SPEED {
        return format!("{verb} at {to:.1} m/s");
    }
    format!("{verb} from {from:.1}{by} to {to:.1} m/s")
}

/// What the adversary does in place of what it was recorded to do.
fn differences(deviation: &Deviation) -> String {
    let Deviation {
        along,
        left,
        speed_now,
        speed,
        speeds,
        recorded_speed,
        recorded_speeds,
        turned,
        recorded_turned,
        ..
    } = *deviation;
    let mut parts = Vec::new();
    let is_beyond =
        speeds[0] < recorded_speeds[0] - SAME_SPEED || speeds[1] > recorded_speeds[1] + SAME_SPEED;
    if is_beyond || (speed - recorded_speed).abs() >= SAME_SPEED {
        let recorded =
            if recorded_speed < STANDING { "stands".to_owned() } else { format!("{recorded_speed:.1}") };
        parts.push(format!("{} (recorded: {recorded})", goes("goes", speed_now, speed, speeds)));
    }
    let turns = (turned - recorded_turned).abs() >= SAME_TURN;
    if turns {
        let later = deviation.turned_later;
        let is_sooner =
            turned.abs() > recorded_turned.abs() && (later - turned).abs() < (later - recorded_turned).abs();
        let more = if is_sooner { ", and more later" } else { "" };
        parts.push(format!("turns {} (recorded: {} then{more})", angle(turned), angle(recorded_turned)));
    } else if recorded_turned.abs() >= FRAC_PI_4 {
        parts.push(format!("turns {} as recorded", angle(turned)));
    }
    let mut metres = Vec::new();
    let rounded = |x: f64| if x.abs() < FAR { format!("{:.1}", x.abs()) } else { format!("{:.0}", x.abs()) };
    let diverges = (turned - recorded_turned).abs() >= FRAC_PI_4;
    if diverges {
        // The recorded direction is not its own any more.
        parts.push(format!("is {} m from where it was recorded", rounded(along.hypot(left))));
    } else if along.abs() >= NEAR {
        metres.push(format!("{} m further {}", rounded(along), if along > 0.0 { "along" } else { "back" }));
    }
    // Beside a way that it does not take any more, or far along it, a side says nothing.
    let is_far = turns || along.abs() >= FAR;
    if left.abs() >= if is_far { ASIDE } else { NEAR } && !diverges {
        metres.push(format!("{} m further {}", rounded(left), if left > 0.0 { "left" } else { "right" }));
    }
    if !metres.is_empty() {
        parts.push(format!("is {} than recorded", metres.join(" and ")));
    }
    if parts.is_empty() { "drives nearly as recorded".to_owned() } else { list(&parts) }
}

/// A turn in degrees, with its side.
fn angle(turn: f64) -> String {
    let degrees = turn.to_degrees().abs().round();
    if degrees < 5.0 {
        return "not".to_owned();
    }
    format!("{degrees}° to the {}", if turn > 0.0 { "left" } else { "right" })
}

impl Braking {
    fn sentence(&self) -> String {
        let Some(time) = self.time_to_brake else {
            return match (self.time_to_steer, self.time_to_evade) {
                (Some(time), _) => {
                    format!(
                        "Braking alone would not have been enough; steering, up to {time:.1} s before the contact, would."
                    )
                }
                (None, Some(time)) => {
                    format!(
                        "Neither braking nor steering alone would have been enough; both, up to {time:.1} s before the contact, would."
                    )
                }
                (None, None) => "No evasive manoeuvre was found.".to_owned(),
            };
        };
        let hardest = self.own_deceleration.unwrap_or_default();
        let own = match (self.brakes_before_contact, self.released_before_contact) {
            (None, None) => "the driver is not braking at the contact".to_owned(),
            (None, Some(released)) => format!(
                "the driver brakes by {hardest:.1} m/s² at most, but releases the brake {released:.1} s before it"
            ),
            (Some(own), _) => {
                format!("the driver brakes from {own:.1} s before it on, by {hardest:.1} m/s² at most")
            }
        };
        let off = self.adversary_off.map_or(String::new(), |off| {
            let known = if self.is_hindsight() { ", which can hardly be seen" } else { "" };
            format!(", when that car was {off:.1} m off its recording{known}")
        });
        let late = match self.brakes_before_contact {
            Some(_) if self.is_hindsight() => String::new(),
            Some(own) if own < time - ROUNDING => {
                let weak = if hardest < WEAK { ", and too weakly" } else { "" };
                format!(": {:.1} s too late{weak}", time - own)
            }
            Some(_) if hardest < WEAK => ": too weakly".to_owned(),
            Some(_) => ": too weakly at first".to_owned(),
            None => String::new(),
        };
        format!("Full braking would have been enough up to {time:.1} s before the contact{off}; {own}{late}.")
    }
}

impl Needed {
    fn sentence(&self) -> String {
        let Some(without) = self.without else { return "No other road user is needed.".to_owned() };
        if !self.is_minimal {
            return format!(
                "Some of {} other road users are needed: without any, {}.",
                self.road_users.len(),
                without.flips()
            );
        }
        let mut named: Vec<String> = self.road_users.iter().take(NAMED).map(NeededRoadUser::words).collect();
        if let more @ 1.. = self.road_users.len().saturating_sub(NAMED) {
            named.push(format!("{more} more"));
        }
        format!("Without {}, {}.", list(&named), without.flips())
    }
}

impl NeededRoadUser {
    /// The road user, and where it is.
    fn words(&self) -> String {
        let side = match self.bearing {
            b if b.abs() <= FRAC_PI_4 => "ahead of",
            b if b.abs() >= PI - FRAC_PI_4 => "behind",
            b if b > 0.0 => "left of",
            _ => "right of",
        };
        let kind = self.kind.to_lowercase().replace('_', " ");
        format!("{kind} {} ({:.0} m {side} the ego now)", self.track, self.distance)
    }
}

impl Shrunk {
    /// How much less of the difference is no failure; `None` if nothing can be said, as a car cannot drive a little less.
    fn sentence(&self) -> Option<String> {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let next = self.less.zip(self.less_is.filter(|reason| *reason != Reason::NoFeasiblePlan));
        let next = next.map(|(less, reason)| (percent(self.share - less), reason.flips()));
        Some(match (self.share < 1.0, next) {
            (true, Some((less, flips))) => format!(
                "With {} of the difference from the recording the driver fails too; with {less}, {flips}.",
                percent(self.share)
            ),
            (true, None) => {
                format!(
                    "With {} of the difference from the recording the driver fails too.",
                    percent(self.share)
                )
            }
            (false, Some((less, flips))) => {
                format!("It is on the edge: with {less} of the difference from the recording, {flips}.")
            }
            (false, None) => return None,
        })
    }
}

impl Reason {
    /// What has changed where a failure is none any more.
    fn flips(self) -> &'static str {
        match self {
            Self::Error => "the driver gives an error",
            Self::NoFeasiblePlan => "no car can drive the plan",
            Self::NeverHit => "there is no contact",
            Self::ContactWithoutAttack => {
                "the first contact is with another road user, or comes without the attack too"
            }
            Self::NotBelievable => "the contact stays, but is not believable",
            Self::NotAtFault => "the contact stays, but is not the driver's fault",
            Self::NotShownAvoidable => "the contact stays, and no evasive manoeuvre is found",
            Self::NotPreventable => "the contact stays, and no reference driver prevents it",
            Self::NotStrict => "the contact stays, but the person is faster",
            Self::NoHumanTime => "the contact stays, but its human time is too short",
            Self::NotInEveryVariant => "the failure does not hold in every variant of the drive",
            Self::Budget => "the drives are used up",
        }
    }
}

/// Parts with commas between them, and "and" before the last.
fn list(parts: &[String]) -> String {
    match parts {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests;
