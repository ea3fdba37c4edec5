//! `sage search`, and the studies of searches and thresholds.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hostile;
mod program;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use insta::assert_snapshot;
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

/// Files of a run without its record, which holds times.
fn files(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = hostile::snapshot(out);
    files.remove("run.json");
    files
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
fn results_depend_neither_on_threads_nor_on_shards_and_resume() {
    let (folder, scenes) = desk();
    let at = |name: &str| folder.path().join(name);
    stdout(&search(&scenes, &at("one"), &["--threads", "1"]));
    stdout(&search(&scenes, &at("two"), &["--threads", "2"]));
    let whole = files(&at("one"));
    assert_eq!(whole, files(&at("two")));
    for shard in ["1/3", "2/3", "3/3"] {
        stdout(&search(&scenes, &at("shards"), &["--shard", shard]));
    }
    stdout(&sage(&["join", text(&at("shards"))]));
    assert_eq!(whole, files(&at("shards")));
    // A row that is gone is made again, and only it.
    let row = at("one").join("four-way-1-0.json");
    let row = if row.is_file() { row } else { first_row(&at("one")) };
    fs::remove_file(&row).unwrap();
    let again = search(&scenes, &at("one"), &[]);
    assert_eq!(stdout(&again).matches("finished before").count(), 5, "{}", stdout(&again));
    assert_eq!(whole, files(&at("one")));
}

/// The row of the first scene of a folder.
fn first_row(out: &Path) -> PathBuf {
    let names = files(out).into_keys();
    let is_row =
        |name: &String| name.ends_with(".json") && !name.contains("-drives") && !name.contains("-failure");
    out.join(names.into_iter().find(is_row).unwrap())
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

#[test]
fn wrong_use_is_refused_by_name() {
    let (folder, scenes) = desk();
    let out = folder.path().join("out");
    let mut said = Vec::new();
    let usage = |more: &[&str]| {
        let output = search(&scenes, &out, more);
        assert!(!output.status.success());
        stderr(&output).to_owned()
    };
    for more in [
        &["--require", "solid"][..],
        &["--plans", "0"],
        &["--options", r#"{"candidates": 3}"#],
        &["--method", "sag"],
        &["--standard", "1.2"],
        &["--feasibility", "drivabel"],
        &["--shard", "3/2"],
    ] {
        said.push((more.join(" "), usage(more)));
    }
    fs::copy(first_pickle(&scenes), scenes.join("a.pkl")).unwrap();
    fs::copy(first_pickle(&scenes), scenes.join("a-failure1.pkl")).unwrap();
    said.push(("a and a-failure1".to_owned(), usage(&[])));
    assert_snapshot!("refused_searches", messages(said));
    assert!(!out.exists());
}

fn first_pickle(folder: &Path) -> PathBuf {
    let mut names: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.retain(|name| {
        name.extension().is_some_and(|e| e == "pkl")
            && !name.file_name().unwrap().to_str().unwrap().contains("dataset")
    });
    names.sort();
    names.remove(0)
}

#[test]
fn studies_of_searches_and_thresholds_report_rates_curves_and_orders() {
    let (folder, scenes) = desk();
    let at = |name: &str| folder.path().join(name);
    let study = |name: &str, more: &[&str]| {
        let out = at(name);
        let command = ["bench", name, text(&scenes), "--weights", "procedural", "--out", text(&out)];
        stdout(&sage(&[&command[..], more].concat()));
        fs::read_to_string(out.join("table.md")).unwrap()
    };
    let table = study("search", &["--ego", "idm", "--set", "search={budget: 8}"]);
    for name in ["pool", "one-shot 1.00", r#"pool{"order":"random"}"#, "Generators A less `one-shot` B"] {
        assert!(table.contains(name), "{name} is in\n{table}");
    }
    assert!(at("search/any-time-failure.svg").is_file());
    let more = ["--ego", "replay,idm,constant-speed,expert", "--lambda", "0:1:0.25"];
    let table = study("threshold", &more);
    for name in ["50 % point", "Kendall's tau over 4 drivers", "area: A − B"] {
        assert!(table.contains(name), "{name} is in\n{table}");
    }
    let refused = failure(&["bench", "threshold", text(&scenes), "--lambda", "1", "--out", text(&at("no"))]);
    assert!(refused.contains("at least three rising values"), "{refused}");
}

#[test]
fn a_study_of_transfer_drives_every_plan_against_every_driver() {
    let (folder, scenes) = desk();
    let out = folder.path().join("transfer");
    let study = |out: &Path, more: &[&str]| {
        let command =
            ["bench", "transfer", text(&scenes), "--weights", "procedural", "--ego", "idm,expert,replay"];
        let methods = ["--method", "sage,rule,search", "--set", "search={budget: 6}", "--out", text(out)];
        stdout(&sage(&[&command[..], &methods, more].concat()));
        let file = |name: &str| fs::read_to_string(out.join(name)).unwrap();
        (file("table.md"), file("rows.csv"))
    };
    let (table, rows) = study(&out, &[]);
    for name in [
        "Attacks of `sage 1.00` in %",
        "Attacks of `rule` in %",
        "Attacks of `search` in %",
        "| made against | idm | expert | replay |",
        "| method | rate | N | itself | another | lost |",
        "Failures by plans of `search` in %",
        "| method | tested | N | itself | best other | its rate | itself − best other |",
    ] {
        assert!(table.contains(name), "{name} is in\n{table}");
    }
    // Three methods, made against and tested on three drivers.
    let attacks: Vec<&str> = rows.lines().skip(1).filter(|row| row.contains(",attack,")).collect();
    let scenes_measured = attacks.len() / 27;
    assert!(scenes_measured > 0 && attacks.len() == 27 * scenes_measured, "{}", attacks.len());
    let again = study(&folder.path().join("again"), &["--threads", "1"]);
    assert_eq!(again.1, rows, "the same bits at one thread");
    let beside =
        ["--set", "measure=[transfer, drive]", "--set", "metrics={transfer: [attack], drive: [contact]}"];
    let alone = [&["bench", "transfer", text(&scenes)][..], &beside, &["--out", text(&out)]].concat();
    assert!(failure(&alone).contains("it needs a study of its own"), "{}", failure(&alone));
}
