//! The `paper` convention against values computed by hand.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use approx::assert_relative_eq;
use hand_made::{car, road, score};
use sage_core::{
    motion::Trajectory,
    objective::{
        Context, ContextOptions, EgoPaths, Scorer,
        criticality::{FULL_BRAKING, SideHit},
    },
    scene::{MapFeature, MapKind, SceneIndex},
};

/// ln(1 + e^x).
fn sp(x: f64) -> f64 {
    x.exp().ln_1p()
}

/// P_kin of a straight drive at constant speed.
fn kinematic_floor() -> f64 {
    5.0 * (sp(-7.0) + sp(-6.0) + sp(-0.8))
}

/// P_beh of a straight drive.
fn behavior_floor() -> f64 {
    5.0 * sp(-std::f64::consts::PI)
}

#[test]
fn straight_motion_has_the_floor_of_both_penalties() {
    let scene = road(car("a", [20.0, 4.0], [10.0, 0.0]), vec![]);
    let s = score(&scene, |t| [20.0 + 10.0 * t, 4.0]);
    assert_relative_eq!(s.kinematic_penalty, kinematic_floor(), max_relative = 1e-9);
    assert_relative_eq!(s.kinematic_penalty, 1.8724390876964119, max_relative = 1e-9);
    assert_relative_eq!(s.behavior_penalty, behavior_floor(), max_relative = 1e-9);
    // Beside each other all along: 20 m and 4 m apart.
    assert_relative_eq!(s.adversarial_reward, (-0.2 * 416f64.sqrt()).exp(), max_relative = 1e-9);
    assert!(s.feasible && s.feasible_drivable && s.collision == Some(false));
    assert_eq!(s.criticality.time_to_collision, None);
    assert_eq!(s.criticality.impact_speed, None);
}

#[test]
fn a_standing_car_has_the_same_floor() {
    let scene = road(car("a", [20.0, 4.0], [0.0, 0.0]), vec![]);
    let s = score(&scene, |_| [20.0, 4.0]);
    assert_relative_eq!(s.kinematic_penalty, kinematic_floor(), max_relative = 1e-9);
    assert_relative_eq!(s.behavior_penalty, behavior_floor(), max_relative = 1e-9);
    // The ego passes at a distance of 4 m.
    assert_relative_eq!(s.adversarial_reward, (-0.8f64).exp(), max_relative = 1e-9);
}

#[test]
fn a_circle_is_penalised_for_its_yaw_rate_and_its_total_turn() {
    // Radius 6 m, 6 m/s, away from all edges: chords of 0.6 m up to the chord's own shortening.
    let (r, w) = (6.0, 1.0);
    let scene = road(car("a", [150.0, 0.0 - r], [6.0, 0.0]), vec![]);
    let s = score(&scene, |t| [150.0 + r * (w * t).sin(), -r * (w * t).cos()]);
    let v = 2.0 * r * (0.05f64 * w).sin() / 0.1;
    // Step 1 has neither yaw rate nor acceleration by definition.
    let turning = sp(-7.0) + sp(v * w - 6.0) + sp(w - 0.8);
    let first = sp(-7.0) + sp(-6.0) + sp(-0.8);
    assert_relative_eq!(s.kinematic_penalty, 5.0 * (79.0 * turning + first) / 80.0, max_relative = 1e-9);
    let turned = 7.9 * w;
    let spin = 3.0 * 79.0 / 80.0 * w / (v + 0.01);
    assert_relative_eq!(
        s.behavior_penalty,
        5.0 * sp(turned - std::f64::consts::PI) + spin,
        max_relative = 1e-9
    );
}

#[test]
fn a_collision_is_scored_by_its_step() {
    // The adversary stands 50 m ahead; the ego closes at 10 m/s. Bumpers touch when the centres
    // are 4 m apart: 46 m, so between 4.6 s (a tie) and 4.7 s. Moved by 0.5 m to leave the tie.
    let scene = road(car("a", [50.5, 0.0], [0.0, 0.0]), vec![]);
    let s = score(&scene, |_| [50.5, 0.0]);
    assert_eq!(s.collision_step, Some(47));
    assert_relative_eq!(s.adversarial_reward, 10.0 * (1.0 - 47.0 / 80.0));
    assert_relative_eq!(s.criticality.impact_speed.unwrap(), 10.0, max_relative = 1e-9);
    assert_eq!(s.criticality.side_hit, Some(SideHit::Front));
    assert_eq!(s.criticality.post_encroachment_time, Some(0.0));
    // One frame before the contact the gap is 0.5 m, at 10 m/s.
    assert_relative_eq!(s.criticality.time_to_collision.unwrap(), 0.05, max_relative = 1e-9);
    // 10 m/s within a frame would need 50 m/s², more than any car has.
    assert_eq!(s.criticality.required_deceleration, Some(FULL_BRAKING));
    assert!(s.feasible, "a contact with the ego is not a violation");
}

#[test]
fn a_contact_at_the_last_step_is_a_collision_with_reward_zero() {
    let scene = road(car("a", [83.5, 0.0], [0.0, 0.0]), vec![]);
    let s = score(&scene, |_| [83.5, 0.0]);
    assert_eq!((s.collision_step, s.adversarial_reward), (Some(80), 0.0));
}

