//! Recordings that end early: scores use the steps that are recorded, and a contact is worth the same in every scene.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use approx::assert_relative_eq;
use hand_made::{candidate, car, context, road, with_feature};
use sage_core::{
    Error,
    motion::{HORIZON, LEAST_HORIZON, NOW},
    objective::{
        Context, ContextOptions, EgoPaths, Naturalness, Scorer, Scores, behavior_penalty, kinematic_penalty,
    },
    scene::{MapKind, Scene, SceneIndex},
};

/// The scene with its first frames, or with more frames in which all stand where they are.
fn with_frames(scene: &Scene, frames: usize) -> Scene {
    let mut scene = scene.clone();
    scene.frames = frames;
    for track in &mut scene.tracks {
        let last = track.valid.len() - 1;
        let (position, heading, size) = (track.position[last], track.heading[last], track.size[last]);
        track.position.resize(frames, position);
        track.heading.resize(frames, heading);
        track.velocity.resize(frames, [0.0; 2]);
        track.size.resize(frames, size);
        track.valid.resize(frames, true);
    }
    scene
}

/// A swerve onto the ego that meets it after `seconds`.
fn swerve(seconds: f64) -> impl Fn(f64) -> [f64; 2] {
    move |t| [10.0 * t, 4.5 - 2.6 * (t / seconds).min(1.0)]
}

fn scores(scene: &Scene, at: impl Fn(f64) -> [f64; 2]) -> Scores {
    let ctx = context(scene);
    Scorer::new(&ctx).scores(&candidate(&ctx, at))
}

fn scene() -> Scene {
    let person = car("p", [200.0, 6.0], [0.0, 0.0]);
    road(car("a", [0.0, 4.5], [10.0, 0.0]), vec![person])
}

#[test]
fn longer_recordings_change_nothing() {
    for seconds in [0.7, 2.0, 4.4, 7.9] {
        let whole = scores(&scene(), swerve(seconds));
        assert_eq!(whole.horizon, HORIZON);
        for frames in [92, 120, 199] {
            assert_eq!(scores(&with_frames(&scene(), frames), swerve(seconds)), whole, "{frames} frames");
        }
    }
}

#[test]
fn a_contact_is_worth_the_same_however_short_the_recording_is() {
    for seconds in [0.8, 1.5, 3.0, 6.0] {
        let whole = scores(&scene(), swerve(seconds));
        let step = whole.collision_step.unwrap();
        for frames in [21, 22, 25, 31, 40, 50, 66, 81, 90] {
            let horizon = frames - NOW - 1;
            let short = scores(&with_frames(&scene(), frames), swerve(seconds));
            assert_eq!(short.horizon, horizon);
            if step <= horizon {
                assert_eq!(short.collision_step, Some(step), "{frames} frames");
                assert_eq!(short.adversarial_reward, whole.adversarial_reward, "{frames} frames");
                assert_relative_eq!(short.adversarial_reward, 10.0 * (1.0 - step as f64 / 80.0));
                assert_eq!(short.criticality.impact_speed, whole.criticality.impact_speed);
            } else {
                assert_eq!((short.collision, short.collision_step), (Some(false), None), "{frames} frames");
                assert!(short.adversarial_reward <= 1.0);
                assert_eq!(short.believable, None);
            }
        }
    }
}

#[test]
fn penalties_are_means_over_the_recorded_steps() {
    // It brakes hard after 3 s: a recording that ends before does not show it.
    let at = |t: f64| [if t < 3.0 { 10.0 * t } else { 30.0 + (t - 3.0).min(0.1) }, 4.5];
    for frames in [21, 31, 41, 42, 60, 91] {
        let scene = with_frames(&scene(), frames);
        let ctx = context(&scene);
        let prepared = candidate(&ctx, at);
        let horizon = frames - NOW - 1;
        assert_eq!((prepared.horizon(), prepared.points().len()), (horizon, horizon));
        assert_eq!(prepared.boxes().len(), horizon);
        assert_eq!(prepared.profile().speed.len(), horizon);
        assert_eq!(prepared.trajectory().points().len(), HORIZON);
        let scores = Scorer::new(&ctx).scores(&prepared);
        assert_eq!(scores.kinematic_penalty, kinematic_penalty(prepared.profile()));
        assert_eq!(scores.behavior_penalty, behavior_penalty(prepared.profile()));
        let is_shown = horizon > 30;
        assert_eq!(scores.kinematic_penalty > 1.9, is_shown, "{frames}: {}", scores.kinematic_penalty);
        assert!(Naturalness::of(&prepared, &ctx).lane_distance.is_finite());
    }
}

