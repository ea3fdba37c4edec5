//! What `sage generate` changes in a scene; the rest of it is in `commands/generate.md`, `bench open-loop` in `commands/bench.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::path::{Path, PathBuf};

use insta::assert_snapshot;
use program::*;
use sage_core::motion::NOW;
use sage_data::Recording;
use serde_json::Value;

#[test]
fn generate_changes_the_adversarys_future_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = example();
    for method in ["sage", "prior", "most-likely", "random", "oracle", "cat", "rule", "log"] {
        let arguments = ["generate", &scene, "--method", method, "--json", "--force", "--out", text(&out)];
        let output = sage(&[&arguments[..], &["--format", "both"], &WEIGHTS].concat());
        let row: Value = serde_json::from_str(stdout(&output).trim()).unwrap();
        for key in [
            "scene",
            "lambda",
            "mu",
            "seed",
            "chosen",
            "feasible",
            "violations",
            "variant",
            "files",
            "source_hash",
            "scores",
            "candidates",
            "seconds",
        ] {
            assert!(!row[key].is_null(), "{method}: `{key}`");
        }
        assert_eq!(row["method"], method);
        let chosen = row["chosen"].as_u64().unwrap() as usize;
        assert_eq!(row["candidates"][chosen]["trajectory"], row["trajectory"]);
        // The chosen one's scores also say whether a driver could have avoided it.
        for (key, value) in row["candidates"][chosen]["scores"].as_object().unwrap() {
            assert_eq!(row["scores"][key], *value, "{key}");
        }
        assert!(row["scores"].get("latest_start").is_some());
        let source = Recording::read(Path::new(&scene)).unwrap().scene;
        let adversary = source.adversary.unwrap();
        let has_point = !["cat", "rule", "log"].contains(&method);
        let variant = if has_point { "lambda1.00" } else { method };
        assert_eq!((&row["scene"], &row["variant"]), (&"crossing".into(), &variant.into()), "{method}");
        let name = format!("crossing-{variant}");
        for ending in ["pkl", "safetensors"] {
            let native = out.join(format!("{name}.safetensors"));
            let file = if ending == "pkl" { pickle(&out, &name) } else { native };
            let made = Recording::read(&file).unwrap();
            let document = made.document().unwrap().unwrap();
            let metadata = document.get(document.root(), "metadata").unwrap();
            let told =
                document.get(metadata, sage_data::PROVENANCE).and_then(|id| document.text(id)).unwrap();
            let told: Value = serde_json::from_str(told).unwrap();
            assert_eq!((&told["method"], &told["seed"]), (&row["method"], &row["seed"]), "{ending}");
            let made = made.scene;
            assert_eq!((made.frames, &made.map, made.ego), (source.frames, &source.map, source.ego));
            for (k, (a, b)) in made.tracks.iter().zip(&source.tracks).enumerate() {
                if k != adversary {
                    assert_eq!(a, b, "{method}: track {k}");
                }
            }
            let track = &made.tracks[adversary];
            for frame in 0..=NOW {
                assert_eq!(track.position[frame], source.tracks[adversary].position[frame]);
            }
            for frame in [NOW + 1, NOW + 40, NOW + 80] {
                for axis in 0..2 {
                    let planned = row["trajectory"][frame - NOW - 1][axis].as_f64().unwrap();
                    assert!(
                        (track.position[frame][axis] - planned).abs() < 1e-3,
                        "{method} {ending} {frame}"
                    );
                }
            }
        }
        assert!(out.join("crossing.svg").is_file() && out.join(format!("{name}.json")).is_file());
    }
}

/// Every shipped folder of experts can be named by its path, although driving policies lie in it.
#[test]
fn shipped_weights_are_read_from_their_folders() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights");
    let experts = ["procedural", "waymo", "waymo/query", "waymo-paper", "waymo-paper/query", "waymo-literal"];
    for name in experts.iter().filter(|name| shipped.join(name).is_dir()) {
        let (scene, weights) = (example(), shipped.join(name));
        let out = folder.path().join(name.replace('/', "-"));
        let output = sage(&["generate", &scene, "--weights", text(&weights), "--out", text(&out)]);
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn a_sweep_follows_lambda_and_is_the_same_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    let sweep = |name: &str, threads: &str| {
        let out: PathBuf = folder.path().join(name);
        let arguments =
            ["generate", &scene, "--lambda", "0:1:0.25", "--json", "--threads", threads, "--out", text(&out)];
        let output = sage(&[&arguments[..], &WEIGHTS].concat());
        rows(&output)
            .into_iter()
            .map(|row| (row["lambda"].clone(), row["trajectory"].clone(), row["scores"].clone()))
            .collect::<Vec<_>>()
    };
    let one = sweep("one", "1");
    assert_eq!(one.len(), 5);
    assert!(one == sweep("two", "2"));
    let reward = |k: usize| one[k].2["adversarial_reward"].as_f64().unwrap();
    assert!(reward(4) >= reward(0), "{} at 1, {} at 0", reward(4), reward(0));
    assert!(pickle(&folder.path().join("one"), "crossing-lambda0.25").is_file());
}

