//! Runs that are killed, run twice at once, or run out of disk: nothing is lost, nothing half-made stays.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hostile;
mod interruption;
mod program;

use std::{
    path::Path,
    process::{Command, Output, Stdio},
};

use interruption::Case;
use program::*;

/// Times that each command is killed here; `kill_anywhere` does it as often as wanted.
const KILLS: u64 = 3;

/// Kills commands, each in a folder of its own.
fn killed(names: &[&str]) {
    for name in names {
        let folder = tempfile::tempdir().unwrap();
        let case = Case::new(Path::new(env!("CARGO_BIN_EXE_sage")), name, folder.path());
        let (expected, time) = case.whole();
        for number in 0..KILLS {
            case.kill_and_run_again(number, time, &expected)
                .unwrap_or_else(|problem| panic!("{name}: {problem}"));
        }
    }
}

#[test]
fn killed_trainings_of_networks_go_on_to_the_same_files() {
    killed(&["pretrain", "finetune"]);
}

#[test]
fn killed_runs_over_scenes_resume_to_the_same_files() {
    killed(&[
        "generate",
        "simulate",
        "search",
        "rate",
        "convert",
        "convert-shards",
        "convert-scenarios",
        "calibrate",
    ]);
}

#[test]
fn killed_runs_that_write_once_begin_anew() {
    killed(&["scenes", "demo", "suite", "report"]);
}

#[test]
fn killed_studies_go_on_to_the_same_files() {
    killed(&["open-loop", "drivers", "closed-loop"]);
}

#[test]
fn killed_trainings_of_drivers_and_adversaries_go_on_to_the_same_files() {
    killed(&["train-ego-ppo", "train-seal", "train-goose"]);
}

/// Hidden files of a folder: locks and unfinished files.
fn hidden(folder: &Path) -> Vec<String> {
    hostile::snapshot(folder).into_keys().filter(|name| name.contains(".sage-")).collect()
}

#[test]
fn of_two_runs_at_once_one_works_and_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("prior");
    let run = |seed: &str| {
        Command::new(env!("CARGO_BIN_EXE_sage"))
            .args([
                "pretrain",
                "--procedural",
                "2",
                "--epochs",
                "1",
                "--network",
                r#"{"hidden": 16}"#,
                "--seed",
                seed,
            ])
            .args(["--out", text(&out)])
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let both = ["1", "2"].map(run).map(|child| child.wait_with_output().unwrap());
    let worked: Vec<&Output> = both.iter().filter(|output| output.status.success()).collect();
    let refused: Vec<&Output> = both.iter().filter(|output| !output.status.success()).collect();
    assert_eq!((worked.len(), refused.len()), (1, 1), "{both:?}");
    let said = stderr(refused[0]);
    assert!(said.contains("is in use by another run") || said.contains("is not empty"), "{said}");
    assert!(stderr(worked[0]).contains("best of 1 epoch:"));
    assert!(hidden(&out).is_empty());
}

#[test]
fn files_written_at_once_into_one_folder_are_all_whole() {
    let folder = tempfile::tempdir().unwrap();
    std::thread::scope(|scope| {
        for number in 0..4 {
            let picture = folder.path().join(format!("{number}.svg"));
            scope.spawn(move || {
                for _ in 0..15 {
                    stdout(&sage(&["draw", &example(), "--force", "--out", text(&picture)]));
                }
            });
        }
    });
    assert_eq!(hostile::snapshot(folder.path()).len(), 4);
}

#[cfg(unix)]
#[test]
fn a_run_that_is_told_to_stop_cleans_up() {
    use std::os::unix::process::ExitStatusExt;
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "12", "--out", text(&scenes)]));
    for (number, signal) in [("TERM", 15), ("INT", 2), ("TERM", 15)].into_iter().enumerate() {
        let out = folder.path().join(format!("out{number}"));
        let mut child = Command::new(env!("CARGO_BIN_EXE_sage"))
            .args(["generate", text(&scenes), "--lambda", "0:1:0.1", "--out", text(&out)])
            .args(WEIGHTS)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // The first picture says that the run is in the middle of its work.
        while !out.join("curve-1-1.svg").exists() && child.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        let kill = ["-s", signal.0, &child.id().to_string()].map(str::to_owned);
        assert!(Command::new("kill").args(kill).status().unwrap().success());
        assert_eq!(child.wait().unwrap().signal(), Some(signal.1));
        assert_eq!(hidden(&out), Vec::<String>::new());
    }
}