#[test]
fn violations_after_the_recording_do_not_count() {
    // It leaves the road after 4 s, and touches the person at 200 m after 20 s, which is never recorded.
    let at = |t: f64| [10.0 * t, if t < 4.0 { 4.5 } else { 4.5 + 3.0 * (t - 4.0) }];
    for frames in [21, 45, 50, 52, 60, 80, 91] {
        let found = scores(&with_frames(&scene(), frames), at);
        let touched = found.violations.iter().map(|violation| violation.step).min();
        match touched {
            Some(step) => assert!(step < frames - NOW && !found.feasible_drivable),
            None => assert!(frames <= 60 && found.feasible, "{frames} frames"),
        }
    }
    assert!(!scores(&scene(), at).feasible);
}

#[test]
fn a_sidewalk_may_be_left_after_the_recording_ends() {
    let outline = [[-100.0, -8.0], [300.0, -8.0], [300.0, -11.0], [-100.0, -11.0], [-100.0, -8.0]];
    let kind = MapKind::from_name("ROAD_EDGE_SIDEWALK");
    let mut scene = road(car("a", [20.0, -9.0], [5.0, 0.0]), vec![]);
    scene.map = Default::default();
    let scene = with_feature(&scene, "walk", kind, &outline);
    for frames in [21, 30, 91] {
        assert!(
            scores(&with_frames(&scene, frames), |t| [20.0 + 5.0 * t, -9.0]).violations_drivable.is_empty()
        );
    }
}

#[test]
fn less_than_a_second_cannot_be_attacked() {
    let index = SceneIndex::new(scene().map.clone());
    for frames in [11, 15, 20] {
        let short = std::sync::Arc::new(with_frames(&scene(), frames));
        let ego = EgoPaths::one("path", vec![[1.0, 0.0]; 80], None).unwrap();
        for ego in [None, Some(ego)] {
            let options = ContextOptions { ego, ..ContextOptions::default() };
            let Err(Error::Scene { problem, .. }) = Context::new(&short, &index, &options) else {
                panic!("{frames} frames are attacked");
            };
            assert!(
                problem.contains(&format!("{frames} frames")) && problem.contains("sage predict"),
                "{problem}"
            );
        }
    }
    assert_eq!(with_frames(&scene(), 21).attackable_horizon().unwrap(), LEAST_HORIZON);
}

#[test]
fn overlapping_now_is_no_attack_whatever_follows() {
    // Boxes of 4 m × 2 m beside each other touch at 2 m.
    for (offset, is_contact) in [
        (0.0, true),
        (1.0, true),
        (1.9, true),
        (1.999, true),
        (2.0, false),
        (2.1, false),
        (-1.0, true),
        (-1.9, true),
    ] {
        for along in [0.0, 1.0, 3.0, 3.9] {
            let scene = road(car("a", [along, offset], [10.0, 0.0]), vec![]);
            let ctx = context(&scene);
            assert_eq!(ctx.is_in_contact_now(), is_contact, "{offset} {along}");
            let found = Scorer::new(&ctx)
                .scores(&candidate(&ctx, |t| [along + 10.0 * t, offset * (1.0 - t).max(0.0)]));
            if is_contact {
                assert_eq!((found.collision, found.collision_step, found.believable), (None, None, None));
                assert!(matches!(ctx.check_apart_now(), Err(Error::ContactNow { .. })));
                assert!(found.adversarial_reward <= 1.0);
            } else {
                assert_eq!(found.collision, Some(true));
                assert!(ctx.check_apart_now().is_ok());
            }
        }
    }
}
