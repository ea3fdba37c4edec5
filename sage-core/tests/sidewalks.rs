//! What bounds the road: sidewalks as areas, edges of other kinds, and what a car is on *now*.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use hand_made::{car, road, score, with_feature};
use sage_core::{
    objective::violation::{LATERAL_ACCELERATION, TURNING_CIRCLE},
    scene::{EdgesSinceStart, MapKind, Scene},
};

/// The road whose edges are at ±8 m, without them, with a feature per outline.
fn with_sidewalks(start: [f64; 2], velocity: [f64; 2], kind: &str, outlines: &[&[[f64; 2]]]) -> Scene {
    let mut scene = road(car("a", start, velocity), vec![]);
    scene.map = Default::default();
    for (k, outline) in outlines.iter().enumerate() {
        scene = with_feature(&scene, &format!("walk {k}"), MapKind::from_name(kind), outline);
    }
    scene
}

const SIDEWALK: &str = "ROAD_EDGE_SIDEWALK";
/// A sidewalk of 12 m, wide enough for a car that touches no outline, at the right of the road.
const RIGHT: [[f64; 2]; 5] = [[-100.0, -8.0], [300.0, -8.0], [300.0, -20.0], [-100.0, -20.0], [-100.0, -8.0]];
const NARROW: [[f64; 2]; 5] =
    [[-100.0, -8.0], [300.0, -8.0], [300.0, -11.0], [-100.0, -11.0], [-100.0, -8.0]];

/// Rules of the road that a plan breaks with their first steps: of `paper`, and of `drivable`.
fn broken(scene: &Scene, at: impl Fn(f64) -> [f64; 2]) -> [Vec<(String, usize)>; 2] {
    let scores = score(scene, at);
    // The plans of these tests jump.
    let is_turn = |rule: &str| [TURNING_CIRCLE, LATERAL_ACCELERATION].contains(&rule);
    [&scores.violations, &scores.violations_drivable]
        .map(|all| all.iter().filter(|v| !is_turn(&v.rule)).map(|v| (v.rule.to_string(), v.step)).collect())
}

#[test]
fn nobody_drives_on_a_sidewalk() {
    // Sideways at 2 m/s from y = −4: the right side, at −5 − 0.2 t, reaches −8 after 15 steps.
    let swerve = |t: f64| [20.0 + t, -4.0 - 2.0 * t];
    let straight = |t: f64| [20.0 + 10.0 * t, -4.0];
    let reversed: Vec<[f64; 2]> = RIGHT.iter().rev().copied().collect();
    for (kind, outline, at_edge) in [
        (SIDEWALK, &RIGHT[..], true),
        (SIDEWALK, &reversed, true),
        (SIDEWALK, &NARROW, true),
        (SIDEWALK, &RIGHT[..2], true),
        ("GUARDRAIL", &RIGHT, true),
        ("ROAD_EDGE_UNKNOWN", &RIGHT[..2], true),
        ("ROAD_EDGE_BOUNDARY", &RIGHT[..2], true),
        ("ROAD_EDGE_WALL", &RIGHT[..2], true),
        ("CROSSWALK", &RIGHT, false),
        ("UNKNOWN", &RIGHT[..2], false),
        ("ROAD_LINE_SOLID_SINGLE_WHITE", &RIGHT[..2], false),
    ] {
        let scene = with_sidewalks([20.0, -4.0], [1.0, -2.0], kind, &[outline]);
        let [paper, drivable] = broken(&scene, swerve);
        let first = |all: &[(String, usize)]| all.first().map(|(rule, step)| (rule.clone(), *step));
        let expected = at_edge.then(|| "road_edge".to_owned());
        for (rule, found) in [("paper", first(&paper)), ("drivable", first(&drivable))] {
            assert_eq!(found.as_ref().map(|(rule, _)| rule.clone()), expected, "{kind} {rule}");
            assert!(found.is_none_or(|(_, step)| step <= 16), "{kind} {rule}");
        }
        let scores = score(&scene, straight);
        assert_eq!(broken(&scene, straight), [vec![], vec![]], "{kind}");
        assert_eq!(scores.cross_line, at_edge.then_some(0.0), "{kind}");
    }
}

#[test]
fn a_box_wholly_on_a_sidewalk_is_off_the_road() {
    // Beyond the outline from the first step on, after a jump that no frame sees.
    let scene = with_sidewalks([20.0, -4.0], [10.0, 0.0], SIDEWALK, &[&RIGHT]);
    let inside = |t: f64| [20.0 + 10.0 * t, -14.0];
    let [paper, drivable] = broken(&scene, inside);
    assert_eq!(paper, [("road_edge".to_owned(), 1)]);
    assert_eq!(drivable, [("road_edge".to_owned(), 1)]);
    // Only later.
    let later = |t: f64| if t < 2.05 { [20.0 + 10.0 * t, -4.0] } else { inside(t) };
    assert_eq!(broken(&scene, later)[0], [("road_edge".to_owned(), 21)]);
    // Of several sidewalks the first that is met is named.
    let far: Vec<[f64; 2]> = RIGHT.iter().map(|[x, y]| [*x, *y - 50.0]).collect();
    let scene = with_sidewalks([20.0, -4.0], [10.0, 0.0], SIDEWALK, &[&far, &RIGHT]);
    assert_eq!(score(&scene, inside).violations[0].with, "walk 1");
}

