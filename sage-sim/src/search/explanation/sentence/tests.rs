//! Sentences of explanations made by hand. A failed unwrap is a failed test.

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
        person: None,
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
    assert!(differences(&races).starts_with("goes from 7.9 by way of 12.0 to 8.1 m/s (recorded: 8.0) and"));
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
    assert!(words(Braking { brakes_before_contact: Some(1.6), ..braking }).ends_with("at most: too weakly."));
    let hidden = Braking { adversary_off: Some(0.1), ..braking };
    let expected = "when that car was 0.1 m off its recording, which can hardly be seen; the driver brakes";
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
