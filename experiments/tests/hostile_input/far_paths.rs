//! Positions far from each other: refused at once, each scene by itself.

use std::path::Path;

use insta::assert_snapshot;
use sage_core::geometry::Point;
use sage_data::Recording;
use serde_json::json;

use crate::{has_failed, program::*, quick};

/// The shipped scene with a changed position of a track, as a native file.
fn with_position(file: &Path, track: &str, frame: usize, position: Point) {
    let mut recording = Recording::read(example().as_ref()).unwrap();
    let track = recording.scene.tracks.iter_mut().find(|found| found.id == track).unwrap();
    track.position[frame] = [position[0], position[1], 0.0];
    recording.write(file).unwrap();
}

#[test]
fn a_jump_of_the_ego_costs_its_scene_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("in")).unwrap();
    std::fs::copy(example(), at("in/good.pkl")).unwrap();
    for (name, frame, far) in [("now", 10, 1e6), ("next", 11, 9e7), ("last", 90, -1e8), ("first", 0, 1e3)] {
        for ending in ["pkl", "safetensors"] {
            with_position(&at(&format!("in/{name}-{ending}.{ending}")), "ego", frame, [far, 0.0]);
        }
    }
    let scenes = at("in");
    let mut refused = Vec::new();
    for command in [
        vec!["inspect", text(&scenes)],
        vec!["generate", text(&scenes), "--method", "rule", "--out", "OUT"],
        vec!["simulate", text(&scenes), "--ego", "idm", "--out", "OUT"],
        vec!["convert", text(&scenes), "--to", "womd", "--out", "OUT"],
        vec!["bench", "drivers", text(&scenes), "--ego", "idm", "--unattacked", "--out", "OUT"],
    ] {
        let out = at(command[0]);
        let command: Vec<&str> =
            command.iter().map(|word| if *word == "OUT" { text(&out) } else { word }).collect();
        let (code, said) = quick(&command);
        assert!(has_failed(code), "{command:?}: {said}");
        refused.push((command.join(" "), sorted(&said)));
    }
    assert_snapshot!("jumps_of_the_ego", messages(refused));
}

#[test]
fn a_jump_of_a_bystander_costs_this_track_alone() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.pkl");
    with_position(&scene, "leader", 40, [1e6, 0.0]);
    let recording = Recording::read(&scene).unwrap();
    assert!(recording.scene.tracks.iter().all(|track| track.id != "leader"));
    assert_snapshot!(recording.scene.notes.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"), @"track-left-out: track `leader` is left out: `state/position/40` is 999973 m from the position before; expected at most 100 m a frame");
}

#[test]
fn drives_of_other_planners_are_checked_by_scene() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let good: Vec<[f64; 3]> = {
        let scene = Recording::read(example().as_ref()).unwrap().scene;
        (0..scene.frames).map(|f| [scene.ego().point(f)[0], scene.ego().point(f)[1], 0.0]).collect()
    };
    let mut far = good.clone();
    far[40][0] = 9.9e7;
    let mut beyond = good.clone();
    beyond[40][0] = 1e300;
    let mut refused = Vec::new();
    for (name, value) in [
        ("far", json!(far)),
        ("beyond", json!(beyond)),
        ("by-scene", json!({"crossing": far, "other": good})),
        ("short", json!(good[..90])),
        ("none", json!({})),
        ("text", json!("drive")),
        ("deep", json!([[[1.0, 2.0, 3.0]]])),
    ] {
        std::fs::write(at(name), value.to_string()).unwrap();
        let (ego, out) = (format!("path:{}", text(&at(name))), at("out"));
        let scene = example();
        let (code, said) = quick(&["generate", &scene, "--ego", &ego, "--lambda", "1", "--out", text(&out)]);
        assert!(has_failed(code), "{name}: {said}");
        refused.push((name, said));
    }
    assert_snapshot!("drives_of_other_planners", messages(refused));
    // A drive of a scene that is not driven costs nothing.
    std::fs::write(at("other"), json!({"crossing": good, "other": far}).to_string()).unwrap();
    let (ego, out) = (format!("path:{}", text(&at("other"))), at("good"));
    let (code, said) = quick(&["generate", &example(), "--ego", &ego, "--lambda", "1", "--out", text(&out)]);
    assert_eq!(code, 0, "{said}");
}

#[test]
fn candidates_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("candidates.json");
    let line = |start: f64, step: f64| -> Vec<Point> {
        (0..80).map(|k| [start + step * f64::from(k), 0.0]).collect()
    };
    let near = Recording::read(example().as_ref()).unwrap().scene;
    let [x, _] = near.adversary().unwrap().point(10);
    let mut refused = Vec::new();
    for (name, trajectory, ego) in [
        ("a fast trajectory", line(x, 101.0), None),
        ("a far trajectory", line(9e7, 0.1), None),
        ("a far ego path", line(x, 0.1), Some(line(9e7, 0.1))),
        ("a fast ego path", line(x, 0.1), Some(line(0.0, 1e4))),
    ] {
        let candidates = json!([{"name": "c", "trajectory": trajectory, "ego": ego}]);
        std::fs::write(&file, candidates.to_string()).unwrap();
        let (code, said) = quick(&["score", &example(), "--candidates", text(&file), "--avoidable"]);
        assert!(has_failed(code), "{name}: {said}");
        refused.push((name, said));
    }
    assert_snapshot!("far_candidates", messages(refused));
}
