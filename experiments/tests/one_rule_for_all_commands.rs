//! What holds for all commands alike: default weights, and lines that fit a terminal.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod found_failures;
mod program;

use std::{
    path::Path,
    process::{Command, Output},
};

use found_failures::*;
use program::*;

/// Most characters of a line.
const COLUMNS: usize = 100;

/// Commands that need experts, without their output folder.
fn commands_with_weights(scene: &str) -> Vec<Vec<String>> {
    let words = |line: &str| line.replace("SCENE", scene).split(' ').map(str::to_owned).collect();
    let all = [
        "generate SCENE --lambda 1 --format rows --json",
        "explain SCENE --lambda 1 --json",
        "simulate SCENE --ego idm --method sage --lambda 1 --json",
        "search SCENE --ego idm --budget 4 --json",
        "rate SCENE --ego idm --budget 4 --json",
        "predict SCENE --k 3 --json",
        "bench open-loop SCENE --method sage",
        "bench drivers SCENE --ego idm",
        "bench dial SCENE",
        "calibrate SCENE --selection natural",
        "bench search SCENE --ego idm --set search={\"budget\":2} --method pool",
        "train-ego --procedural 6 --updates 300 --evaluations 1 --config {\"td3\":{\"hidden\":[8,8],\"batch\":16,\"random_steps\":200}} --method sage --eval-method none",
    ];
    all.into_iter().map(words).collect()
}

fn in_folder(folder: &Path, installed: Option<&Path>, command: &[String]) -> Output {
    let mut sage = Command::new(env!("CARGO_BIN_EXE_sage"));
    sage.args(command).current_dir(folder).env_remove("SAGE_WEIGHTS");
    if let Some(installed) = installed {
        sage.env("SAGE_WEIGHTS", installed);
    }
    sage.output().unwrap()
}

#[test]
fn default_weights_are_the_same_in_every_command_and_folder() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    // A folder that holds other weights under the name `waymo`.
    let waymo = folder.path().join("with/weights/waymo");
    std::fs::create_dir_all(&waymo).unwrap();
    for entry in std::fs::read_dir(root.join("weights/procedural")).unwrap() {
        let entry = entry.unwrap();
        if entry.path().is_dir() {
            continue;
        }
        std::fs::copy(entry.path(), waymo.join(entry.file_name())).unwrap();
    }
    let (with, named) = (folder.path().join("with"), folder.path().join("with/weights"));
    for (number, command) in commands_with_weights(&scene).into_iter().enumerate() {
        let mut said = Vec::new();
        let places: [(&Path, Option<&Path>); 4] =
            [(folder.path(), None), (root, None), (&with, None), (folder.path(), Some(&named))];
        for (place, (cwd, installed)) in places.iter().enumerate() {
            let out = folder.path().join(format!("out{number}-{place}"));
            let out = match &*command[0] {
                "explain" | "predict" => Vec::new(),
                _ => vec!["--out".to_owned(), out.display().to_string()],
            };
            let output = in_folder(cwd, *installed, &[&command[..], &out].concat());
            let notes: Vec<String> = stderr(&output)
                .lines()
                .filter(|line| line.starts_with("note: weights"))
                .map(str::to_owned)
                .collect();
            assert!(output.status.success(), "{command:?}: {}", stderr(&output));
            let rows = stdout(&output)
                .lines()
                .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
            let rows = rows.map(|mut row| {
                for key in ["seconds", "step_ms", "run_hash"] {
                    row[key] = serde_json::Value::Null;
                }
                row
            });
            said.push((notes, rows.collect::<Vec<_>>()));
        }
        assert!(said[0].0.iter().any(|note| note.contains("`procedural`")), "{command:?}: {:?}", said[0].0);
        assert!(said.iter().all(|one| *one == said[0]), "{command:?} depends on the folder");
    }
    // By their name they are found in either place.
    let predict = ["predict", &scene, "--weights", "waymo"].map(str::to_owned);
    for (cwd, installed) in [(&*with, None), (folder.path(), Some(&*named))] {
        assert!(stderr(&in_folder(cwd, installed, &predict)).contains("note: weights `waymo`"));
    }
}

#[test]
fn tables_and_notes_fit_a_terminal() {
    let desk = Desk::new();
    let at = |name: &str| desk.at(name);
    let scene = example();
    let candidates = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.json");
    let candidates = candidates.display().to_string();
    let (scenes, found, suite) = (at("scenes"), at("found"), at("suite"));
    let commands: [&[&str]; 20] = [
        &["list"],
        &["bench", "list"],
        &["inspect", &scene, &scenes],
        &["inspect", &scene, "--tracks"],
        &["score", &scene, "--candidates", &candidates],
        &["predict", &scene, "--k", "3"],
        &["explain", &scene],
        &["explain", &at("found/curve-1-1.json")],
        &["generate", &scenes, "--lambda", "0:1:0.25", "--format", "rows", "--out", &at("a")],
        &["simulate", &scenes, "--ego", "replay,idm", "--out", &at("b")],
        &["simulate", &scenes, "--ego", "idm", "--method", "sage", "--lambda", "0,1", "--out", &at("c")],
        &["search", &scenes, "--ego", "expert", "--budget", "8", "--out", &at("d")],
        &["rate", &scenes, "--ego", "idm,expert", "--budget", "8", "--out", &at("j")],
        &["report", &found, "--out", &at("e")],
        &["suite", &found, "--diverse", "3", "--out", &at("f")],
        &["test", &suite, "--ego", "idm"],
        &["theory", "--instances", "20"],
        &["bench", "open-loop", &scenes, "--method", "log,sage", "--out", &at("g")],
        &["bench", "drivers", &scenes, "--ego", "replay,idm", "--out", &at("h")],
        &["convert", &scenes, "--to", "native", "--out", &at("i")],
    ];
    for command in commands {
        let output = sage(command);
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert!(!text.concat().is_empty(), "{command:?}");
        for line in text.iter().flat_map(|text| text.lines()) {
            // A path is never broken, nor is the name that somebody gave to a driver.
            let is_free = line.contains('/') || line.starts_with("error:");
            // A machine that does other work besides takes more digits.
            let timed = line.rsplit_once(" (").filter(|(_, time)| time.ends_with(" ms)"));
            let width =
                timed.map_or(line.chars().count(), |(line, _)| line.chars().count() + " (9 ms)".len());
            assert!(is_free || width <= COLUMNS, "{command:?}: {line}");
        }
    }
}
