//! Procedural scenes pass all checks of recorded scenes, have similar statistics, and can be attacked.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use std::path::Path;
use std::sync::Arc;

use sage_core::{
    geometry::{Point, cross, distance, sub, wrap_angle},
    motion::{NOW, Trajectory},
    objective::{Context, ContextOptions, Scorer},
    scene::{MapFeature, MapKind, Scene, SceneIndex, TrackKind},
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
fn a_stop_sign_names_its_lanes_in_both_formats() {
    let mut scene = procedural::generate(Kind::FourWay, 7, 0).unwrap();
    let map = Arc::make_mut(&mut scene.map);
    let first = map.points.len();
    map.points.push([1.0, 2.0, 0.0]);
    let (kind, points) = (MapKind::StopSign, first..first + 1);
    // Before all others by its name, so all indices move.
    map.features.push(MapFeature { id: "!".into(), kind, points, lane: None });
    let sign = map.features.len() - 1;
    let mut lanes = map.features.iter_mut().filter_map(|feature| feature.lane.as_deref_mut());
    lanes.next().unwrap().stop_signs.push(sign);
    lanes.next().unwrap().stop_signs.push(sign);
    let recording = Recording::procedural(scene);
    for bytes in [recording.to_pickle().unwrap(), recording.to_native().unwrap()] {
        let read = Recording::from_bytes(Path::new("signs"), bytes).unwrap().scene;
        let features = &read.map.features;
        let sign = features.iter().position(|feature| feature.kind == MapKind::StopSign).unwrap();
        let signed = features
            .iter()
            .filter(|feature| feature.lane.as_deref().is_some_and(|lane| lane.stop_signs == [sign]));
        assert_eq!(signed.count(), 2);
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
        assert!(logged.feasible && logged.collision == Some(false), "{}: {:?}", scene.id, logged.violations);
        let ego =
            (*scene).clone().with_roles(Some(&scene.adversary().unwrap().id), Some(&scene.ego().id)).unwrap();
        let swapped = Context::new(&Arc::new(ego), &index, &ContextOptions::default()).unwrap();
        let logged = Scorer::new(&swapped).scores(&swapped.candidate(log(scene.ego)));
        assert!(logged.feasible && logged.collision == Some(false), "{}: {:?}", scene.id, logged.violations);
        let hits = procedural::attacks(&scene).into_iter().any(|(_, trajectory)| {
            let s = scorer.scores(&ctx.candidate(trajectory));
            s.collision == Some(true) && s.feasible
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

/// Divided streets for the tests.
fn divided_scenes(count: u64) -> impl Iterator<Item = Scene> {
    (0..count).map(|number| procedural::generate(Kind::Divided, 11, number).unwrap())
}

fn flat(points: &[[f64; 3]]) -> Vec<Point> {
    points.iter().map(|p| [p[0], p[1]]).collect()
}

/// Lines of a scene's map of some kinds.
fn lines(scene: &Scene, of: fn(&MapKind) -> bool) -> Vec<Vec<Point>> {
    scene.map.polylines(of).map(|(_, points)| flat(points)).collect()
}

fn medians(scene: &Scene) -> Vec<Vec<Point>> {
    lines(scene, |kind| *kind == MapKind::EdgeMedian)
}

fn distance_to_segment(p: Point, [a, b]: [Point; 2]) -> f64 {
    let (d, to) = (sub(b, a), sub(p, a));
    let share = (d[0] * to[0] + d[1] * to[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-12);
    let share = share.clamp(0.0, 1.0);
    distance(p, [a[0] + share * d[0], a[1] + share * d[1]])
}

fn distance_to_lines(p: Point, lines: &[Vec<Point>]) -> f64 {
    let segments = lines.iter().flat_map(|line| line.windows(2));
    segments.map(|s| distance_to_segment(p, [s[0], s[1]])).fold(f64::INFINITY, f64::min)
}

#[test]
fn no_vehicle_of_a_divided_street_touches_a_median_and_no_lane_an_edge() {
    for scene in divided_scenes(30) {
        let medians = medians(&scene);
        let segments: Vec<[Point; 2]> =
            medians.iter().flat_map(|line| line.windows(2)).map(|s| [s[0], s[1]]).collect();
        for track in scene.tracks.iter().filter(|t| t.kind == TrackKind::Vehicle) {
            for frame in (0..scene.frames).filter(|f| track.is_valid(*f)) {
                let b = track.oriented_box(frame);
                let touched = segments.iter().any(|[a, c]| b.intersects_segment(*a, *c));
                assert!(!touched, "{}: track {} at frame {frame}", scene.id, track.id);
            }
        }
        // An edge that a lane crosses would also show streets that overlap.
        let edges = lines(&scene, MapKind::is_edge);
        for p in lines(&scene, MapKind::is_lane).iter().flat_map(|line| line.iter().step_by(3)) {
            let room = distance_to_lines(*p, &edges);
            assert!(room > 1.3, "{}: a lane is {room} m from an edge", scene.id);
        }
    }
}

#[test]
fn a_median_separates_ego_and_adversary_and_some_simple_attack_avoids_it() {
    for scene in divided_scenes(60).map(Arc::new) {
        let medians = medians(&scene);
        let (ego, adversary) = (scene.ego(), scene.adversary().unwrap());
        let [a, b] = [ego, adversary].map(|track| track.point(NOW));
        let sides = |p: Point, q: Point, c: Point, d: Point| {
            cross(sub(q, p), sub(c, p)) * cross(sub(q, p), sub(d, p)) < 0.0
        };
        let crosses = |s: &[Point]| sides(a, b, s[0], s[1]) && sides(s[0], s[1], a, b);
        assert!(medians.iter().flat_map(|line| line.windows(2)).any(crosses), "{}", scene.id);
        let future = || [ego, adversary].into_iter().flat_map(|t| (NOW..=NOW + 80).map(|f| t.point(f)));
        let nearest = future().map(|p| distance_to_lines(p, &medians)).fold(f64::INFINITY, f64::min);
        assert!(nearest <= 10.0, "{}: {nearest} m", scene.id);
        let index = SceneIndex::new(scene.map.clone());
        let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
        let scorer = Scorer::new(&ctx);
        let avoids = |trajectory| {
            let candidate = ctx.candidate(trajectory);
            let scores = scorer.scores(&candidate);
            let mut segments = medians.iter().flat_map(|line| line.windows(2));
            let touches = |s: &[Point]| candidate.boxes().iter().any(|b| b.intersects_segment(s[0], s[1]));
            scores.collision == Some(true) && scores.feasible && !segments.any(touches)
        };
        assert!(procedural::attacks(&scene).into_iter().any(|(_, t)| avoids(t)), "{}", scene.id);
    }
}

#[test]
fn a_divided_street_has_left_turns_at_gaps_and_only_right_turns_elsewhere() {
    let mut widths = Vec::new();
    let mut are_curved = [0, 0];
    for scene in divided_scenes(30) {
        let map = &scene.map;
        let course = |p: [f64; 3], q: [f64; 3]| (q[1] - p[1]).atan2(q[0] - p[0]);
        let turn = |k: usize| {
            let p = map.points_of(&map.features[k]);
            wrap_angle(course(p[p.len() - 2], p[p.len() - 1]) - course(p[0], p[1]))
        };
        let exits: Vec<&[usize]> =
            map.features.iter().filter_map(|f| f.lane.as_ref()).map(|lane| lane.exits.as_slice()).collect();
        // A side street's curve is below 0.9, a turn at a junction near a right angle.
        let (left, right) = (|k: &usize| turn(*k) > 1.2, |k: &usize| turn(*k) < -1.2);
        assert!(exits.iter().any(|e| e.iter().any(left)), "{}: no left turn", scene.id);
        let right_only = exits.iter().filter(|e| e.len() == 1 && e.iter().all(right)).count();
        assert!((1..=2).contains(&right_only), "{}: {right_only} streets", scene.id);
        let medians = medians(&scene);
        let lanes = lines(&scene, MapKind::is_lane);
        assert_eq!(medians.len(), 4 - right_only, "{}: a median before, between and after gaps", scene.id);
        for line in &medians {
            for s in line.windows(2).step_by(10) {
                let near = |p: &&Point| distance_to_segment(**p, [s[0], s[1]]);
                let lane = lanes.iter().flatten().min_by(|p, q| near(p).total_cmp(&near(q))).unwrap();
                assert!(cross(sub(s[1], s[0]), sub(*lane, s[0])) > 0.0, "{}: road on the right", scene.id);
            }
        }
        // The first median is open where the map ends.
        let [.., last] = medians[0][..] else { panic!("an empty median") };
        widths.push(distance(medians[0][0], last));
        let (start, end) = (&medians[0], &medians[medians.len() - 1]);
        let along =
            |line: &[Point], k: usize| (line[k + 1][1] - line[k][1]).atan2(line[k + 1][0] - line[k][0]);
        let turned = wrap_angle(along(start, 0) - along(end, end.len() - 2)).abs();
        are_curved[usize::from(turned > 0.1)] += 1;
    }
    assert!(widths.iter().all(|w| (1.0..6.0).contains(w)), "{widths:?}");
    assert!(quantile(&widths, 0.9).unwrap() - quantile(&widths, 0.1).unwrap() > 2.0, "{widths:?}");
    assert!(are_curved[0] > 5 && are_curved[1] > 5, "{are_curved:?}");
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
