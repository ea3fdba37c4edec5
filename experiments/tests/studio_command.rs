//! `sage studio`: what its page shows is what `sage simulate` and `sage search` make.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;
mod studio;

use std::{fs, path::Path, process::Command};

use program::*;
use serde_json::{Value, json};
use studio::{Studio, lines, wanted};

const DRIVERS: [&str; 3] = ["idm", "expert", "pdm"];

/// Sums of the differences that a page holds, in metres.
fn sums(differences: &Value) -> Vec<f64> {
    let all = differences.as_array().unwrap().iter().map(|value| value.as_i64().unwrap());
    let sums = all.scan(0, |sum, difference| {
        *sum += difference;
        Some(*sum as f64 / 100.0)
    });
    sums.collect()
}

/// Runs lines of a shell with the real binary as `sage`.
fn shell(lines: &str, folder: &Path) {
    let binaries = Path::new(env!("CARGO_BIN_EXE_sage")).parent().unwrap();
    let path = format!("{}:{}", binaries.display(), std::env::var("PATH").unwrap_or_default());
    let mut command = Command::new("sh");
    let output = command.args(["-ec", lines]).current_dir(folder).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{lines}\n{}", stderr(&output));
}

/// Compares the drives of an answer with those of its own command, run in a folder.
fn compare(answer: &Value, origin: &Value, folder: &Path) {
    let command = answer["command"].as_str().unwrap();
    for old in ["drives", "invented"] {
        let _ = fs::remove_dir_all(folder.join(old));
    }
    shell(command, folder);
    let rows = rows_in(&folder.join("drives"));
    let panels = answer["drives"]["panels"].as_array().unwrap();
    assert_eq!(rows.len(), panels.len(), "{command}");
    for panel in panels {
        compare_drive(panel, rows.iter().find(|row| row["ego"] == panel["name"]).unwrap(), origin, command);
    }
}

#[test]
fn the_page_shows_what_its_command_makes() {
    let folder = tempfile::tempdir().unwrap();
    let mut studio =
        Studio::start(&["--procedural", "14", "--seed", "3", "--ego", &DRIVERS.join(",")], folder.path());
    let session = studio.session();
    let ask = |path: &str, body: &Value| -> Value {
        let (status, answer) = studio.post(path, Some(&session), &body.to_string());
        assert_eq!(status, 200, "{body}: {answer}");
        serde_json::from_str(&answer).unwrap()
    };
    for scene in 0..14 {
        let described = ask("/scene", &json!({"scene": scene}));
        let origin = &described["data"]["origin"];
        let mut wanted = wanted(scene, 4 * (scene % 6), &[scene % 3, (scene + 1) % 3]);
        let answer = ask("/drive", &wanted);
        compare(&answer, origin, folder.path());
        // Another adversary, somebody away, a goal.
        let users = described["users"].as_array().unwrap();
        let others: Vec<&Value> = users.iter().filter(|user| user["id"] != described["adversary"]).collect();
        match scene % 3 {
            0 => {
                wanted["adversary"] = others
                    .iter()
                    .find(|user| user["canAttack"] == true)
                    .map_or(Value::Null, |user| user["id"].clone())
            }
            1 => wanted["without"] = others.iter().take(2).map(|user| user["id"].clone()).collect(),
            _ => {
                let (x, y) = (
                    &answer["drives"]["panels"][0]["adversary"]["runs"][0]["x"],
                    &answer["drives"]["panels"][0]["adversary"]["runs"][0]["y"],
                );
                let [x, y] = [(x, 0), (y, 1)]
                    .map(|(d, axis)| sums(d).last().unwrap() + origin[axis].as_f64().unwrap());
                wanted["goal"] = json!([x + 4.0, y - 3.0]);
            }
        }
        compare(&ask("/drive", &wanted), origin, folder.path());
    }
}

/// Compares a drive of an answer with its row.
fn compare_drive(panel: &Value, row: &Value, origin: &Value, what: &str) {
    let run = &panel["ego"]["runs"][0];
    let shown = sums(&run["x"]).into_iter().zip(sums(&run["y"]));
    for ((x, y), state) in shown.zip(row["trajectory"].as_array().unwrap()) {
        let at = |axis: usize| state[axis].as_f64().unwrap() - origin[axis].as_f64().unwrap();
        assert!((x - at(0)).abs() < 0.0051 && (y - at(1)).abs() < 0.0051, "{what}");
    }
    assert_eq!(panel["verdict"], row["attack"]["verdict"]["attack"], "{what}");
    let contact = row["contacts"].as_array().unwrap().first();
    let step = contact.map(|contact| contact["step"].as_i64().unwrap() + 10);
    assert_eq!(panel["contact"]["frame"].as_i64(), step, "{what}");
}

