//! Files of attacks by people: what they hold, and that they drive again alike.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
};

use program::*;
use sage_core::{motion::NOW, scene::TrackKind};
use sage_data::Recording;
use serde_json::Value;

const PEOPLE: [&str; 4] = ["--ego", "idm", "--adversary-type", "pedestrian"];

fn desk() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "6", "--format", "pickle", "--out", text(&scenes)]));
    (folder, scenes)
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Rows of the failures of a folder.
fn failures(folder: &Path) -> Vec<(String, Value)> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut rows: Vec<(String, Value)> = files
        .filter(|path| path.extension().is_some_and(|ending| ending == "json"))
        .filter(|path| text(path).contains("-failure") && !text(path).contains(".gpudrive"))
        .map(|path| (path.file_stem().unwrap().to_str().unwrap().to_owned(), json(&path)))
        .collect();
    rows.sort_by(|a, b| a.0.cmp(&b.0));
    rows
}

#[test]
fn a_placed_person_is_in_every_file_marked_as_added_and_drives_again_alike() {
    let (folder, scenes) = desk();
    let out = folder.path().join("found");
    let command = ["search", text(&scenes), "--budget", "12", "--format", "both", "--out", text(&out)];
    stdout(&sage(&[&command[..], &PEOPLE].concat()));
    let found = failures(&out);
    assert!(found.len() > 3, "{}", found.len());
    for (name, row) in &found {
        let who = row["adversary"].as_str().unwrap();
        let contact = row["contact"]["step"].as_u64().unwrap() as usize;
        assert_eq!(row["placed"], serde_json::json!({"kind": "pedestrian"}));
        assert_eq!(row["method"], "person");
        for file in [pickle(&out, name), out.join(format!("{name}.safetensors"))] {
            let recording = Recording::read(&file).unwrap();
            let scene = &recording.scene;
            // The file names its adversary, although it is no vehicle.
            let track = scene.adversary().unwrap();
            assert_eq!((&*track.id, &track.kind), (who, &TrackKind::Pedestrian), "{}", file.display());
            assert!(track.valid[..=NOW + contact].iter().all(|valid| *valid));
            assert_eq!(track.point(0), track.point(NOW), "it stands until now");
            let provenance = recording.provenance().unwrap().unwrap();
            assert_eq!(sage_data::added_tracks(&provenance), [who], "{}", file.display());
        }
        let scene = row["scene"].as_str().unwrap();
        let again = folder.path().join("again");
        let row_file = out.join(format!("{name}.json"));
        let source = scenes.join(format!("{scene}.pkl"));
        let source = if source.is_file() { source } else { pickle(&scenes, scene) };
        let command = ["simulate", text(&source), "--ego", "idm", "--attack", text(&row_file), "--json"];
        let driven = rows(&sage(&[&command[..], &["--force", "--out", text(&again)]].concat()));
        for key in ["step", "impact_speed"] {
            assert_eq!(driven[0]["contacts"][0][key], row["contact"][key], "{name}");
        }
    }
}

