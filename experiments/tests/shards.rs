//! Shards of the Waymo Open Motion Dataset and OpenSCENARIO files, as a user reads and writes them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hostile;
mod program;

use std::{
    collections::BTreeMap,
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use insta::assert_snapshot;
use program::*;
use sage_data::{Recording, folder};
use serde_json::Value;

/// The invented shard: two scenes.
fn shard() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../sage-data/tests/data/womd_synthetic.tfrecord")
}

/// Procedural scenes as a shard in a folder.
fn procedural(folder: &Path, count: usize) -> PathBuf {
    let count = count.to_string();
    let scenes = folder.join("scenes");
    stdout(&sage(&["scenes", "--count", &count, "--format", "pickle", "--out", text(&scenes)]));
    convert(&scenes, "womd", &folder.join("womd"), &[]);
    folder.join("womd/scenes.tfrecord-00000-of-00001")
}

fn convert(from: &Path, to: &str, out: &Path, more: &[&str]) -> Output {
    let output = sage(&[&["convert", text(from), "--to", to, "--out", text(out)], more].concat());
    stdout(&output);
    output
}

/// Files of a folder without the record of the run, which holds times.
fn files(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = hostile::snapshot(out);
    files.remove("run.json");
    files
}

/// Runs a command with bytes on its standard input.
fn piped(arguments: &[&str], bytes: &[u8]) -> Output {
    let mut run = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(arguments)
        .env_remove("SAGE_WEIGHTS")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (mut input, bytes) = (run.stdin.take().unwrap(), bytes.to_vec());
    let writer = std::thread::spawn(move || input.write_all(&bytes));
    let output = run.wait_with_output().unwrap();
    let _ = writer.join();
    output
}

