//! `sage rate`: what it writes, and that its likeliest failures are failures.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use program::*;
use serde_json::Value;

fn desk() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "6", "--format", "pickle", "--out", text(&scenes)]));
    (folder, scenes)
}

/// Rows and pictures of a folder, without the hash of the run.
fn written(folder: &Path) -> BTreeMap<String, String> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_of_scene = |path: &PathBuf| {
        path.extension().is_some_and(|ending| ending == "json" || ending == "svg")
            && !path.ends_with("run.json")
    };
    let content = |path: PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        let text = fs::read_to_string(&path).unwrap();
        let Ok(mut row) = serde_json::from_str::<Value>(&text) else { return (name, text) };
        row["run_hash"] = Value::Null;
        (name, row.to_string())
    };
    files.filter(is_of_scene).map(content).collect()
}

fn row(folder: &Path, name: &str) -> Value {
    serde_json::from_slice(&fs::read(folder.join(format!("{name}.json"))).unwrap()).unwrap()
}

#[test]
fn rates_do_not_depend_on_threads_and_other_drivers() {
    let (folder, scenes) = desk();
    let rated = |name: &str, ego: &str, threads: &str| {
        let out = folder.path().join(name);
        let command = ["rate", text(&scenes), "--budget", "16", "--threads", threads, "--ego", ego];
        stdout(&sage(&[&command[..], &["--out", text(&out)]].concat()));
        written(&out)
    };
    let both = rated("both", "idm,expert", "1");
    assert_eq!(both.len(), 24, "a row and a picture a scene and driver");
    assert_eq!(both, rated("threads", "idm,expert", "2"));
    let alone = rated("alone", "idm", "2");
    assert!(alone.iter().all(|(name, text)| both[name] == *text));
}

#[test]
fn exact_rates_lie_in_the_bounds_of_samples_and_the_likeliest_failure_drives_again() {
    let (folder, scenes) = desk();
    let rated = |name: &str, budget: &str| {
        let out = folder.path().join(name);
        let command =
            ["rate", text(&scenes), "--ego", "replay,idm", "--budget", budget, "--given", "feasible"];
        stdout(&sage(&[&command[..], &["--out", text(&out)]].concat()));
        out
    };
    let (exact, some) = (rated("exact", "all"), rated("some", "12"));
    let mut failures = 0;
    for entry in fs::read_dir(&scenes).unwrap() {
        let source = entry.unwrap().path();
        let Some(scene) =
            source.file_stem().and_then(|stem| stem.to_str()).filter(|_| text(&source).ends_with("pkl"))
        else {
            continue;
        };
        for ego in ["replay", "idm"] {
            // The summary of a folder is no scene.
            if !exact.join(format!("{scene}-{ego}.json")).is_file() {
                continue;
            }
            let [exact, some] = [&exact, &some].map(|folder| row(folder, &format!("{scene}-{ego}")));
            assert_eq!(exact["undriven"]["feasible"], 0.0);
            for given in ["feasible", "clear-of-recorded-ego"] {
                for event in ["contact", "attack", "believable", "failure"] {
                    let of = |row: &Value, key: &str| row["rates"][given][event][key].as_f64();
                    let Some(truth) = of(&exact, "rate") else { continue };
                    assert!((truth - of(&exact, "low").unwrap()).abs() < 1e-12);
                    let [low, high] = ["low", "high"].map(|key| of(&some, key).unwrap());
                    assert!(low <= truth + 1e-12 && truth <= high + 1e-12, "{scene} {ego} {given} {event}");
                    if ego == "replay" && given == "clear-of-recorded-ego" {
                        assert_eq!(truth, 0.0, "{scene} {event}");
                    }
                }
            }
            if exact["likeliest"].is_null() {
                continue;
            }
            failures += 1;
            let file = folder.path().join("exact").join(format!("{scene}-{ego}.json"));
            let out = folder.path().join("watch");
            let command =
                ["simulate", text(&source), "--ego", ego, "--attack", text(&file), "--json", "--force"];
            let driven = rows(&sage(&[&command[..], &["--out", text(&out)]].concat()));
            assert_eq!(
                driven[0]["contacts"][0]["step"], exact["likeliest"]["contact"]["step"],
                "{scene} {ego}"
            );
        }
    }
    assert!(failures > 1, "{failures}");
}