#[test]
fn exports_of_a_person_hold_its_shape_and_say_that_it_was_added() {
    let (folder, scenes) = desk();
    let out = |name: &str| folder.path().join(name);
    let search = |format: &str, more: &[&str]| {
        let folder = out(format);
        let command = ["search", text(&scenes), "--budget", "4", "--first", "--format", format];
        stdout(&sage(&[&command[..], &PEOPLE, more, &["--out", text(&folder)]].concat()));
        failures(&folder)
    };
    for (name, row) in search("openscenario", &["--standard", "1.2"]) {
        let scenario = fs::read_to_string(out("openscenario").join(format!("{name}.xosc"))).unwrap();
        let who = row["adversary"].as_str().unwrap();
        let is_adversary = |part: &&str| part.contains(&format!(r#"name="sage:track" value="{who}""#));
        let part = scenario.split("<ScenarioObject ").find(is_adversary).unwrap_or_else(|| panic!("{name}"));
        assert!(part.contains("<Pedestrian "), "{name}");
        assert!(part.contains(r#"name="sage:added" value="true""#), "{name}");
        assert!(scenario.matches("sage:added").count() >= 2, "in the header too");
    }
    for (name, row) in search("gpudrive", &[]) {
        let files: Vec<&str> = row["files"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
        let file = files.iter().find(|file| file.ends_with(".gpudrive.json")).unwrap();
        let written = json(&out("gpudrive").join(file));
        assert!(written["objects"].as_array().unwrap().iter().any(|object| object["type"] == "pedestrian"));
        assert!(written.to_string().contains("added"), "{name}");
    }
}

#[test]
fn people_do_not_depend_on_threads_and_suites_reproduce_them() {
    let (folder, scenes) = desk();
    let out = |name: &str| folder.path().join(name);
    let searched = |name: &str, more: &[&str]| {
        let folder = out(name);
        let command = ["search", text(&scenes), "--budget", "8", "--out", text(&folder)];
        stdout(&sage(&[&command[..], &PEOPLE, more].concat()));
        failures(&folder)
            .into_iter()
            .map(|(name, row)| (name, row["trajectory"].clone(), row["clauses"].clone()))
            .collect::<Vec<_>>()
    };
    let one = searched("one", &["--threads", "1"]);
    assert!(!one.is_empty());
    assert_eq!(one, searched("two", &["--threads", "2"]));
    for shard in ["1/2", "2/2"] {
        let (shards, command) = (out("shards"), ["search", text(&scenes), "--budget", "8", "--shard", shard]);
        stdout(&sage(&[&command[..], &PEOPLE, &["--out", text(&shards)]].concat()));
    }
    let shards = failures(&out("shards")).into_iter();
    assert_eq!(
        one,
        shards
            .map(|(name, row)| (name, row["trajectory"].clone(), row["clauses"].clone()))
            .collect::<Vec<_>>()
    );
    let suite = out("suite");
    stdout(&sage(&["suite", text(&out("one")), "--keep", "all", "--out", text(&suite)]));
    let tested = sage(&["test", text(&suite), "--ego", "idm", "--json"]);
    assert_eq!(tested.status.code(), Some(1), "each case fails");
    let lines = String::from_utf8(tested.stdout).unwrap();
    let tested: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(tested.len(), one.len());
    assert!(tested.iter().all(|row| row["result"] == "failed"), "{tested:?}");
}

#[test]
fn a_recorded_cyclist_attacks_if_it_is_named() {
    let (folder, scenes) = desk();
    let source = fs::read_dir(&scenes).unwrap().map(|entry| entry.unwrap().path());
    let source = source.into_iter().find(|path| text(path).contains("four-way")).unwrap();
    // A file in which somebody stands beside the road: what a search wrote is the recording here.
    let (file, out) = (folder.path().join("with-cyclist.safetensors"), folder.path().join("found"));
    let spec = advsage::AdversarySpec { kind: Some(advsage::PersonKind::Cyclist), ..Default::default() };
    let placed = spec.of(Recording::read(&source).unwrap()).unwrap();
    placed.write(&file).unwrap();
    let id = placed.scene.adversary().unwrap().id.clone();
    let command = ["search", text(&file), "--ego", "idm", "--adversary-type", "cyclist", "--adversary", &id];
    stdout(&sage(&[&command[..], &["--budget", "8", "--out", text(&out)]].concat()));
    let found = failures(&out);
    assert!(found.iter().all(|(_, row)| row["placed"].is_null() && row["adversary"] == *id));
    let refused = failure(&[
        "search",
        text(&file),
        "--ego",
        "idm",
        "--adversary-type",
        "pedestrian",
        "--adversary",
        &id,
        "--out",
        text(&out.join("x")),
    ]);
    assert!(refused.contains("is a CYCLIST, not a pedestrian"), "{refused}");
}
