//! Shards as schedulers run them: in any order, several at once, killed and tried again; and folders that are not as their
//! manifests say.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test; notes go to stderr.

mod exit_codes;
mod file_systems;
#[path = "../hostile/mod.rs"]
mod hostile;
mod manifests;
#[path = "../program/mod.rs"]
mod program;
mod rows;
mod schedulers;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;

use program::*;

/// Some scenes, and a file that is none.
fn scenes(folder: &Path, count: usize) -> PathBuf {
    let scenes = folder.join("scenes");
    let count = count.to_string();
    stdout(&sage(&["scenes", "--count", &count, "--format", "pickle", "--out", text(&scenes)]));
    std::fs::write(scenes.join("broken.pkl"), b"\x80\x04N.").unwrap();
    scenes
}

/// Runs the program in a folder.
fn sage_in(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sage"));
    command.args(arguments).current_dir(folder).env_remove("SAGE_WEIGHTS").output().unwrap()
}

/// Files of a folder without the record of the run, which holds times.
fn files(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = hostile::snapshot(out);
    files.remove("run.json");
    files
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Asserts that a folder is as one run leaves it.
fn assert_same(parts: &Path, whole: &Path) {
    let (found, expected) = (files(parts), files(whole));
    assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
    let other = found.iter().find(|(name, bytes)| expected[*name] != **bytes);
    assert!(other.is_none(), "`{}` differs", other.unwrap().0);
    let [found, expected] = [parts, whole].map(|folder| json(&folder.join("run.json")));
    for key in ["command", "run", "results"] {
        assert_eq!(found[key], expected[key], "{key}");
    }
}

/// Commands that have shards, without their output folder.
const COMMANDS: [(&str, &[&str]); 8] = [
    ("generate", &["generate", "scenes", "--lambda", "0,1", "--weights", "procedural"]),
    ("rows", &["generate", "scenes", "--lambda", "1", "--format", "rows", "--no-pages", "--quiet"]),
    ("simulate", &["simulate", "scenes", "--ego", "replay,idm", "--method", "sage", "--lambda", "1"]),
    ("search", &["search", "scenes", "--ego", "idm", "--budget", "8"]),
    ("rate", &["rate", "scenes", "--ego", "idm,replay", "--budget", "16"]),
    ("convert", &["convert", "scenes", "--to", "openscenario"]),
    ("open-loop", &["bench", "open-loop", "scenes", "--method", "sage,rule", "--lambda", "0,1"]),
    ("drivers", &["bench", "drivers", "scenes", "--ego", "idm,replay"]),
];
