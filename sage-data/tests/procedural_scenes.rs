//! Procedural scenes pass all checks of recorded scenes, have similar statistics, and can be attacked.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use std::path::Path;
use std::sync::Arc;

use sage_core::{
    geometry::{distance, wrap_angle},
    motion::{NOW, Trajectory},
    objective::{Context, ContextOptions, Scorer},
    scene::{Scene, SceneIndex, TrackKind},
    statistics::{mean, median, quantile},
};
use sage_data::{
    Recording,
    checks::Summary,
    folder,
    procedural::{self, Kind},
};

/// Scenes of every kind for the tests.
fn scenes(each: u64) -> impl Iterator<Item = Scene> {
    Kind::ALL
        .into_iter()
        .flat_map(move |kind| (0..each).map(move |number| procedural::generate(kind, 7, number).unwrap()))
}

#[test]
fn every_scene_passes_the_checks_of_recorded_scenes_in_both_formats() {
    for scene in scenes(8) {
        let recording = Recording::procedural(scene.clone());
        for bytes in [recording.to_pickle().unwrap(), recording.to_native().unwrap()] {
            let read = Recording::from_bytes(Path::new("procedural"), bytes).unwrap();
            // The speed limit is converted to km/h in a pickle.
            assert_eq!(read.scene.tracks, scene.tracks);
            assert_eq!(read.scene.map.points, scene.map.points);
            assert_eq!(read.scene.lights, scene.lights);
            assert_eq!((read.scene.ego, read.scene.adversary), (scene.ego, scene.adversary));
        }
        let warnings = Summary::of("procedural", &scene).warnings;
        assert!(warnings.is_empty(), "{}: {warnings:?}", scene.id);
    }
}

#[test]
fn the_logs_are_feasible_and_some_simple_attack_succeeds() {
    for scene in scenes(20).map(Arc::new) {
        let index = SceneIndex::new(scene.map.clone());
        let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
        let scorer = Scorer::new(&ctx);
        let log = |k: usize| {
            let points = (NOW + 1..=NOW + 80).map(|f| scene.tracks[k].point(f)).collect();
            Trajectory::new("log", points).unwrap()
        };
        let logged = scorer.scores(&ctx.candidate(log(scene.adversary.unwrap())));
        assert!(logged.feasible && !logged.collision, "{}: {:?}", scene.id, logged.violations);
        let ego =
            (*scene).clone().with_roles(Some(&scene.adversary().unwrap().id), Some(&scene.ego().id)).unwrap();
        let swapped = Context::new(&Arc::new(ego), &index, &ContextOptions::default()).unwrap();
        let logged = Scorer::new(&swapped).scores(&swapped.candidate(log(scene.ego)));
        assert!(logged.feasible && !logged.collision, "{}: {:?}", scene.id, logged.violations);
        let hits = procedural::attacks(&scene).into_iter().any(|(_, trajectory)| {
            let s = scorer.scores(&ctx.candidate(trajectory));
            s.collision && s.feasible
        });
        assert!(hits, "{}", scene.id);
    }
}

#[test]
fn lanes_join_smoothly_and_link_to_each_other() {
    for scene in scenes(4) {
        let map = &scene.map;
        let mut joints = 0;
        for (k, feature) in map.features.iter().enumerate() {
            let Some(lane) = &feature.lane else { continue };
            let points = map.points_of(feature);
            for &exit in &lane.exits {
                let next = map.points_of(&map.features[exit]);
                let (a, b) = (points[points.len() - 1], next[0]);
                assert!(distance([a[0], a[1]], [b[0], b[1]]) < 1e-3, "{}", scene.id);
                let course = |p: [f64; 3], q: [f64; 3]| (q[1] - p[1]).atan2(q[0] - p[0]);
                let turn = wrap_angle(course(next[0], next[1]) - course(points[points.len() - 2], a));
                // Half a metre on the tightest curve, of radius 4 m, turns by 0.125.
                assert!(turn.abs() < 0.13, "{}: {turn}", scene.id);
                assert!(map.features[exit].lane.as_ref().unwrap().entries.contains(&k));
                joints += 1;
            }
            for (side, neighbors) in lane.neighbors.iter().enumerate() {
                for n in neighbors {
                    let back = &map.features[n.lane].lane.as_ref().unwrap().neighbors[1 - side];
                    assert!(back.iter().any(|b| b.lane == k), "{}", scene.id);
                }
            }
        }
        assert!(joints > 8, "{}: {joints} joints", scene.id);
    }
}

