//! The required deceleration is bounded, and near-equal approaches have near-equal values.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use approx::assert_relative_eq;
use hand_made::{car, road, score};
use sage_core::objective::criticality::{Criticality, FULL_BRAKING};

/// Measures of a car on the ego's line, which drives at 10 m/s from the origin.
fn measure(at: impl Fn(f64) -> [f64; 2]) -> Criticality {
    let start = at(0.0);
    score(&road(car("a", start, [0.0, 0.0]), vec![]), at).criticality
}

fn value(at: impl Fn(f64) -> [f64; 2]) -> f64 {
    measure(at).required_deceleration.unwrap_or(0.0)
}

/// Drives on the ego's line, ahead by `gap` metres between bumpers, at `speed`.
fn ahead(gap: f64, speed: f64) -> impl Fn(f64) -> [f64; 2] {
    move |t| [4.0 + gap + speed * t, 0.0]
}

/// Approached at `closing` m/s until the gap is `least`, by braking at a constant rate from a distance of `brakes`
/// metres before.
fn stops_short(gap: f64, closing: f64, least: f64, brakes: f64) -> impl Fn(f64) -> [f64; 2] {
    let start = (gap - least - brakes) / closing;
    let rate = closing * closing / (2.0 * brakes);
    move |t| {
        let braked = (t - start).clamp(0.0, closing / rate);
        let closed = closing * t.min(start) + closing * braked - 0.5 * rate * braked * braked;
        [4.0 + gap + 10.0 * t - closed, 0.0]
    }
}

#[test]
fn it_is_the_closing_speed_over_twice_the_time_and_a_frame() {
    // 40 m ahead and 2 m/s slower: 24 m are left at the last step, and contact is 12 s away.
    let found = measure(ahead(40.0, 8.0));
    assert_relative_eq!(found.time_to_collision.unwrap(), 12.0, max_relative = 1e-9);
    assert_relative_eq!(found.required_deceleration.unwrap(), 2.0 / (2.0 * 12.1), max_relative = 1e-9);
    // Driving away: no collision course.
    assert_eq!(measure(ahead(40.0, 12.0)).required_deceleration, None);
    // Beside each other.
    assert_eq!(measure(|t| [10.0 * t, 4.0]).required_deceleration, None);
}

#[test]
fn a_contact_has_the_value_of_its_speed() {
    for (closing, expected) in [(0.5, 2.5), (1.0, 5.0), (1.9, 9.5), (2.0, FULL_BRAKING), (10.0, FULL_BRAKING)]
    {
        let found = measure(ahead(0.333 * closing, 10.0 - closing));
        assert!(found.impact_speed.is_some());
        assert_relative_eq!(found.required_deceleration.unwrap(), expected, max_relative = 1e-6);
    }
}

#[test]
fn it_does_not_depend_on_where_a_contact_falls_between_two_frames() {
    for closing in [0.7, 1.5, 2.0, 4.0, 10.0] {
        let values: Vec<f64> = (0..30)
            .map(|k| value(ahead(5.0 + 0.1 * closing * f64::from(k) / 30.0, 10.0 - closing)))
            .collect();
        for v in &values {
            assert!(*v <= FULL_BRAKING, "{closing}: {v}");
            assert_relative_eq!(*v, values[0], max_relative = 1e-6);
        }
    }
}

#[test]
fn a_stop_just_short_of_contact_is_near_the_contact() {
    // From a gap of 10 m at 4 m/s, stopping with 30 gaps from 0.5 m to a contact that is 6 cm deep.
    let at = |k: i32| value(stops_short(10.0, 4.0, 0.5 - 0.02 * f64::from(k), 6.0));
    let values: Vec<f64> = (0..=29).map(at).collect();
    for pair in values.windows(2) {
        assert!((pair[0] - pair[1]).abs() < 0.5, "{values:?}");
    }
    assert!(values.iter().all(|v| (0.5..3.0).contains(v)), "{values:?}");
}

#[test]
fn thirty_approaches_change_little_by_a_millimetre() {
    for k in 0..30 {
        let k = f64::from(k);
        let (gap, speed, side) = (3.0 + 1.7 * k, 0.3 * k, 0.05 * k);
        // Cuts in from the side, straight ahead, or leaves the ego's line.
        let path = |gap: f64, side: f64, drift: f64| move |t: f64| [4.0 + gap + speed * t, side + drift * t];
        for drift in [0.0, -0.2, 0.4, 1.0] {
            let before = measure(path(gap, side, drift));
            for (moved_gap, moved_side) in [(0.001, 0.0), (-0.001, 0.0), (0.0, 0.001), (0.0, -0.001)] {
                let after = measure(path(gap + moved_gap, side + moved_side, drift));
                let [a, b] = [&before, &after].map(|found| found.required_deceleration.unwrap_or(0.0));
                assert!(a <= FULL_BRAKING && b <= FULL_BRAKING && a.is_finite());
                // A contact is apart: it may appear where boxes just miss each other.
                if before.impact_speed.is_some() == after.impact_speed.is_some() {
                    assert!((a - b).abs() < 0.1, "{gap} {side} {drift}: {a} {b}");
                }
            }
        }
    }
}

#[test]
fn a_course_that_just_touches_differs_little_from_one_that_passes() {
    // Passes at 20 m/s relative, by 30 distances of the sides from 1.5 cm apart to 1.5 cm over each other, and turns
    // away 2 s before contact.
    let at = |k: i32| {
        let side = 2.015 - 0.001 * f64::from(k);
        move |t: f64| [120.0 - 10.0 * t, side + 3.0 * (t - 3.8).max(0.0)]
    };
    let values: Vec<f64> = (0..30).map(|k| value(at(k))).collect();
    assert_eq!(values[0], 0.0);
    for pair in values.windows(2) {
        assert!((pair[0] - pair[1]).abs() < 0.05, "{values:?}");
    }
}