/// Rows in a folder of `sage simulate`.
fn rows_in(folder: &Path) -> Vec<Value> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_row = |name: &str| name.ends_with(".json") && !["run.json", "manifest.json"].contains(&name);
    files
        .filter(|path| is_row(path.file_name().unwrap().to_str().unwrap()))
        .map(|path| serde_json::from_slice(&fs::read(path).unwrap()).unwrap())
        .collect()
}

#[test]
fn three_hundred_drives_of_the_page_are_rows_of_simulate() {
    const SCENES: usize = 20;
    let folder = tempfile::tempdir().unwrap();
    let drivers = DRIVERS.join(",");
    shell(
        &format!(
            "sage scenes --count {SCENES} --seed 6 --out invented
             sage simulate invented --ego {drivers} --method sage --lambda 0,0.25,0.5,0.75,1 --out drives"
        ),
        folder.path(),
    );
    let rows = rows_in(&folder.path().join("drives"));
    let mut studio = Studio::start(&["invented", "--ego", &drivers], folder.path());
    let session = studio.session();
    let ask = |path: &str, body: &Value| -> Value {
        let (status, answer) = studio.post(path, Some(&session), &body.to_string());
        assert_eq!(status, 200, "{body}: {answer}");
        serde_json::from_str(&answer).unwrap()
    };
    let names = ask("/offered", &json!({}))["scenes"].clone();
    let (mut compared, mut attacks) = (0, 0);
    for scene in 0..SCENES {
        let origin = ask("/scene", &json!({"scene": scene}))["data"]["origin"].clone();
        let name = names[scene].as_str().unwrap().split('.').next().unwrap();
        for (driver, label) in DRIVERS.into_iter().enumerate() {
            for place in 0..5 {
                let row = rows.iter().find(|row| {
                    row["scene"] == name && row["ego"] == label && row["lambda"] == 0.25 * f64::from(place)
                });
                let Some(row) = row else { continue };
                let answer = ask("/drive", &wanted(scene, 5 * place as usize, &[driver]));
                let what = format!("{name} {label} {place}");
                compare_drive(&answer["drives"]["panels"][0], row, &origin, &what);
                compared += 1;
                attacks += usize::from(row["attack"]["verdict"]["attack"] == true);
            }
        }
    }
    assert!(compared == 5 * 3 * SCENES && attacks > 20, "{compared} drives, {attacks} attacks");
}

