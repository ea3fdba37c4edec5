//! Terms and rules of believable attacks against values computed by hand. The ego drives along y = 0 at 10 m/s.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use approx::assert_relative_eq;
use hand_made::{candidate, car, context, road, score, with_feature};
use sage_core::{
    objective::{
        Naturalness, Phase, Reward, Scores, Situation, Violation, against_traffic, feasibilities,
        is_believable, rewards,
    },
    scene::{Lane, MapKind, Scene},
    seed::Rng,
};
use serde_json::{Value, json};

/// Road with an eastbound lane along y = 0 and a westbound one along y = 4.
fn lanes(adversary: [f64; 2], velocity: [f64; 2]) -> Scene {
    let scene = road(car("a", adversary, velocity), vec![]);
    let scene = with_feature(&scene, "east", MapKind::LaneSurfaceStreet, &[[-100.0, 0.0], [300.0, 0.0]]);
    with_feature(&scene, "west", MapKind::LaneSurfaceStreet, &[[300.0, 4.0], [-100.0, 4.0]])
}

fn value(scene: &Scene, name: &str, options: Value, at: impl Fn(f64) -> [f64; 2]) -> Option<f64> {
    let reward: Box<dyn Reward> = rewards().unwrap().build(name, &options).unwrap();
    let ctx = context(scene);
    reward.score(&Situation::new(&candidate(&ctx, at), ctx.ego(), &ctx))
}

fn violations(scene: &Scene, options: Value, at: impl Fn(f64) -> [f64; 2]) -> Vec<Violation> {
    let ctx = context(scene);
    let rule = feasibilities().unwrap().build("drivable", &options).unwrap();
    rule.violations(&candidate(&ctx, at), &ctx)
}

fn rules(violations: &[Violation]) -> Vec<&str> {
    violations.iter().map(|violation| &*violation.rule).collect()
}

fn reasons(scores: &Scores) -> Vec<(&str, f64)> {
    scores.unbelievable.iter().map(|reason| (&*reason.reason, reason.value)).collect()
}

#[test]
fn a_graze_is_not_believable_and_a_solid_contact_is() {
    // Standing beside the ego's path: the sides overlap by 2 m less the distance of the centres.
    for (y, depth) in [(1.4, 0.6), (1.6, 0.4)] {
        let scene = lanes([40.0, y], [0.0, 0.0]);
        let stands = |_| [40.0, y];
        assert_relative_eq!(
            value(&scene, "contact-depth", json!({}), stands).unwrap(),
            depth,
            max_relative = 1e-9
        );
        let scores = score(&scene, stands);
        assert_eq!(scores.believable, Some(depth > 0.5));
        if depth < 0.5 {
            let (reason, value) = reasons(&scores)[0];
            assert_eq!((reason, scores.unbelievable[0].limit), ("contact_depth", Some(0.5)));
            assert_relative_eq!(value, depth, max_relative = 1e-9);
        }
    }
}

#[test]
fn without_contact_there_is_no_verdict() {
    let scene = lanes([20.0, 4.0], [10.0, 0.0]);
    let beside = |t: f64| [20.0 + 10.0 * t, 4.0];
    let scores = score(&scene, beside);
    assert_eq!((scores.believable, scores.unbelievable.len()), (None, 0));
    assert_eq!(value(&scene, "contact-depth", json!({}), beside), None);
    let ctx = context(&scene);
    assert!(!is_believable(&Situation::new(&candidate(&ctx, beside), ctx.ego(), &ctx)));
}

#[test]
fn a_second_against_the_traffic_is_believable_and_more_is_not() {
    // Head-on in the ego's lane, 3.5 m from the lane of its own direction. The fronts meet after
    // (distance − 4 m) / 20 m/s.
    for (distance, seconds) in [(23.9, 1.0), (59.9, 2.8)] {
        let scene = lanes([distance, 0.5], [-10.0, 0.0]);
        let oncoming = |t: f64| [distance - 10.0 * t, 0.5];
        let against = value(&scene, "against-traffic", json!({}), oncoming).unwrap();
        assert_relative_eq!(against, seconds, max_relative = 1e-9);
        let after = value(&scene, "against-traffic", json!({"phase": "after"}), oncoming).unwrap();
        assert_relative_eq!(after, 8.0 - seconds, max_relative = 1e-9);
        let scores = score(&scene, oncoming);
        assert_eq!(scores.believable, Some(seconds <= 1.0), "{:?}", scores.unbelievable);
    }
    // In its own lane it is not against the traffic.
    let scene = lanes([60.0, 2.1], [-10.0, 0.0]);
    assert_eq!(value(&scene, "against-traffic", json!({}), |t| [60.0 - 10.0 * t, 2.1]), Some(0.0));
}

