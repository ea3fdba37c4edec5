//! What the rows and files of `sage search` hold; the rest is in `commands/search.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
};

use program::*;
use serde_json::Value;

/// A folder with six procedural scenes.
fn desk() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "6", "--format", "pickle", "--out", text(&scenes)]));
    (folder, scenes)
}

fn search(scenes: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let command = ["search", text(scenes), "--ego", "idm", "--budget", "12", "--out", text(out)];
    sage(&[&command[..], &WEIGHTS, more].concat())
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn a_search_writes_rows_pictures_and_the_scenes_of_failures_that_drive_again_alike() {
    let (folder, scenes) = desk();
    let out = folder.path().join("found");
    let output = search(&scenes, &out, &["--json", "--format", "both"]);
    let rows = rows(&output);
    assert_eq!(rows.len(), 6);
    let mut failures = 0;
    for row in &rows {
        let scene = row["scene"].as_str().unwrap();
        assert_eq!(row["ego"], "idm");
        assert!(row["drives"].as_u64().unwrap() <= 12);
        assert!(out.join(format!("{scene}.svg")).is_file());
        let count = |key: &str| row[key].as_u64().unwrap();
        assert!(count("failures") <= count("at_fault") && count("at_fault") <= count("believable"));
        assert_eq!(row["reason"].is_null(), count("failures") > 0);
        let drives = json(&out.join(format!("{scene}-drives.json")));
        let drives = drives["drives"].as_array().unwrap();
        assert_eq!(drives.len() as u64, count("drives"));
        let met = |drive: &&Value| drive["clauses"]["preventable"] == true;
        assert_eq!(drives.iter().filter(met).count() as u64, count("failures"));
        for number in 1..=count("failures") {
            let name = format!("{scene}-failure{number}");
            let failure = json(&out.join(format!("{name}.json")));
            assert!(out.join(format!("{name}.safetensors")).is_file());
            assert!(pickle(&out, &name).is_file());
            prevents_again(&scenes.join(format!("{scene}.pkl")), &out.join(format!("{name}.json")), &failure);
            drives_again(&scenes.join(format!("{scene}.pkl")), &out.join(format!("{name}.json")), &failure);
            failures += 1;
        }
        for named in [&row["worst"], &row["mildest"]].into_iter().filter(|named| !named.is_null()) {
            let failure = json(&out.join(named["row"].as_str().unwrap()));
            assert_eq!((&failure["contact"], &failure["clauses"]), (&named["contact"], &named["clauses"]));
        }
    }
    assert!(failures > 3, "the search finds failures: {failures}");
    let record = json(&out.join("run.json"));
    assert_eq!(record["results"]["done"], 6);
}

#[test]
fn another_budget_continues_a_search_and_a_smaller_one_keeps_it() {
    let (folder, scenes) = desk();
    let [continued, whole] = ["continued", "whole"].map(|name| folder.path().join(name));
    let run = |budget: &str, out: &Path| {
        let command =
            ["search", text(&scenes), "--ego", "idm", "--budget", budget, "--out", text(out), "--json"];
        let rows = rows(&sage(&[&command[..], &WEIGHTS].concat()));
        let found = |row: &Value| (row["scene"].clone(), row["drives"].clone(), row["failures"].clone());
        rows.iter().map(found).collect::<Vec<_>>()
    };
    let few = run("3", &continued);
    let more = run("8", &continued);
    assert_ne!(few, more);
    assert_eq!(more, run("8", &whole));
    // The drives of the smaller budget are the first of the larger one.
    for name in fs::read_dir(&whole).unwrap().map(|entry| entry.unwrap().file_name()) {
        let name = name.to_str().unwrap();
        if name.ends_with("-drives.json") {
            assert_eq!(json(&continued.join(name))["drives"], json(&whole.join(name))["drives"], "{name}");
        }
    }
    assert_eq!(run("3", &continued), more);
}

/// The failure has the same contact when it is driven again from its row, and its evasive manoeuvre when it is scored.
fn drives_again(scene: &Path, row: &Path, failure: &Value) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("again");
    let output = sage(&[
        "simulate",
        text(scene),
        "--ego",
        "idm",
        "--attack",
        text(row),
        "--json",
        "--out",
        text(&out),
    ]);
    let again = &rows(&output)[0];
    let contact = &again["contacts"][0];
    for key in ["step", "overlap", "impact_speed"] {
        assert_eq!(contact[key], failure["contact"][key], "{} of {}", key, row.display());
    }
    assert_eq!(contact["with"], failure["contact"]["track"]);
    assert_eq!(again["attack"]["verdict"]["attack"], true);
    let candidate = serde_json::json!([
        {"name": "failure", "trajectory": failure["trajectory"], "ego": failure["ego_path"]}
    ]);
    let file = folder.path().join("candidate.json");
    fs::write(&file, candidate.to_string()).unwrap();
    let output = sage(&["score", text(scene), "--candidates", text(&file), "--avoidable", "--json"]);
    let scored = &rows(&output)[0];
    assert_eq!(scored["believable"], true, "{}", row.display());
    assert_eq!(scored["avoidable"], failure["clauses"]["avoidable"], "{}", row.display());
}

/// The reference driver that prevents the contact has none with the adversary when it takes over in another process.
fn prevents_again(scene: &Path, row: &Path, failure: &Value) {
    let answers = failure["references"].as_array().unwrap();
    let last = answers.last().unwrap();
    assert!(last["prevents"] == true && answers.iter().all(|answer| answer["reference"] != "idm"));
    let then = last["reference"].as_str().unwrap();
    let ego = format!(r#"takeover{{"first":{{"name":"idm"}},"then":{{"name":"{then}"}}}}"#);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("again");
    let output =
        sage(&["simulate", text(scene), "--ego", &ego, "--attack", text(row), "--json", "--out", text(&out)]);
    let contacts = rows(&output)[0]["contacts"].as_array().unwrap().clone();
    assert!(contacts.iter().all(|contact| contact["with"] != failure["adversary"]), "{}", row.display());
    assert!(contacts.iter().all(|contact| contact["at_fault"] != true), "{}", row.display());
}

#[test]
fn a_search_can_stop_early_and_ask_less_and_take_other_plans() {
    let (folder, scenes) = desk();
    let out = |name: &str| folder.path().join(name);
    let of = |name: &str, more: &[&str]| rows(&search(&scenes, &out(name), &[&["--json"], more].concat()));
    for row in of("first", &["--first", "--require", "attack"]) {
        let failures = row["failures"].as_u64().unwrap();
        assert!(failures <= 1);
        assert_eq!(row["first_failure"].is_null(), failures == 0);
        if failures == 1 {
            assert_eq!(row["first_failure"], row["drives"]);
        }
        assert_eq!(row["require"], serde_json::json!(["attack"]));
    }
    // Planned anew against the newest drive, until nothing changes.
    let rows = of("rule", &["--method", "rule"]);
    let in_pool = |row: &Value| row["plans"]["in_pool"].as_u64().unwrap();
    assert!(rows.iter().any(|row| in_pool(row) > 1), "{rows:?}");
    assert!(rows.iter().all(|row| in_pool(row) <= 12), "{rows:?}");
    for row in
        of("random", &["--method", r#"random{"candidates": 20}"#, "--order", "random", "--format", "none"])
    {
        assert!(row["plans"]["proposed"] == 20, "{row}");
        let files = row["files"].as_array().unwrap();
        assert!(files.iter().all(|file| !file.as_str().unwrap().ends_with(".safetensors")));
    }
}