#[test]
fn what_the_page_finds_is_what_search_finds_and_can_be_kept() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--procedural", "3", "--ego", "idm,expert", "--budget", "24", "--out", "suite"];
    let mut studio = Studio::start(&arguments, folder.path());
    let session = studio.session();
    let post = |path: &str, body: &Value| studio.post(path, Some(&session), &body.to_string());
    let ask = |path: &str, body: &Value| -> Value {
        let (status, answer) = post(path, body);
        assert_eq!(status, 200, "{body}: {answer}");
        serde_json::from_str(&answer).unwrap()
    };
    let mut choice = wanted(2, 20, &[0, 1]);
    choice["found"] = json!({"number": 0, "without": []});
    let early = post("/drive", &choice);
    assert!(early.0 == 422 && early.1.contains("search again"), "{early:?}");
    let (status, answer) = post("/search", &wanted(2, 20, &[0, 1]));
    let said = lines(&answer);
    let (drives, last) = said.split_at(said.len() - 1);
    assert_eq!((status, drives.len()), (200, 24), "{answer}");
    assert!(drives.iter().enumerate().all(|(k, line)| line["drives"] == k + 1), "{answer}");
    let found = last[0]["found"].as_array().unwrap();
    assert!(!found.is_empty(), "{answer}");

    // A failure on both drivers, by the commands that the page gives.
    let origin = ask("/scene", &json!({"scene": 2}))["data"]["origin"].clone();
    for number in 0..found.len() {
        choice["found"] = json!({"number": number, "without": []});
        compare(&ask("/drive", &choice), &origin, folder.path());
        let _ = fs::remove_dir_all(folder.path().join("found"));
    }
    choice["found"] = json!({"number": 0, "without": []});
    let explained = ask("/explain", &choice);
    let words = explained["words"][0]["text"].as_str().unwrap();
    assert!(
        explained["words"][0]["failure"] == true
            && words.starts_with("A failure. The driver of UN R157 would "),
        "{words}"
    );
    assert!(words.contains(" After "), "{words}");

    // Nothing is written until something is kept; the same failure is one test.
    assert!(!folder.path().join("suite").exists());
    let kept = ask("/keep", &choice);
    assert_eq!(ask("/keep", &choice), kept, "twice");
    // The same plan where somebody is not there, by the commands of the page too.
    let users = ask("/scene", &json!({"scene": 2}));
    let away =
        users["users"].as_array().unwrap().iter().rfind(|user| user["id"] != users["adversary"]).unwrap();
    choice["without"] = json!([away["id"]]);
    compare(&ask("/drive", &choice), &origin, folder.path());
    choice["found"]["without"] = choice["without"].clone();
    let (status, answer) = post("/keep", &choice);
    assert!(status == 422 && answer.contains("search again"), "{answer}");
    // All places of the slider.
    let swept = lines(&post("/sweep", &wanted(2, 20, &[0])).1);
    let mut steps: Vec<u64> = swept.iter().filter_map(|line| line["step"].as_u64()).collect();
    steps.sort_unstable();
    assert_eq!(steps, (0..21).collect::<Vec<_>>());
    for line in swept.iter().take(4) {
        let at = wanted(2, line["step"].as_u64().unwrap() as usize, &[0]);
        let is_failure = ask("/explain", &at)["words"][0]["failure"] == true;
        assert_eq!(line["becomes"] == "failure", is_failure, "{line}");
    }
    let not = post("/keep", &wanted(0, 0, &[0]));
    assert!(not.0 == 422 && not.1.contains("no driver here fails"), "{not:?}");
    drop(studio);
    let folder = folder.path();
    let suite: Value = serde_json::from_slice(&fs::read(folder.join("suite/suite.json")).unwrap()).unwrap();
    let tests = suite["tests"].as_array().unwrap();
    assert_eq!(tests.len(), kept["tests"].as_u64().unwrap() as usize);
    assert!(!folder.join("suite/.sage-unfinished").exists());
    let tested = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(["test", "suite", "--ego", "idm"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert_eq!(tested.status.code(), Some(1), "it fails there: {}", stderr(&tested));

    // Another session adds to it, here a scene without somebody; a folder of something else is refused.
    let mut studio = Studio::start(&arguments, folder);
    let session = studio.session();
    let mut altered = wanted(2, 20, &[0]);
    let users = studio.post("/scene", Some(&session), r#"{"scene": 2}"#).1;
    let users: Value = serde_json::from_str(&users).unwrap();
    let far =
        users["users"].as_array().unwrap().iter().rfind(|user| user["id"] != users["adversary"]).unwrap();
    altered["without"] = json!([far["id"]]);
    let found = lines(&studio.post("/search", Some(&session), &altered.to_string()).1);
    assert!(!found.last().unwrap()["found"].as_array().unwrap().is_empty(), "{found:?}");
    altered["found"] = json!({"number": 0, "without": [far["id"]]});
    let (status, answer) = studio.post("/keep", Some(&session), &altered.to_string());
    assert_eq!(status, 200, "{answer}");
    let suite: Value = serde_json::from_slice(&fs::read(folder.join("suite/suite.json")).unwrap()).unwrap();
    assert_eq!(suite["tests"].as_array().unwrap().len(), tests.len() + 1, "{answer}");
    let scene = suite["tests"][tests.len()]["scene"].as_str().unwrap();
    assert!(scene.contains("-without-"), "{scene}");
    let scene = sage_data::Recording::read(&folder.join("suite/scenes").join(scene)).unwrap().scene;
    assert!(scene.tracks.iter().all(|track| far["id"] != *track.id), "it is gone");
    fs::create_dir(folder.join("other")).unwrap();
    fs::write(folder.join("other/notes.txt"), "x").unwrap();
    let refused = sage(&["studio", "--procedural", "1", "--out", folder.join("other").to_str().unwrap()]);
    assert!(stderr(&refused).contains("is not empty and holds no suite"), "{}", stderr(&refused));
}

#[test]
fn every_generator_is_offered_with_every_weights() {
    let folder = tempfile::tempdir().unwrap();
    let other = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let weights = format!("procedural,{}", other.display());
    let arguments = ["--procedural", "1", "--method", "sage", "--method", "rule", "--weights", &*weights];
    let mut studio = Studio::start(&arguments, folder.path());
    let session = studio.session();
    let offered: Value = serde_json::from_str(&studio.post("/offered", Some(&session), "").1).unwrap();
    let names: Vec<&str> =
        offered["generators"].as_array().unwrap().iter().map(|one| one["name"].as_str().unwrap()).collect();
    assert_eq!((names.len(), names[0], names[1]), (4, "sage, procedural", "rule, procedural"));
    let mut choice = wanted(0, 20, &[0]);
    choice["generator"] = json!(2);
    let answer: Value =
        serde_json::from_str(&studio.post("/drive", Some(&session), &choice.to_string()).1).unwrap();
    assert!(answer["command"].as_str().unwrap().contains(&other.display().to_string()), "{answer}");
}

#[test]
fn names_of_strangers_reach_the_shell_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let name = "it's $(touch broken) \"x\" `id`.pkl";
    fs::copy(example(), folder.path().join(name)).unwrap();
    let mut studio = Studio::start(&[name], folder.path());
    let session = studio.session();
    let (status, answer) = studio.post("/drive", Some(&session), &wanted(0, 20, &[0]).to_string());
    assert_eq!(status, 200, "{answer}");
    let answer: Value = serde_json::from_str(&answer).unwrap();
    shell(answer["command"].as_str().unwrap(), folder.path());
    assert!(folder.path().join("drives/run.json").is_file() && !folder.path().join("broken").exists());
}