#[test]
fn speed_counts_above_the_limit_of_the_lane_alone() {
    let scene = lanes([60.0, 4.0], [-10.0, 0.0]);
    let mut map = (*scene.map).clone();
    let at = map.features.iter().position(|feature| feature.id == "west").unwrap();
    map.features[at].lane = Some(Box::new(Lane { speed_limit: Some(8.0), ..Lane::default() }));
    let limited = Scene { map: Arc::new(map), ..scene.clone() };
    let at_speed = |speed: f64| move |t: f64| [60.0 - speed * t, 4.0];
    let excess = |scene: &Scene, speed| value(scene, "above-speed-limit", json!({}), at_speed(speed));
    assert_relative_eq!(excess(&limited, 10.0).unwrap(), 2.0, max_relative = 1e-6);
    assert_eq!(excess(&limited, 7.0), Some(0.0));
    // No limit, nothing to measure.
    assert_eq!(excess(&scene, 10.0), None);
}

#[test]
fn a_contact_counts_from_a_depth_on() {
    // The overlap is 0.1 m long at step 10 and 2.1 m at step 11; it is 1.5 m wide.
    let scene = lanes([23.9, 0.5], [-10.0, 0.0]);
    let oncoming = |t: f64| [23.9 - 10.0 * t, 0.5];
    let reward =
        |min_depth: f64| value(&scene, "adversarial", json!({"min_depth": min_depth}), oncoming).unwrap();
    assert_relative_eq!(reward(0.0), 10.0 * (1.0 - 10.0 / 80.0), max_relative = 1e-9);
    assert_relative_eq!(reward(0.5), 10.0 * (1.0 - 11.0 / 80.0), max_relative = 1e-9);
    // Never so deep: closeness, with the centres 0.5 m apart at the step at which they pass.
    let least = (0.5f64.powi(2) + 0.1f64.powi(2)).sqrt();
    assert_relative_eq!(reward(1.6), (-0.2 * least).exp(), max_relative = 1e-9);
    assert!(rewards().unwrap().build("adversarial", &json!({"min_depth": -1})).is_err());
}

#[test]
fn lane_distance_is_weighed_before_and_after_the_contact() {
    // Beside the eastbound lane by 1.4 m until 4 s, then drifting to the right.
    let scene = lanes([30.0, 1.4], [1.0, 0.0]);
    let path = |t: f64| [30.0 + t, 1.4 - 1.2 * (t - 4.0).max(0.0)];
    let contact = score(&scene, path).collision_step.unwrap();
    let mean = |steps: std::ops::RangeInclusive<usize>| {
        let all: Vec<f64> = steps.filter(|s| s % 4 == 0).map(|s| path(0.1 * s as f64)[1].abs()).collect();
        all.iter().sum::<f64>() / all.len() as f64
    };
    let distance = |phase: &str| value(&scene, "lane-distance", json!({"phase": phase}), path).unwrap();
    assert!(contact < 40);
    assert_relative_eq!(distance("before"), 1.4, max_relative = 1e-9);
    assert_relative_eq!(distance("after"), mean(contact + 1..=80), max_relative = 1e-9);
    assert_relative_eq!(distance("whole"), mean(1..=80), max_relative = 1e-9);
    // Without contact there is nothing after it.
    let away = |t: f64| [30.0 + 12.0 * t, 1.4];
    assert_eq!(value(&scene, "lane-distance", json!({"phase": "after"}), away), None);
}

