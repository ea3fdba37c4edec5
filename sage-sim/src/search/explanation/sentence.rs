//! A failure in a few sentences, from the fields of its explanation alone.

use std::f64::consts::{FRAC_PI_4, PI};

use sage_core::objective::CollisionType;

use super::{
    Approach, Braking, Deviation, Driving, Explanation, Needed, NeededRoadUser, Shrunk, braking::ROUNDING,
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
            Some(_) => ": too weakly".to_owned(),
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
mod tests {
    use sage_core::motion::{HORIZON, Trajectory};

    use super::*;
    use crate::search::Clauses;

    fn deviation() -> Deviation {
        Deviation {
            acceleration: 1.2,
            along: 0.4,
            left: 0.9,
            speed_now: 7.9,
            speed: 8.1,
            speeds: [7.9, 8.1],
            recorded_speed: 8.0,
            recorded_speeds: [7.9, 8.1],
            turned: 0.02,
            recorded_turned: 0.0,
            turned_later: 0.0,
        }
    }

    fn explanation() -> Explanation {
        let trajectory = Trajectory::new("plan", vec![[0.0; 2]; HORIZON]).unwrap();
        Explanation {
            approach: Some(Approach::Oncoming),
            collision: Some(CollisionType::Oncoming),
            ego: Driving { speed_now: 11.0, speed: 9.0, speeds: [9.0, 11.0], turned: 0.6, manoeuvre: None },
            length: 4.5,
            shrunk: Some(Shrunk {
                share: 1.0,
                acceleration: 1.2,
                trajectory,
                contact: None,
                clauses: Clauses::default(),
                less: Some(0.01),
                less_is: Some(Reason::NotBelievable),
            }),
            needed: Needed { road_users: Vec::new(), is_minimal: true, without: None },
            braking: Braking {
                brakes_before_contact: Some(0.2),
                released_before_contact: None,
                own_deceleration: Some(2.34),
                adversary_off: Some(0.8),
                time_to_brake: Some(1.6),
                time_to_steer: None,
                time_to_evade: Some(1.6),
            },
            drives: 3,
        }
    }

    #[test]
    fn a_failure_is_told_in_a_few_sentences() {
        assert_eq!(
            explanation().sentence("idm", 2.0, Some(&deviation())),
            "After 2.0 s idm, going from 11.0 to 9.0 m/s and turning 34° to the left, meets the oncoming car (8.1 m/s), \
             both in opposite directions. \
             That car is 0.4 m further along and 0.9 m further left than recorded. \
             Full braking would have been enough up to 1.6 s before the contact, when that car was 0.8 m off its recording; \
             the driver brakes from 0.2 s before it on, by 2.3 m/s² at most: 1.4 s too late, and too weakly. \
             No other road user is needed. \
             It is on the edge: with 99 % of the difference from the recording, the contact stays, but is not believable."
        );
        let unknown = Explanation { approach: None, collision: None, shrunk: None, ..explanation() };
        let words = unknown.sentence("idm", 2.0, None);
        let expected = "collides with the adversary. That car is not recorded up to there. Full braking";
        assert!(words.contains(expected), "{words}");
        assert!(words.ends_with("No other road user is needed."));
    }

    #[test]
    fn speeds_are_told_with_what_lies_between() {
        assert_eq!(goes("goes", 8.0, 8.4, [7.8, 8.5]), "goes at 8.4 m/s");
        assert_eq!(goes("goes", 8.0, 2.0, [2.0, 8.0]), "goes from 8.0 to 2.0 m/s");
        assert_eq!(goes("goes", 11.0, 8.0, [6.5, 11.0]), "goes from 11.0 by way of 6.5 to 8.0 m/s");
        assert_eq!(goes("going", 17.0, 12.0, [12.0, 22.3]), "going from 17.0 by way of 22.3 to 12.0 m/s");
        assert_eq!(goes("going", 0.1, 0.2, [0.0, 0.2]), "standing");
    }

    #[test]
    fn places_are_told_by_what_they_say() {
        let far = Deviation {
            along: -50.4,
            left: 0.7,
            speed: 2.1,
            recorded_speeds: [7.9, 8.0],
            speeds: [2.1, 7.9],
            ..deviation()
        };
        let words = "goes from 7.9 to 2.1 m/s (recorded: 8.0) and is 50 m further back than recorded";
        assert_eq!(differences(&far), words);
        let goes = Deviation { recorded_speed: 0.0, along: 5.0, left: 0.0, ..deviation() };
        let words = "goes at 8.1 m/s (recorded: stands) and is 5.0 m further along than recorded";
        assert_eq!(differences(&goes), words);
        let aside = Deviation { along: -11.0, left: 3.1, ..deviation() };
        assert_eq!(differences(&aside), "is 11 m further back and 3.1 m further left than recorded");
        let races = Deviation { speeds: [7.9, 12.0], ..deviation() };
        assert!(
            differences(&races).starts_with("goes from 7.9 by way of 12.0 to 8.1 m/s (recorded: 8.0) and")
        );
        let same = Deviation { along: 0.1, left: 0.0, ..deviation() };
        assert_eq!(differences(&same), "drives nearly as recorded");
    }

    #[test]
    fn turns_are_told_in_degrees_with_what_the_recording_does_then_and_later() {
        let turns = Deviation { turned: 0.9, along: 1.0, left: -3.0, ..deviation() };
        let words = "turns 52° to the left (recorded: not then) and is 3.2 m from where it was recorded";
        assert_eq!(differences(&turns), words);
        let both = Deviation { turned: 1.4, recorded_turned: 1.5, along: 0.0, left: 0.0, ..turns };
        assert_eq!(differences(&both), "turns 80° to the left as recorded");
        let sooner = Deviation { turned_later: 1.5, recorded_turned: 0.3, ..turns };
        assert!(differences(&sooner).contains("(recorded: 17° to the left then, and more later)"));
        let less = Deviation { turned: -0.2, recorded_turned: -0.9, turned_later: -1.5, ..turns };
        assert!(differences(&less).contains("turns 11° to the right (recorded: 52° to the right then)"));
    }

    #[test]
    fn braking_is_late_weak_missing_or_not_enough() {
        let braking = explanation().braking;
        let words = |braking: Braking| braking.sentence();
        let none = Braking { brakes_before_contact: None, own_deceleration: None, ..braking };
        assert!(words(none).ends_with("the driver is not braking at the contact."));
        let released = Braking { released_before_contact: Some(0.4), own_deceleration: Some(4.0), ..none };
        let expected = "the driver brakes by 4.0 m/s² at most, but releases the brake 0.4 s before it.";
        assert!(words(released).ends_with(expected), "{}", words(released));
        assert_eq!(released.class(), "releases the brake");
        assert!(
            words(Braking { brakes_before_contact: Some(1.6), ..braking }).ends_with("at most: too weakly.")
        );
        let hidden = Braking { adversary_off: Some(0.1), ..braking };
        let expected =
            "when that car was 0.1 m off its recording, which can hardly be seen; the driver brakes";
        assert!(words(hidden).contains(expected) && !words(hidden).contains("late"), "{}", words(hidden));
        assert_eq!(hidden.class(), "would have to know the plan");
        let steers = Braking { time_to_brake: None, ..braking };
        assert!(words(steers).starts_with("Neither braking nor steering"));
        assert!(words(Braking { time_to_steer: Some(0.9), ..steers }).contains("steering, up to 0.9 s"));
        assert_eq!(words(Braking { time_to_evade: None, ..steers }), "No evasive manoeuvre was found.");
    }

    #[test]
    fn needed_road_users_are_named_with_their_place() {
        let user = |track: &str, bearing| NeededRoadUser {
            track: track.to_owned(),
            kind: "VEHICLE".to_owned(),
            distance: 26.2,
            bearing,
        };
        let needed = |road_users: Vec<NeededRoadUser>, is_minimal| Needed {
            road_users,
            is_minimal,
            without: Some(Reason::NeverHit),
        };
        assert_eq!(
            needed(vec![user("97", 0.1)], true).sentence(),
            "Without vehicle 97 (26 m ahead of the ego now), there is no contact."
        );
        let five = (0..5).map(|k| user(&k.to_string(), 2.0)).collect::<Vec<_>>();
        let words = needed(five.clone(), true).sentence();
        assert!(words.contains("vehicle 2 (26 m left of the ego now) and 2 more, there is"), "{words}");
        assert!(needed(five, false).sentence().starts_with("Some of 5 other road users are needed"));
    }

    #[test]
    fn a_shrunk_failure_says_how_much_less_is_none() {
        let shrunk = explanation().shrunk.unwrap();
        let half = Shrunk { share: 0.52, less: Some(0.03), less_is: Some(Reason::NeverHit), ..shrunk };
        assert_eq!(
            half.sentence().unwrap(),
            "With 52 % of the difference from the recording the driver fails too; with 49 %, there is no contact."
        );
        let all = Shrunk { less: None, less_is: None, share: 0.03, ..half.clone() };
        assert_eq!(
            all.sentence().unwrap(),
            "With 3 % of the difference from the recording the driver fails too."
        );
        let edge = Shrunk { share: 1.0, less: Some(0.01), less_is: Some(Reason::NoFeasiblePlan), ..half };
        assert_eq!(edge.sentence(), None, "what a car cannot drive says nothing of the driver");
    }
}
