//! A failure in a few sentences, from the fields of its explanation alone.

use std::f64::consts::{FRAC_PI_4, PI};

use super::{Braking, Deviation, Explanation, Needed, NeededRoadUser, Shrunk, braking::ROUNDING};
use crate::search::{Reason, manoeuvre::Manoeuvre};

/// Difference along the way up to which metres say more than speeds.
const METRES: f64 = 4.0;
/// Differences that are not mentioned, metres: alone, and beside others.
const NOTHING: f64 = 0.05;
const LITTLE: f64 = 0.3;
/// Road users that are named.
const NAMED: usize = 3;

impl Explanation {
    /// The failure of a driver with a contact so many seconds after *now*; `deviation` is that of its plan.
    pub fn sentence(&self, ego: &str, after: f64, deviation: Option<&Deviation>) -> String {
        let who = self.approach.map_or("the adversary", |approach| approach.words());
        let differs = deviation.map_or("follows its plan".to_owned(), differences);
        let mut sentences = vec![format!("{ego} fails {after:.1} s after now, when {who} {differs}.")];
        sentences.push(self.braking.sentence());
        sentences.push(self.needed.sentence());
        sentences.extend(self.shrunk.as_ref().map(Shrunk::sentence));
        sentences.join(" ")
    }
}

/// What the adversary does in place of what it was recorded to do.
fn differences(deviation: &Deviation) -> String {
    let Deviation { along, left, speed, recorded_speed, stands, manoeuvre, recorded_manoeuvre, .. } =
        *deviation;
    let is_far = along.abs() >= METRES;
    let mut parts = Vec::new();
    if is_far && stands {
        parts.push(format!("has stopped, in place of {recorded_speed:.1} m/s on average"));
    } else if is_far {
        parts.push(format!("drives {speed:.1} m/s on average in place of {recorded_speed:.1}"));
    }
    if manoeuvre != recorded_manoeuvre {
        if sideways(manoeuvre).is_some() {
            parts.push(format!("{} (recorded: {})", manoeuvre.words(), recorded_manoeuvre.words()));
        } else if let Some(recorded) = sideways(recorded_manoeuvre) {
            parts.push(format!("does not {recorded} as recorded"));
        }
    }
    let mut metres = Vec::new();
    if !is_far && along.abs() >= NOTHING {
        metres.push(format!("{:.1} m further {}", along.abs(), if along > 0.0 { "along" } else { "back" }));
    }
    if left.abs() >= if parts.is_empty() { NOTHING } else { LITTLE } {
        let side = if left > 0.0 { "left" } else { "right" };
        metres.push(format!("{:.1} m further {side}", left.abs()));
    }
    if !metres.is_empty() {
        parts.push(format!("is {} than recorded", metres.join(" and ")));
    }
    if parts.is_empty() { "drives as recorded".to_owned() } else { list(&parts) }
}

/// What a car does that leaves its way.
fn sideways(manoeuvre: Manoeuvre) -> Option<&'static str> {
    match manoeuvre {
        Manoeuvre::TurnsLeft => Some("turn left"),
        Manoeuvre::TurnsRight => Some("turn right"),
        Manoeuvre::MovesLeft => Some("move left"),
        Manoeuvre::MovesRight => Some("move right"),
        _ => None,
    }
}

impl Braking {
    fn sentence(&self) -> String {
        let Some(time) = self.time_to_brake else {
            return match (self.time_to_steer, self.time_to_evade) {
                (Some(time), _) => format!(
                    "Braking alone would not have been enough; steering, up to {time:.1} s before the contact, would."
                ),
                (None, Some(time)) => format!(
                    "Neither braking nor steering alone would have been enough; both together, up to {time:.1} s before the contact, would."
                ),
                (None, None) => "No evasive manoeuvre was found.".to_owned(),
            };
        };
        let own = match self.brakes_before_contact {
            None => "the driver does not brake".to_owned(),
            Some(own) if own < time - ROUNDING => {
                format!("the driver brakes {own:.1} s before it, {:.1} s too late", time - own)
            }
            Some(own) => format!("the driver brakes from {own:.1} s before it on, too weakly"),
        };
        format!("Full braking, up to {time:.1} s before the contact, would have been enough; {own}.")
    }
}

impl Needed {
    fn sentence(&self) -> String {
        let Some(without) = self.without else { return "No other road user is needed.".to_owned() };
        if !self.is_minimal {
            return format!(
                "The failure needs other road users, some of {}: without any, {}.",
                self.road_users.len(),
                without.flips()
            );
        }
        let mut named: Vec<String> = self.road_users.iter().take(NAMED).map(NeededRoadUser::words).collect();
        if let more @ 1.. = self.road_users.len().saturating_sub(NAMED) {
            named.push(format!("{more} more"));
        }
        let them = if self.road_users.len() == 1 { "it" } else { "them" };
        format!("The failure needs {}: without {them}, {}.", list(&named), without.flips())
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
        format!("{kind} {} ({:.0} m {side} the ego)", self.track, self.distance)
    }
}