#[test]
fn a_scene_depends_only_on_kind_seed_and_number() {
    let make = |kind, seed, number| procedural::generate(kind, seed, number).unwrap();
    let here = make(Kind::FourWay, 3, 5);
    let there = std::thread::spawn(move || make(Kind::FourWay, 3, 5)).join().unwrap();
    assert_eq!(here, there);
    assert_ne!(here.content_hash(), make(Kind::FourWay, 3, 6).content_hash());
    assert_ne!(here.content_hash(), make(Kind::FourWay, 4, 5).content_hash());
}

/// Agents, lanes, map points, lane curvature (1/m), speed of moving vehicles (m/s).
const NUMBERS: [&str; 5] = ["agents", "lanes", "map points", "lane curvature", "speed"];

fn numbers(scene: &Scene) -> [Option<f64>; 5] {
    let map = &scene.map;
    let lanes = || map.features.iter().filter(|f| f.kind.is_lane());
    // Angles between chords of about 2 m, divided by length.
    let curvature = |points: &[[f64; 3]]| {
        let mut vertices = vec![points[0]];
        for p in points {
            let last = vertices[vertices.len() - 1];
            if distance([p[0], p[1]], [last[0], last[1]]) >= 2.0 {
                vertices.push(*p);
            }
        }
        let length = 2.0 * (vertices.len() - 1) as f64;
        let courses: Vec<f64> =
            vertices.windows(2).map(|p| (p[1][1] - p[0][1]).atan2(p[1][0] - p[0][0])).collect();
        let turn: f64 = courses.windows(2).map(|c| wrap_angle(c[1] - c[0]).abs()).sum();
        (length >= 6.0).then_some(turn / length)
    };
    let curvatures: Vec<f64> = lanes().filter_map(|f| curvature(map.points_of(f))).collect();
    let speeds: Vec<f64> = scene
        .tracks
        .iter()
        .filter(|t| t.kind == TrackKind::Vehicle)
        .filter_map(|t| {
            let valid = t.velocity.iter().zip(&t.valid).filter(|(_, valid)| **valid);
            let speeds: Vec<f64> = valid.map(|(v, _)| v[0].hypot(v[1])).collect();
            let moves = speeds.iter().any(|v| *v > 2.0);
            mean(&speeds).filter(|_| moves)
        })
        .collect();
    [
        Some(scene.tracks.len() as f64),
        Some(lanes().count() as f64),
        Some(map.points.len() as f64),
        mean(&curvatures),
        mean(&speeds),
    ]
}

/// 5 and 95 % quantiles over the 430 real scenes, rounded inwards.
const RECORDED: [[f64; 2]; 5] =
    [[7.0, 169.0], [50.0, 450.0], [8_000.0, 41_000.0], [0.023, 0.061], [3.4, 15.0]];

#[test]
fn their_medians_are_within_the_recorded_quantiles() {
    let all: Vec<[Option<f64>; 5]> = scenes(30).map(|s| numbers(&s)).collect();
    for (k, name) in NUMBERS.into_iter().enumerate() {
        let values: Vec<f64> = all.iter().filter_map(|n| n[k]).collect();
        let middle = median(&values).unwrap();
        let [low, high] = RECORDED[k];
        println!("{name}: procedural {middle:.4}, recorded {low} to {high}");
        assert!((low..=high).contains(&middle), "{name}: {middle} outside {low} to {high}");
    }
    let Some(data) = real::data() else { return };
    let mut recorded: Vec<[Option<f64>; 5]> = Vec::new();
    let files = folder::scene_files(&data).unwrap();
    folder::in_order(
        &files,
        |path| numbers(&Recording::read(path).unwrap().scene),
        |_, n| {
            recorded.push(n);
            Ok::<(), ()>(())
        },
    )
    .unwrap();
    for (k, name) in NUMBERS.into_iter().enumerate() {
        let values: Vec<f64> = recorded.iter().filter_map(|n| n[k]).collect();
        let [low, middle, high] = [0.05, 0.5, 0.95].map(|share| quantile(&values, share).unwrap());
        println!("{name}: recorded {low:.4} {middle:.4} {high:.4}");
        assert!(low <= RECORDED[k][0] && RECORDED[k][1] <= high, "{name}: {low} to {high}");
    }
}
