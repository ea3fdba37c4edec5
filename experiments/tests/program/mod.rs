//! Runs the real binary in tests.

#![allow(dead_code, clippy::print_stderr)] // Each test program uses a part of it.

mod snapshots;

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;

#[allow(unused_imports)] // Each test program uses a part of it.
pub use snapshots::{added, masked, messages, redacted, sorted};

/// Weights in the binary, so that a test does not depend on other installed weights.
pub const WEIGHTS: [&str; 2] = ["--weights", "procedural"];

/// Exit code of a command whose scenes are bad.
pub const BAD_SCENES: i32 = 65;
/// Exit code after an input or output error.
pub const RETRY: i32 = 74;

pub fn example() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl").display().to_string()
}

pub fn run(program: &Path, arguments: &[&str]) -> Output {
    Command::new(program).args(arguments).env_remove("SAGE_WEIGHTS").output().unwrap()
}

/// An example program; none where only the tests of this crate were built.
pub fn own(name: &str) -> Option<PathBuf> {
    let program = Path::new(env!("CARGO_BIN_EXE_sage")).with_file_name("examples").join(name);
    if !program.exists() {
        eprintln!("left out: `{}` is built by `cargo test --workspace` alone", program.display());
        return None;
    }
    Some(program)
}

pub fn sage(arguments: &[&str]) -> Output {
    run(Path::new(env!("CARGO_BIN_EXE_sage")), arguments)
}

/// Standard output of a program that succeeded.
pub fn stdout(output: &Output) -> &str {
    assert!(output.status.success(), "{}", stderr(output));
    std::str::from_utf8(&output.stdout).unwrap()
}

pub fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).unwrap()
}

pub fn rows(output: &Output) -> Vec<Value> {
    stdout(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Standard error of a program that must fail, and not because of wrong usage.
pub fn failure(arguments: &[&str]) -> String {
    let output = sage(arguments);
    let code = output.status.code();
    assert!(matches!(code, Some(1 | BAD_SCENES | RETRY)), "{arguments:?}: {code:?} {}", stderr(&output));
    stderr(&output).to_owned()
}

/// The pickle of a scene and variant in a data set.
pub fn pickle(out: &Path, scene: &str) -> PathBuf {
    let ending = format!("_{scene}.pkl");
    let names = std::fs::read_dir(out).unwrap().map(|entry| entry.unwrap().path());
    let is_it = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().ends_with(&ending);
    let found: Vec<PathBuf> = names.filter(is_it).collect();
    assert_eq!(found.len(), 1, "{ending} in {}: {found:?}", out.display());
    found[0].clone()
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