#[test]
fn one_profile_is_the_trajectory_of_the_goal_and_an_adversary_that_looks_out_meets_fewer() {
    let (folder, scenes) = desk();
    let rated = |name: &str, options: &[&str]| {
        let out = folder.path().join(name);
        let command = ["rate", text(&scenes), "--ego", "replay", "--budget", "all"];
        stdout(&sage(&[&command[..], options, &["--out", text(&out)]].concat()));
        written(&out)
            .into_iter()
            .filter(|(name, _)| name.ends_with(".json"))
            .map(|(_, row)| serde_json::from_str::<Value>(&row).unwrap())
            .collect::<Vec<_>>()
    };
    let (one, several, aware) =
        (rated("one", &["--profiles", "1"]), rated("several", &[]), rated("aware", &["--aware"]));
    let mut met = [0.0; 2];
    for ((one, several), aware) in one.iter().zip(&several).zip(&aware) {
        assert_eq!(one["shifts"], serde_json::json!([0.0]));
        assert_eq!(several["shifts"].as_array().unwrap().len(), 5);
        // Shifts share the probability of their goal: all plans together have the same mass, whether feasible or not.
        let goals = |row: &Value| row["goals"].as_array().unwrap().len();
        assert!(goals(several) >= goals(one), "{}", one["scene"]);
        for (sum, row) in met.iter_mut().zip([several, aware]) {
            *sum += row["rates"]["feasible"]["contact"]["rate"].as_f64().unwrap_or(0.0);
        }
    }
    assert!(met[0] > 0.0 && met[1] < 0.8 * met[0], "{met:?}");
}

#[test]
fn failures_of_a_search_have_probabilities_and_the_likeliest_has_the_largest() {
    let (folder, scenes) = desk();
    let out = folder.path().join("found");
    stdout(&sage(&[
        "search",
        text(&scenes),
        "--ego",
        "idm",
        "--budget",
        "24",
        "--format",
        "rows",
        "--out",
        text(&out),
    ]));
    let mut found = 0;
    for entry in fs::read_dir(&out).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        let Some(scene) =
            name.strip_suffix(".json").filter(|name| out.join(format!("{name}-drives.json")).is_file())
        else {
            continue;
        };
        let row = row(&out, scene);
        let failures = row["failures"].as_u64().unwrap();
        let probability = |k: u64| {
            let text = fs::read_to_string(out.join(format!("{scene}-failure{k}.json"))).unwrap();
            serde_json::from_str::<Value>(&text).unwrap()["probability"].as_f64().unwrap()
        };
        let all: Vec<f64> = (1..=failures).map(probability).collect();
        assert!(all.iter().all(|p| (0.0..=1.0).contains(p)), "{scene}: {all:?}");
        let Some(most) = all.iter().copied().reduce(f64::max) else { continue };
        assert_eq!(row["likeliest"]["probability"].as_f64(), Some(most), "{scene}");
        found += 1;
    }
    assert!(found > 1, "{found}");
}

#[test]
fn tuned_experts_are_no_density_of_traffic() {
    let (folder, scenes) = desk();
    let expert = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural/realistic.safetensors");
    let out = folder.path().join("refused");
    for command in
        [["rate", text(&scenes), "--ego", "idm"], ["calibrate", text(&scenes), "--nominal", "--force"]]
    {
        let refused = failure(&[&command[..], &["--weights", text(&expert), "--out", text(&out)]].concat());
        assert!(refused.contains("is the realistic expert of a prior, no prior"), "{refused}");
    }
}
