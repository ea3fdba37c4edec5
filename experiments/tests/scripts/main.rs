//! What the commands make of hostile files and options, as scripts: each line prepares a file, runs a command or checks a result.
//!
//! A script is `NAME.script`; its transcript, which holds what the failed commands said, is a snapshot. The verbs are those of
//! `prepare.rs` and `script.rs`. After every command the runner checks what must hold for all: see [`script::Script::run`].

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test; notes go to stderr.

#[path = "../hostile/mod.rs"]
mod hostile;
#[path = "../../../sage-data/tests/mutants/mod.rs"]
mod mutants;
#[cfg(unix)]
mod odd_use;
mod prepare;
#[path = "../program/mod.rs"]
mod program;
mod promises;
mod script;
mod weights;

use std::{
    path::{Path, PathBuf},
    sync::Mutex,
};

/// The scripts of this folder.
fn scripts() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scripts");
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "script"));
    files.sort();
    files
}

#[cfg(unix)]
#[test]
fn commands_do_what_the_scripts_say() {
    let chosen = std::env::var("SAGE_SCRIPT").ok();
    let name = |file: &Path| file.file_stem().unwrap().to_str().unwrap().to_owned();
    let mut left = scripts();
    left.retain(|file| chosen.as_ref().is_none_or(|chosen| chosen.split(',').any(|one| one == name(file))));
    let (left, done) = (Mutex::new(left), Mutex::new(Vec::new()));
    let threads = std::thread::available_parallelism().map_or(2, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(file) = { left.lock().unwrap().pop() } {
                    let text = std::fs::read_to_string(&file).unwrap();
                    let transcript = script::run(&text, &name(&file));
                    done.lock().unwrap().extend(transcript.map(|(told, wrong)| (name(&file), told, wrong)));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap();
    done.sort();
    let wrong: Vec<&str> = done.iter().flat_map(|(_, _, wrong)| wrong).map(String::as_str).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    for (name, transcript, _) in done {
        insta::assert_snapshot!(name, transcript);
    }
}