#[test]
fn a_median_bounds_the_road_and_makes_an_attack_unbelievable() {
    let scene = lanes([40.0, 5.0], [0.0, -1.0]);
    let scene = with_feature(&scene, "median", MapKind::EdgeMedian, &[[-100.0, 2.5], [300.0, 2.5]]);
    // The box, 4 m long, reaches y = 2.5 after 0.5 s.
    let across = |t: f64| [40.0, (5.0 - t).max(0.5)];
    let scores = score(&scene, across);
    assert!(scores.feasible && scores.collision == Some(true));
    assert_eq!((scores.believable, scores.feasible_drivable), (Some(false), false));
    let (reason, seconds) = reasons(&scores)[0];
    assert_eq!((reason, scores.unbelievable[0].limit), ("median", None));
    assert_relative_eq!(seconds, 0.5, max_relative = 1e-9);
    let found = violations(&scene, json!({}), across);
    assert_eq!((rules(&found), found[0].step, &found[0].with[..]), (vec!["median"], 5, "median"));
    assert_eq!(violations(&scene, json!({"medians": false}), across), []);
    // From one side to the other between two frames.
    let leap = |t: f64| if t < 0.35 { [40.0, 5.0] } else { [40.0, -1.0] };
    assert_eq!(rules(&violations(&scene, json!({}), leap)), ["median"]);
}

#[test]
fn a_centre_that_left_the_road_through_a_gap_is_off_it() {
    let mut scene = road(car("a", [55.0, 0.0], [0.0, -5.0]), vec![]);
    // The right edge has a gap between x = 50 and x = 60.
    let mut map = (*scene.map).clone();
    map.features.remove(0);
    scene.map = map.into();
    for (id, from, to) in [("before", -100.0, 50.0), ("after", 60.0, 300.0)] {
        scene = with_feature(&scene, id, MapKind::EdgeBoundary, &[[from, -8.0], [to, -8.0]]);
    }
    // Down through the gap, then behind the edge.
    let path = |t: f64| if t < 3.0 { [55.0, -5.0 * t] } else { [55.0 + 8.0 * (t - 3.0), -15.0] };
    let found = violations(&scene, json!({"turn": null, "lateral": null}), path);
    assert_eq!((rules(&found), &found[0].with[..]), (vec!["off_road"], "after"));
    let beyond = path(0.1 * found[0].step as f64);
    assert!(beyond[0] > 60.0 && beyond[0] < 64.0, "{beyond:?}");
}

#[test]
fn without_edges_the_lanes_bound_the_road() {
    let mut scene = lanes([20.0, 0.0], [10.0, 0.0]);
    let mut map = (*scene.map).clone();
    map.features.retain(|feature| feature.kind != MapKind::EdgeBoundary);
    scene.map = map.into();
    // To the right of the eastbound lane: 5 m from it after 5 s, then along it at 5.95 m.
    let leaves = |t: f64| [20.0 + 10.0 * t, -t.min(5.9) - 0.05];
    let found = violations(&scene, json!({}), leaves);
    assert_eq!((rules(&found), found[0].step, &found[0].with[..]), (vec!["off_road"], 50, "east"));
    assert_eq!(violations(&scene, json!({"lane_reach": 9.0}), leaves), []);
    assert_eq!(violations(&lanes([20.0, 0.0], [10.0, 0.0]), json!({}), leaves), [], "edges bound it");
    // Who starts beyond may stay there.
    let scene = Scene { tracks: road(car("a", [20.0, -7.0], [0.0, 0.0]), vec![]).tracks, ..scene };
    assert_eq!(violations(&scene, json!({}), |_| [20.0, -7.0]), []);
}

#[test]
fn time_against_the_traffic_is_the_share_of_steps_that_naturalness_counts() {
    let mut rng = Rng::new(1, "believable", "against the traffic");
    let mut found = [0.0, 0.0];
    for _ in 0..100 {
        let [x, y] = [rng.uniform(20.0, 80.0), rng.uniform(-6.0, 8.0)];
        let (speed, heading, turn) = (rng.uniform(0.0, 15.0), rng.uniform(-3.1, 3.1), rng.uniform(-0.3, 0.3));
        let ctx = context(&lanes([x, y], [speed * heading.cos(), speed * heading.sin()]));
        let arc = candidate(&ctx, |t| {
            let angle = heading + turn * t;
            [x + speed * t * angle.cos(), y + speed * t * angle.sin()]
        });
        let seconds = against_traffic(&Situation::new(&arc, ctx.ego(), &ctx), Phase::Whole);
        let share = Naturalness::of(&arc, &ctx).against_lane;
        assert_relative_eq!(seconds, 8.0 * share, epsilon = 1e-9);
        found = [found[0] + seconds, found[1] + 8.0 - seconds];
    }
    assert!(found.iter().all(|seconds| *seconds > 20.0), "{found:?}: too one-sided");
}