#[test]
fn a_sidewalk_that_a_car_is_on_now_counts_when_it_was_left() {
    let leave = |t: f64| [20.0 + 5.0 * t, -9.0 + 1.0 * t.min(4.0)];
    let stay = |t: f64| [20.0 + 5.0 * t, -9.0];
    let back = |t: f64| [20.0 + 5.0 * t, if t < 4.0 { -9.0 + t } else { -5.0 - 2.0 * (t - 4.0) }];
    let scene = with_sidewalks([20.0, -9.0], [5.0, 0.0], SIDEWALK, &[&NARROW]);
    for (name, path, drives) in
        [("leave", &leave as &dyn Fn(f64) -> [f64; 2], true), ("stay", &stay, true), ("back", &back, false)]
    {
        let scores = score(&scene, path);
        assert!(!scores.feasible, "`paper` counts every touch: {name}");
        assert_eq!(scores.feasible_drivable, drives, "{name}: {:?}", scores.violations_drivable);
    }
    // Wholly on it, it may leave it too; another sidewalk counts.
    let scene = with_sidewalks([20.0, -14.0], [5.0, 0.0], SIDEWALK, &[&RIGHT]);
    assert!(score(&scene, |t: f64| [20.0 + 5.0 * t, -14.0 + 2.0 * t.min(5.0)]).feasible_drivable);
    let across = [[60.0, -3.0], [90.0, -3.0], [90.0, 1.0], [60.0, 1.0], [60.0, -3.0]];
    let scene = with_sidewalks([20.0, -14.0], [5.0, 0.0], SIDEWALK, &[&RIGHT, &across]);
    let found = score(&scene, |t: f64| [20.0 + 10.0 * t, -14.0 + 2.5 * t.min(5.0)]);
    assert_eq!(found.violations_drivable[0].with, "walk 1");
}

#[test]
fn a_map_without_edges_does_not_measure_whether_one_is_crossed() {
    let scene = with_sidewalks([20.0, -4.0], [1.0, -2.0], SIDEWALK, &[]);
    let scores = score(&scene, |t: f64| [20.0 + t, -4.0 - 2.0 * t]);
    assert_eq!((scores.cross_line, scores.feasible), (None, true));
    // A median alone bounds `drivable`, and is no boundary for the other rule.
    let median = [[-100.0, -8.0], [300.0, -8.0]];
    let scene = with_sidewalks([20.0, -4.0], [1.0, -2.0], "ROAD_EDGE_MEDIAN", &[&median]);
    let scores = score(&scene, |t: f64| [20.0 + t, -4.0 - 2.0 * t]);
    assert_eq!((scores.cross_line, scores.feasible, scores.feasible_drivable), (None, true, false));
    assert!(scene.map.has_edges());
}

#[test]
fn an_edge_is_continued_by_one_that_begins_where_it_ends() {
    let line = |from: [f64; 2], to: [f64; 2]| vec![from, to];
    for (a, b, kinds, expected) in [
        (line([0.0, 0.0], [9.0, 0.0]), line([9.0, 0.0], [20.0, 0.0]), ["ROAD_EDGE_BOUNDARY"; 2], true),
        (line([0.0, 0.0], [9.0, 0.0]), line([20.0, 0.0], [9.5, 0.5]), ["ROAD_EDGE_BOUNDARY"; 2], true),
        (line([0.0, 0.0], [9.0, 0.0]), line([11.0, 0.0], [20.0, 0.0]), ["ROAD_EDGE_BOUNDARY"; 2], false),
        (line([0.0, 0.0], [9.0, 0.0]), line([0.0, 7.0], [9.0, 7.0]), ["ROAD_EDGE_BOUNDARY"; 2], false),
        (line([0.0, 0.0], [9.0, 0.0]), line([9.0, 0.0], [20.0, 0.0]), ["ROAD_EDGE_MEDIAN"; 2], true),
        (
            line([0.0, 0.0], [9.0, 0.0]),
            line([9.0, 0.0], [20.0, 0.0]),
            ["ROAD_EDGE_MEDIAN", "ROAD_EDGE_BOUNDARY"],
            false,
        ),
        (RIGHT.to_vec(), RIGHT.iter().map(|[x, y]| [x + 400.1, *y]).collect(), [SIDEWALK; 2], true),
        (RIGHT.to_vec(), RIGHT.iter().map(|[x, y]| [x + 402.0, *y]).collect(), [SIDEWALK; 2], false),
    ] {
        let mut scene = with_sidewalks([0.0, 0.0], [1.0, 0.0], kinds[0], &[&a]);
        scene = with_feature(&scene, "b", MapKind::from_name(kinds[1]), &b);
        for (edge, by) in [(0, 1), (1, 0)] {
            // What touches an edge from the start may go on to the one that continues it.
            let found = EdgesSinceStart::new(&[edge]).follow(&[edge, by], &scene.map);
            assert_eq!(found, (!expected).then_some(by), "{a:?} {b:?}");
        }
    }
}
