//! A defect of the program, brought about by one scene, costs that scene: the others are done, it is named, and the exit
//! status says so.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod program;

use std::path::{Path, PathBuf};

use program::*;

/// Exit code of a command that met a defect.
const DEFECT: i32 = 70;
/// The scene in which the parts of the example panic.
const BAD: &str = "merge-1-2";
const FRAGILE: &str = r#"fragile{"scene": "merge-1-2"}"#;

/// The example program with parts that panic.
fn defective() -> Option<PathBuf> {
    let program = Path::new(env!("CARGO_BIN_EXE_sage")).with_file_name("examples").join("defective");
    if !program.exists() {
        eprintln!("left out: `{}` is built by `cargo test --workspace` alone", program.display());
        return None;
    }
    Some(program)
}

fn scenes(folder: &Path) -> PathBuf {
    let scenes = folder.join("scenes");
    stdout(&sage(&["scenes", "--count", "4", "--out", text(&scenes)]));
    scenes
}

/// The folder of results of a command, which must have met a defect in one scene and done the others.
fn done(program: &Path, folder: &Path, words: &[&str]) -> (PathBuf, String) {
    let out = tempfile::Builder::new().prefix("out-").tempdir_in(folder).unwrap().keep().join("out");
    let output = run(program, &[words, &["--out", text(&out)]].concat());
    let said = stderr(&output).to_owned();
    assert_eq!(output.status.code(), Some(DEFECT), "{words:?}: {said}");
    assert!(said.contains("please report it") && said.contains(BAD), "{words:?}: {said}");
    assert!(!said.contains("stack backtrace") && !said.contains("panicked at"), "{words:?}: {said}");
    (out, said)
}

/// Number of files of a scene in a folder.
fn files_of(out: &Path, scene: &str) -> usize {
    let names =
        std::fs::read_dir(out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.starts_with(scene)).count()
}

#[test]
fn a_scene_that_meets_a_defect_costs_no_other() {
    let Some(program) = defective() else { return };
    let folder = tempfile::tempdir().unwrap();
    let scenes = scenes(folder.path());
    let late = r#"fragile{"scene": "merge-1-2", "step": 40}"#;
    for words in [
        &["generate", text(&scenes), "--method", FRAGILE, "--format", "rows", "--no-pages"][..],
        &["simulate", text(&scenes), "--ego", FRAGILE],
        &["simulate", text(&scenes), "--ego", late, "--method", "rule"],
        &["simulate", text(&scenes), "--ego", "idm", "--method", FRAGILE],
        &["search", text(&scenes), "--ego", FRAGILE, "--method", "rule", "--budget", "4"],
    ] {
        let (out, said) = done(&program, folder.path(), words);
        assert!(
            said.contains("defective.rs:") || said.contains("index out of bounds"),
            "it says where: {said}"
        );
        for scene in ["curve-1-1", "four-way-1-3", "straight-1-0"] {
            assert!(files_of(&out, scene) > 0, "{words:?}: `{scene}` is done");
        }
        assert_eq!(files_of(&out, BAD), 0, "{words:?}");
    }
}

#[test]
fn shards_studies_and_trainings_go_on_too() {
    let Some(program) = defective() else { return };
    let folder = tempfile::tempdir().unwrap();
    let scenes = scenes(folder.path());
    // Shards: the scene is named in the manifest, and the others are joined.
    let parts = folder.path().join("parts");
    let mut defects = 0;
    for shard in ["1/2", "2/2"] {
        let words = ["generate", text(&scenes), "--method", FRAGILE, "--format", "rows", "--no-pages"];
        let output = run(&program, &[&words[..], &["--shard", shard, "--out", text(&parts)]].concat());
        defects += usize::from(output.status.code() == Some(DEFECT));
    }
    assert_eq!(defects, 1);
    let joined = run(&program, &["join", text(&parts)]);
    assert!(stderr(&joined).contains(BAD), "{}", stderr(&joined));
    assert_eq!(files_of(&parts, "straight-1-0"), 1);
    // Studies.
    let (out, _) = done(
        &program,
        folder.path(),
        &["bench", "open-loop", text(&scenes), "--method", &format!("rule,{FRAGILE}")],
    );
    let table = std::fs::read_to_string(out.join("table.md")).unwrap();
    assert!(table.contains("rule"), "{table}");
    // Training: the scene is passed over.
    let (out, _) = done(
        &program,
        folder.path(),
        &[
            "train-ego",
            text(&scenes),
            "--method",
            FRAGILE,
            "--learner",
            "ppo",
            "--steps",
            "4096",
            "--evaluations",
            "1",
            "--eval",
            text(&scenes),
            "--allow-overlap",
        ],
    );
    assert!(out.join("run.json").exists());
    // A teacher that panics while it drives ends its episodes.
    let words = ["train-ego", text(&scenes), "--learner", "ppo", "--method", "rule", "--teacher"];
    let more = ["--steps", "4096", "--evaluations", "1", "--eval", text(&scenes), "--allow-overlap"];
    let late = r#"fragile{"scene": "merge-1-2", "step": 3}"#;
    let (out, _) = done(&program, folder.path(), &[&words[..], &[late], &more].concat());
    assert!(out.join("run.json").exists());
}