fn ids(output: &Output) -> Vec<String> {
    rows(output).iter().map(|row| row["id"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn inspect_takes_a_shard_one_of_its_records_and_a_pipe() {
    let shard = shard();
    let both = ["synthetic-one", "synthetic-two"];
    assert_eq!(ids(&sage(&["inspect", text(&shard), "--json"])), both);
    assert_snapshot!("inspected_shard", redacted(stdout(&sage(&["inspect", text(&shard)]))));
    for record in ["1", "synthetic-two"] {
        let record = format!("{}#{record}", shard.display());
        assert_eq!(ids(&sage(&["inspect", &record, "--json"])), both[1..]);
    }
    assert_eq!(ids(&piped(&["inspect", "-", "--json"], &std::fs::read(&shard).unwrap())), both);
    let draw = |record: &str| failure(&["draw", &format!("{}{record}", shard.display()), "--out", "-"]);
    let refused = [("record 7", draw("#7")), ("the whole shard", draw(""))];
    assert_snapshot!("records_that_are_no_scene", messages(refused));
    let drawn = sage(&["draw", &format!("{}#0", shard.display()), "--out", "-"]);
    assert!(stdout(&drawn).contains("<svg"));
    // A folder may hold shards and other files.
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(&shard, folder.path().join("some.tfrecord-00000-of-00001")).unwrap();
    std::fs::copy(example(), folder.path().join("crossing.pkl")).unwrap();
    assert_eq!(ids(&sage(&["inspect", text(folder.path()), "--json"])).len(), 3);
}

#[test]
fn a_shard_becomes_a_data_set_and_the_same_shard_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let shard = procedural(folder.path(), 5);
    convert(&shard, "pickle", &at("pickles"), &[]);
    assert_eq!(folder::scene_files(&at("pickles")).unwrap().len(), 5);
    assert!(at("pickles/dataset_summary.pkl").is_file());
    let names: Vec<String> =
        files(&at("pickles")).into_keys().filter(|name| name.starts_with("sd_")).collect();
    // The scenes are not Waymo's, and their records say so.
    assert!(names.iter().all(|name| name.starts_with("sd_sage_womd_")), "{names:?}");
    convert(&shard, "native", &at("native"), &[]);
    for record in folder::scene_files(&shard).unwrap() {
        let scene = Recording::read(&record).unwrap().scene;
        let id = folder::scene_name(&record).unwrap();
        let pickle = Recording::read(&at("pickles").join(format!("sd_sage_womd_{id}.pkl"))).unwrap();
        let native = Recording::read(&at("native").join(format!("{id}.safetensors"))).unwrap();
        assert!(scene == pickle.scene && scene == native.scene, "{id}");
    }
    // The order of the records is that of the files' names.
    convert(&at("native"), "womd", &at("again"), &["--scenes-per-file", "2"]);
    let again: Vec<PathBuf> = folder::scene_files(&at("again")).unwrap();
    assert_eq!(again.len(), 5);
    assert!(at("again/scenes.tfrecord-00002-of-00003").is_file());
    for record in again {
        let scene = Recording::read(&record).unwrap().scene;
        let native = at("native").join(format!("{}.safetensors", folder::scene_name(&record).unwrap()));
        assert_eq!(scene, Recording::read(&native).unwrap().scene);
    }
}

#[test]
fn an_attack_is_the_same_from_a_record_and_from_a_pickle() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let shard = procedural(folder.path(), 3);
    convert(&shard, "pickle", &at("pickles"), &[]);
    let attacks = |scenes: &Path, out: &str| -> Vec<Value> {
        let arguments = ["generate", text(scenes), "--lambda", "1", "--json", "--format", "pickle"];
        let out = at(out);
        rows(&sage(&[&arguments[..], &WEIGHTS, &["--out", text(&out)]].concat()))
    };
    let [records, pickles] = [attacks(&shard, "from-records"), attacks(&at("pickles"), "from-pickles")];
    assert_eq!(records.len(), 3);
    for record in &records {
        let name = record["scene"].as_str().unwrap();
        let pickle = pickles.iter().find(|row| row["scene"].as_str().unwrap().ends_with(name)).unwrap();
        for key in ["trajectory", "scores", "candidates", "violations", "chosen"] {
            assert_eq!(record[key], pickle[key], "{name}: {key}");
        }
    }
}

#[test]
fn attacked_scenarios_share_their_map_and_state_their_origin() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = example();
    let generate = |out: &Path, more: &[&str]| {
        let arguments =
            ["generate", &scene, "--lambda", "0,1", "--format", "openscenario", "--out", text(out)];
        sage(&[&arguments[..], &WEIGHTS, more].concat())
    };
    stdout(&generate(&at("one"), &["--threads", "1"]));
    stdout(&generate(&at("two"), &[]));
    let all = files(&at("one"));
    let scenarios = |files: &BTreeMap<String, Vec<u8>>| -> BTreeMap<String, Vec<u8>> {
        let is_scenario = |name: &String| name.ends_with(".xosc") || name.ends_with(".xodr");
        files.iter().filter(|(name, _)| is_scenario(name)).map(|(n, b)| (n.clone(), b.clone())).collect()
    };
    assert_eq!(scenarios(&all), scenarios(&files(&at("two"))));
    let maps: Vec<&String> = all.keys().filter(|name| name.ends_with(".xodr")).collect();
    assert_eq!(maps.len(), 1);
    for lambda in ["0.00", "1.00"] {
        let text = String::from_utf8(all[&format!("crossing-lambda{lambda}.xosc")].clone()).unwrap();
        assert!(text.contains(maps[0]));
        let facts = [
            "source\" value=\"crossing.pkl",
            "method\" value=\"sage",
            "seed\" value=\"0",
            "feasible",
            "origin",
        ];
        for fact in facts {
            assert!(text.contains(&format!("sage:{fact}")), "{lambda}: {fact}");
        }
        assert!(text.contains("attacked by sage, replayed"), "{lambda}");
        // Neither the path of an input nor the command.
        assert!(!text.contains("examples/") && !text.contains("--out"), "{lambda}");
    }
    let given = generate(&at("controlled"), &["--standard", "1.0", "--scenario-ego", "controller"]);
    stdout(&given);
    let controlled = std::fs::read_to_string(at("controlled/crossing-lambda1.00.xosc")).unwrap();
    assert!(controlled.contains("revMinor=\"0\"") && controlled.contains("ExternalController"));
    let refused = failure(&["generate", &scene, "--standard", "1.0", "--out", text(&at("refused"))]);
    assert_snapshot!(refused, @"error: --standard and --scenario-ego need --format openscenario");
    // An attacked pickle keeps its origin as a scenario.
    stdout(&sage(
        &[
            &["generate", &scene, "--lambda", "1", "--format", "pickle", "--out", text(&at("pickles"))],
            &WEIGHTS[..],
        ]
        .concat(),
    ));
    convert(&pickle(&at("pickles"), "crossing-lambda1.00"), "openscenario", &at("converted"), &[]);
    let converted = files(&at("converted"));
    let (_, bytes) = converted.iter().find(|(name, _)| name.ends_with(".xosc")).unwrap();
    let converted = std::str::from_utf8(bytes).unwrap();
    assert!(converted.contains("sage:lambda\" value=\"1.0") && !converted.contains("--out"));
}