#[test]
fn crossing_behind_the_ego_has_a_post_encroachment_time() {
    // The adversary drives north at 1 m/s along x = 40.05; the ego passes that line eastwards.
    let scene = road(car("a", [40.05, -9.05], [0.0, 1.0]), vec![]);
    let s = score(&scene, |t| [40.05, -9.05 + t]);
    assert_eq!(s.collision, Some(false));
    // The ego's 4 m lie over the adversary's 2 m while its centre is within 3 m of 40.05: the last
    // such step is 43. The adversary's nose, 2 m ahead of its centre, reaches y = −1 at 6.05 s:
    // step 61. 18 steps lie between.
    assert_relative_eq!(s.criticality.post_encroachment_time.unwrap(), 1.8, max_relative = 1e-9);
}

#[test]
fn edges_and_agents_are_named_with_their_step() {
    let parked = car("parked", [60.0, -5.0], [0.0, 0.0]);
    let scene = road(car("a", [20.0, -4.0], [10.0, 0.0]), vec![parked]);
    // Straight through the parked car: 40 m away, contact at 36 m less the tie.
    let s = score(&scene, |t| [20.5 + 10.0 * t, -4.0]);
    assert_eq!((s.feasible, s.crash_object, s.cross_line), (false, 10.0, Some(0.0)));
    let violation = &s.violations[0];
    assert_eq!((&*violation.rule, violation.step, &violation.with[..]), ("agent", 36, "parked"));
    // Over the right edge at 2 m/s sideways: side at −5 − 0.2 t reaches −8 …
    let s = score(&scene, |t| [20.0 + t, -4.0 - 2.0 * t]);
    assert_eq!(
        (s.cross_line, &*s.violations[0].rule, &s.violations[0].with[..]),
        (Some(50.0), "road_edge", "right")
    );
    assert!(!s.feasible_drivable);
}

#[test]
fn the_drivable_rule_finds_crossings_between_frames() {
    // 100 m/s across: from y = 3 to y = 13 in one frame, no box touches y = 8.
    let scene = road(car("a", [20.0, 3.0], [0.0, 100.0]), vec![]);
    let s = score(&scene, |t| [20.0, 3.0 + 100.0 * t]);
    assert!(s.feasible, "{:?}", s.violations);
    let rules: Vec<&str> = s.violations_drivable.iter().map(|r| &*r.rule).collect();
    assert_eq!(rules, ["road_edge"]);
    assert_eq!(s.violations_drivable[0].step, 1);
}

#[test]
fn bridges_are_ignored() {
    let mut over = car("over", [60.0, 0.0], [0.0, 0.0]);
    over.position.iter_mut().for_each(|p| p[2] = 7.0);
    let mut scene = road(car("a", [20.0, 0.0], [10.0, 0.0]), vec![over]);
    let mut map = (*scene.map).clone();
    let first = map.points.len();
    map.points.extend([[60.0, -50.0, 6.0], [60.0, 50.0, 6.0]]);
    map.features.push(MapFeature {
        id: "rail".into(),
        kind: MapKind::EdgeBoundary,
        points: first..first + 2,
        lane: None,
    });
    scene.map = map.into();
    let s = score(&scene, |t| [20.0 + 10.0 * t, 0.5 * t]);
    assert_eq!((s.cross_line, s.crash_object), (Some(0.0), 0.0));
    assert!(s.feasible && s.feasible_drivable, "{:?}", s.violations_drivable);
    // A road with one level ignores heights: there they may mean nothing.
    let mut map = (*scene.map).clone();
    map.points.iter_mut().for_each(|point| point[2] = 0.0);
    scene.map = map.into();
    let s = score(&scene, |t| [20.0 + 10.0 * t, 4.0]);
    assert_eq!(s.cross_line, Some(50.0));
}

#[test]
fn an_ego_path_without_headings_takes_them_from_its_motion() {
    let scene = road(car("a", [30.0, 5.5], [0.0, 0.0]), vec![]);
    let (index, scene) = (SceneIndex::new(scene.map.clone()), Arc::new(scene));
    let path = |at: fn(f64) -> [f64; 2]| {
        Trajectory::new("p", (1..=80).map(|t| at(0.1 * t as f64)).collect()).unwrap()
    };
    let positions = path(|t| [30.0, -40.0 + 10.0 * t]);
    let contact = |headings: Option<Vec<f64>>| {
        let ego = Some(EgoPaths::one("ego", positions.points().to_vec(), headings).unwrap());
        let ctx = Context::new(&scene, &index, &ContextOptions { ego, ..ContextOptions::default() }).unwrap();
        Scorer::new(&ctx).scores(&ctx.candidate(path(|_| [30.0, 5.5]))).collision_step
    };
    // Northbound along its own length: contact at y = 5.5 − 1 − 2 = 2.5, step 43 (4.25 s).
    assert_eq!(contact(None), Some(43));
    // With headings to the east its box reaches only 1 m north: y = 3.5, step 44 (4.35 s).
    assert_eq!(contact(Some(vec![0.0; 80])), Some(44));
}