#[test]
fn the_drive_of_another_planner_is_attacked_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let source = Recording::read(Path::new(&example())).unwrap().scene;
    let drive = |shift: f64, frames: usize| -> Vec<[f64; 3]> {
        let pose = |frame: usize| {
            let [x, y] = source.ego().point(frame);
            [x, y + shift, source.ego().heading[frame]]
        };
        (0..frames).map(pose).collect()
    };
    let generate = |name: &str, drive: &Value| {
        let file = folder.path().join(format!("{name}.json"));
        std::fs::write(&file, drive.to_string()).unwrap();
        let (ego, out) = (format!("path:{}", text(&file)), folder.path().join(name));
        let arguments = ["generate", &example(), "--ego", &ego, "--json", "--out", text(&out)];
        sage(&[&arguments[..], &WEIGHTS].concat())
    };
    // The recording as a drive gives the attack on the recording.
    let plain = folder.path().join("plain");
    let arguments = ["generate", &example(), "--json", "--out", text(&plain)];
    let plain: Value = serde_json::from_str(stdout(&sage(&[&arguments[..], &WEIGHTS].concat()))).unwrap();
    let same: Value =
        serde_json::from_str(stdout(&generate("same", &serde_json::json!(drive(0.0, source.frames)))))
            .unwrap();
    assert_eq!(plain["trajectory"], same["trajectory"]);
    assert!(plain["ego"].is_null() && same["ego"].as_str().unwrap().starts_with("path"));
    // Another drive is in the written scene.
    let shifted = generate("shifted", &serde_json::json!({ source.id.as_str(): drive(0.5, source.frames) }));
    assert!(shifted.status.success(), "{}", stderr(&shifted));
    let made = Recording::read(&pickle(&folder.path().join("shifted"), "crossing-lambda1.00")).unwrap().scene;
    let ([x, y], [logged_x, logged_y]) = (made.ego().point(40), source.ego().point(40));
    assert!((x - logged_x).abs() < 1e-4 && (y - logged_y - 0.5).abs() < 1e-4);
    // What cannot be driven is named.
    let short = generate("short", &serde_json::json!(drive(0.0, 50)));
    assert_eq!(short.status.code(), Some(BAD_SCENES));
    assert_snapshot!(redacted(stderr(&short)), @r"
    note: weights `procedural` (network densetnt)
    error: `[sage]/examples/crossing.pkl`: scene `crossing`: the drive in `[folder]/short.json` has 50 poses; expected 91, one a frame
    error: the scene could not be attacked
    ");
}

#[test]
fn a_goal_selects_the_feasible_plan_that_ends_nearest() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let end = |row: &Value| {
        let last = row["trajectory"].as_array().unwrap().last().unwrap();
        [0, 1].map(|axis| last[axis].as_f64().unwrap())
    };
    let scene = example();
    let generate = ["generate", &scene, "--lambda", "0.5", "--json", "--format", "rows", "--force"];
    let attack = |given: &[&str]| -> Value {
        let output = sage(&[&generate[..], given, &["--out", text(&out)], &WEIGHTS].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_str(stdout(&output).trim()).unwrap()
    };
    // The goals of three candidates of an ordinary attack.
    let ordinary = attack(&[]);
    for k in [3, 17, 40] {
        let [x, y] = end(&ordinary["candidates"][k]);
        let row = attack(&["--goal", &format!("{x},{y}")]);
        let distance = |found: [f64; 2]| (found[0] - x).hypot(found[1] - y);
        let candidates = row["candidates"].as_array().unwrap();
        let feasible = candidates.iter().filter(|one| one["scores"]["feasible_drivable"] == true);
        let least = feasible.map(|one| distance(end(one))).fold(f64::INFINITY, f64::min);
        assert_eq!(distance(end(&row)), least);
        assert_eq!(row["selection"]["terms"][0]["options"]["at"], serde_json::json!([x, y]));
        assert!((row["scores"]["rewards"]["goal-distance"].as_f64().unwrap() - least).abs() < 1e-9);
    }
    for wrong in ["1", "1,x", "inf,0"] {
        let output = sage(&["generate", &scene, "--goal", wrong, "--out", text(&out)]);
        assert!(stderr(&output).contains("expected two numbers of metres"), "{}", stderr(&output));
    }
}