impl Shrunk {
    fn sentence(&self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let too =
            format!("With {} of the difference from the recording the driver fails too", percent(self.share));
        match (self.less, self.less_is) {
            (Some(less), Some(reason)) if self.share < 1.0 => {
                format!("{too}; with {}, {}.", percent(self.share - less), reason.flips())
            }
            (Some(less), Some(reason)) => {
                format!(
                    "With {} of the difference from the recording, {}.",
                    percent(1.0 - less),
                    reason.flips()
                )
            }
            _ => format!("{too}."),
        }
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
                "the first contact is with another, or comes without the attack too"
            }
            Self::NotBelievable => "there is a contact, but no believable one",
            Self::NotAtFault => "there is a contact, but not at fault",
            Self::NotShownAvoidable => "there is a contact, but no evasive manoeuvre is found",
            Self::NotPreventable => "there is a contact, but no reference driver prevents it",
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
    use crate::search::{Clauses, explanation::Approach};

    fn deviation() -> Deviation {
        Deviation {
            acceleration: 1.2,
            along: 0.4,
            left: 0.9,
            speed: 8.1,
            recorded_speed: 8.0,
            stands: false,
            manoeuvre: Manoeuvre::DrivesOn,
            recorded_manoeuvre: Manoeuvre::DrivesOn,
        }
    }

    fn explanation() -> Explanation {
        let trajectory = Trajectory::new("plan", vec![[0.0; 2]; HORIZON]).unwrap();
        Explanation {
            approach: Some(Approach::Oncoming),
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
            "idm fails 2.0 s after now, when the oncoming car is 0.4 m further along and 0.9 m further left than recorded. \
             Full braking, up to 1.6 s before the contact, would have been enough; the driver brakes 0.2 s before it, 1.4 s too late. \
             No other road user is needed. \
             With 99 % of the difference from the recording, there is a contact, but no believable one."
        );
        let unknown = Explanation { approach: None, shrunk: None, ..explanation() };
        let words = unknown.sentence("idm", 2.0, None);
        assert!(words.starts_with("idm fails 2.0 s after now, when the adversary follows its plan. Full"));
        assert!(words.ends_with("No other road user is needed."));
    }

    #[test]
    fn far_along_the_way_speeds_say_more_than_metres() {
        let far = Deviation { along: -50.4, left: 0.2, speed: 2.1, ..deviation() };
        assert_eq!(differences(&far), "drives 2.1 m/s on average in place of 8.0");
        let stands = Deviation { stands: true, left: 0.4, ..far };
        let words = "has stopped, in place of 8.0 m/s on average and is 0.4 m further left than recorded";
        assert_eq!(differences(&stands), words);
        assert_eq!(differences(&Deviation { along: 0.0, left: 0.0, ..deviation() }), "drives as recorded");
    }

    #[test]
    fn a_manoeuvre_is_named_if_the_recording_has_another() {
        use Manoeuvre::{Brakes, MovesLeft, TurnsLeft};
        let turns = Deviation { manoeuvre: TurnsLeft, along: 1.0, left: -3.0, ..deviation() };
        assert_eq!(
            differences(&turns),
            "turns left (recorded: drives on) and is 1.0 m further along and 3.0 m further right than recorded"
        );
        let stays = Deviation {
            manoeuvre: Brakes,
            recorded_manoeuvre: MovesLeft,
            along: -9.0,
            left: -0.1,
            ..deviation()
        };
        assert_eq!(
            differences(&stays),
            "drives 8.1 m/s on average in place of 8.0 and does not move left as recorded"
        );
    }

    #[test]
    fn braking_is_late_weak_missing_or_not_enough() {
        let braking = explanation().braking;
        let words = |braking: Braking| braking.sentence();
        assert!(
            words(Braking { brakes_before_contact: None, ..braking }).ends_with("driver does not brake.")
        );
        assert!(words(Braking { brakes_before_contact: Some(1.6), ..braking }).ends_with("too weakly."));
        let none = Braking { time_to_brake: None, ..braking };
        assert!(words(none).starts_with("Neither braking nor steering"));
        assert!(words(Braking { time_to_steer: Some(0.9), ..none }).contains("steering, up to 0.9 s"));
        assert_eq!(words(Braking { time_to_evade: None, ..none }), "No evasive manoeuvre was found.");
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
            "The failure needs vehicle 97 (26 m ahead of the ego): without it, there is no contact."
        );
        let five = (0..5).map(|k| user(&k.to_string(), 2.0)).collect::<Vec<_>>();
        let words = needed(five.clone(), true).sentence();
        assert!(words.contains("vehicle 2 (26 m left of the ego) and 2 more: without them"), "{words}");
        assert!(needed(five, false).sentence().starts_with("The failure needs other road users, some of 5"));
    }

    #[test]
    fn a_shrunk_failure_says_how_much_less_is_none() {
        let shrunk = explanation().shrunk.unwrap();
        let half = Shrunk { share: 0.52, less: Some(0.03), less_is: Some(Reason::NeverHit), ..shrunk };
        assert_eq!(
            half.sentence(),
            "With 52 % of the difference from the recording the driver fails too; with 49 %, there is no contact."
        );
        let all = Shrunk { less: None, less_is: None, share: 0.03, ..half };
        assert_eq!(all.sentence(), "With 3 % of the difference from the recording the driver fails too.");
    }
}
