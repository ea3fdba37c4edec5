//! Scene files, data sets, weights and options from strangers: nothing runs, nothing is written outside of
//! the output folder, and what is wrong is said.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "../hostile/mod.rs"]
mod hostile;
mod options;
#[path = "../program/mod.rs"]
mod program;
mod scenes;
mod weights;

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// A run that must not take long or much; the exit code and what it said.
fn quick(arguments: &[&str]) -> (i32, String) {
    let mut command = Command::new("timeout");
    command.arg("60").arg(env!("CARGO_BIN_EXE_sage")).args(arguments);
    let output = command.env_remove("SAGE_WEIGHTS").stdin(Stdio::null()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!said.contains("panicked"), "{said}");
    (output.status.code().unwrap_or(-1), said)
}

/// The embedded experts as a folder.
fn experts(folder: &Path) -> PathBuf {
    let experts = folder.join("experts");
    std::fs::create_dir(&experts).unwrap();
    for file in ["prior", "realistic", "adversarial"] {
        let name = format!("{file}.safetensors");
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural").join(&name);
        std::fs::copy(from, experts.join(&name)).unwrap();
    }
    experts
}
