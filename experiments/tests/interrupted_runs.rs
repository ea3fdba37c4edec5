//! Runs that are killed, run twice at once, or run out of disk: nothing is lost, nothing half-made stays.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hostile;
mod interruption;
mod program;

use std::{
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use insta::assert_snapshot;
use interruption::Case;
use program::*;
use sage_core::files::OutputLock;
use sage_data::Recording;

/// Times that each command is killed here; `kill_anywhere` does it as often as wanted.
const KILLS: u64 = 3;

fn killed(name: &str) {
    let folder = tempfile::tempdir().unwrap();
    let case = Case::new(Path::new(env!("CARGO_BIN_EXE_sage")), name, folder.path());
    let (expected, time) = case.whole();
    for number in 0..KILLS {
        case.kill_and_run_again(number, time, &expected)
            .unwrap_or_else(|problem| panic!("{name}: {problem}"));
    }
}

#[test]
fn a_killed_pretrain_goes_on_to_the_same_files() {
    killed("pretrain");
}

#[test]
fn a_killed_finetune_goes_on_to_the_same_files() {
    killed("finetune");
}

#[test]
fn a_killed_generate_resumes_to_the_same_files() {
    killed("generate");
}

#[test]
fn a_killed_simulate_resumes_to_the_same_files() {
    killed("simulate");
}

#[test]
fn a_killed_search_resumes_to_the_same_files() {
    killed("search");
}

#[test]
fn a_killed_convert_resumes_to_the_same_files() {
    for format in ["convert", "convert-shards", "convert-scenarios"] {
        killed(format);
    }
}

#[test]
fn a_killed_open_loop_goes_on_to_the_same_files() {
    killed("open-loop");
}

#[test]
fn killed_drivers_go_on_to_the_same_files() {
    killed("drivers");
}

#[test]
fn a_killed_closed_loop_goes_on_to_the_same_files() {
    killed("closed-loop");
}

#[test]
fn killed_trainings_of_drivers_go_on_to_the_same_files() {
    killed("train-ego-ppo");
}

#[test]
fn killed_trainings_of_adversaries_go_on_to_the_same_files() {
    killed("train-seal");
    killed("train-goose");
}

#[test]
fn a_killed_calibrate_starts_again_to_the_same_files() {
    killed("calibrate");
}

/// Hidden files of a folder: locks and unfinished files.
fn hidden(folder: &Path) -> Vec<String> {
    hostile::snapshot(folder).into_keys().filter(|name| name.contains(".sage-")).collect()
}

#[test]
fn a_folder_or_file_in_use_is_refused_and_told_whose_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = example();
    let (out, dial, picture) = (at("out"), at("dial.json"), at("a.svg"));
    std::fs::create_dir(&out).unwrap();
    let first = OutputLock::folder(&out, "sage of somebody else").unwrap();
    let files = [&dial, &picture].map(|path| OutputLock::file(path, "sage of somebody else").unwrap());
    let out = text(&out);
    let mut said = Vec::new();
    for command in [
        vec!["pretrain", "--procedural", "1", "--out", out],
        vec!["finetune", "--procedural", "1", "--out", out],
        vec!["generate", &scene, "--weights", "procedural", "--out", out],
        vec!["search", &scene, "--ego", "idm", "--weights", "procedural", "--out", out],
        vec!["convert", &scene, "--to", "native", "--out", out],
        vec!["scenes", "--count", "1", "--out", out],
        vec!["demo", "--out", out],
        vec!["bench", "open-loop", &scene, "--methods", "log", "--out", out],
        vec!["bench", "dial", &scene, "--out", out],
        vec!["calibrate", &scene, "--out", text(&dial)],
        vec!["draw", &scene, "--out", text(&picture)],
        vec!["predict", &scene, "--weights", "procedural", "--out", text(&picture)],
    ] {
        for more in [&[][..], &["--force"]] {
            let command = [&command[..], more].concat();
            let error = failure(&command);
            assert!(error.contains(&format!("process {}", std::process::id())), "{command:?}: {error}");
            said.push((command.join(" "), error));
        }
    }
    assert_snapshot!("outputs_in_use", messages(said));
    drop((first, files));
    assert_eq!(hostile::snapshot(folder.path()).len(), 0, "nobody wrote anything");
    stdout(&sage(&["draw", &scene, "--out", text(&picture)]));
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
fn files_that_are_not_its_own_keep_pretrain_out() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["prior.safetensors", "run.json", "curve.csv", "curve.svg", "last.safetensors"] {
        let out = folder.path().join(name.replace('.', "-"));
        std::fs::create_dir(&out).unwrap();
        std::fs::write(out.join(name), "mine").unwrap();
        let error = failure(&["pretrain", "--procedural", "1", "--epochs", "1", "--out", text(&out)]);
        insta::allow_duplicates! { assert_snapshot!(redacted(&error).replace(&name.replace('.', "-"), "[name]"), @r"
        read 1 scene ([time])
        read 60 scenes ([time])
        error: `[folder]/[name]` is not empty and holds no run of the same options, data and program; give --force to write into it anyway
        ") };
        assert_eq!(hostile::snapshot(&out), [(name.to_owned(), b"mine".to_vec())].into());
    }
}

#[test]
fn a_damaged_state_is_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("quick.json");
    std::fs::write(&config, r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    let small = r#"{"hidden": 16, "rounds": 1}"#;
    let mut said = Vec::new();
    for (name, state, more) in [
        ("pretrain", "last.safetensors", vec!["--epochs", "1", "--network", small]),
        ("finetune", "realistic.state", vec!["--roles", "0", "--config", text(&config)]),
    ] {
        let out = folder.path().join(name);
        let arguments = [&[name, "--procedural", "2", "--out", text(&out)][..], &more].concat();
        assert!(sage(&arguments).status.success());
        // As if it had been broken off, and then its state was spoiled.
        let record = out.join("run.json");
        let mut run: serde_json::Value = serde_json::from_slice(&std::fs::read(&record).unwrap()).unwrap();
        run["seconds"] = serde_json::Value::Null;
        std::fs::write(&record, run.to_string()).unwrap();
        let state = out.join(state);
        let empty = [8, 0, 0, 0, 0, 0, 0, 0, b'{', b'}', b' ', b' ', b' ', b' ', b' ', b' '];
        for (damage, bytes) in [("cut off", &b"cut off"[..]), ("empty", &empty)] {
            std::fs::write(&state, bytes).unwrap();
            said.push((format!("{name}, {damage}"), failure(&arguments)));
        }
        std::fs::remove_file(&state).unwrap();
        assert!(sage(&arguments).status.success(), "{name} begins anew");
    }
    assert_snapshot!("damaged_states", messages(said));
}

#[test]
fn a_finished_run_is_told_from_another_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let config = at("quick.json");
    std::fs::write(&config, r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    let small = r#"{"hidden": 16, "rounds": 1}"#;
    let mut said = Vec::new();
    for (command, other) in [
        (
            vec!["pretrain", "--procedural", "2", "--epochs", "1", "--network", small, "--out", &at("prior")],
            "3",
        ),
        (
            vec![
                "finetune",
                "--procedural",
                "2",
                "--roles",
                "0",
                "--config",
                &config,
                "--out",
                &at("experts"),
            ],
            "3",
        ),
        (vec!["bench", "open-loop", &example(), "--methods", "log", "--out", &at("table")], "3"),
    ] {
        let first = sage(&command);
        stdout(&first);
        let out = PathBuf::from(command.last().unwrap());
        let before = hostile::snapshot(&out);
        let again = sage(&command);
        assert_eq!(stdout(&again), stdout(&first), "what is printed is printed again");
        said.push((format!("{} again", command[0]), stderr(&again).to_owned()));
        assert_eq!(hostile::snapshot(&out), before);
        let error = failure(&[&command[..], &["--seed", other]].concat());
        said.push((format!("{} of another seed", command[0]), error));
        assert_eq!(hostile::snapshot(&out), before);
    }
    assert_snapshot!("finished_runs", messages(said));
}

#[test]
fn a_run_without_its_results_is_not_done() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("table");
    let table = ["bench", "open-loop", &example(), "--methods", "log", "--out", text(&out)];
    let first = stdout(&sage(&table)).to_owned();
    std::fs::remove_file(out.join("table.md")).unwrap();
    // Results of a part of the scenes, of others or of other generators are no results.
    for kept in ["[]", r#"[{"scene": "other", "rows": [], "expectations": null}]"#] {
        std::fs::create_dir_all(out.join(".sage-rows")).unwrap();
        std::fs::write(out.join(".sage-rows/000000.json"), kept).unwrap();
        let again = sage(&table);
        assert!(stdout(&again) == first && stderr(&again).contains("it resumes"), "{}", stderr(&again));
        std::fs::remove_file(out.join("table.md")).unwrap();
    }
    // A run that is begun anew is not done before it is, wherever it is broken off.
    let force = sage(&[&table[..], &["--force"]].concat());
    assert_eq!(stdout(&force), first);
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

#[test]
fn how_a_command_was_run_changes_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    let files = |name: &str, how: &[&str]| {
        let out = folder.path().join(name);
        let generate = ["generate", &scene, "--aggression", "0,1", "--out", text(&out)];
        stdout(&sage(&[&generate[..], &WEIGHTS, how].concat()));
        let mut files = hostile::snapshot(&out);
        files.retain(|name, _| name != "run.json");
        assert_eq!(files.len(), 2 * 3 + 4);
        files
    };
    let plain = files("plain", &["--threads", "1"]);
    assert!(plain == files("threads", &["--threads=2", "--json"]));
    assert!(plain == files("plain", &["--force", "--threads", "2"]));
    let experts = |name: &str, how: &[&str]| {
        let config = folder.path().join("quick.json");
        std::fs::write(&config, r#"{"epochs": 1, "candidates": 16}"#).unwrap();
        let out = folder.path().join(name);
        let tune =
            ["finetune", "--procedural", "2", "--roles", "0", "--config", text(&config), "--out", text(&out)];
        stdout(&sage(&[&tune[..], how].concat()));
        let mut files = hostile::snapshot(&out);
        files.retain(|name, _| name.ends_with(".safetensors"));
        files
    };
    assert!(experts("one", &["--threads", "1"]) == experts("two", &["--threads", "2", "--force"]));
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

#[cfg(unix)]
#[test]
fn links_in_the_output_are_not_followed() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("out")).unwrap();
    std::fs::write(at("victim"), "mine").unwrap();
    let name = "crossing-lambda1.00";
    let files = ["safetensors", "json"].map(|ending| format!("{name}.{ending}"));
    let tables = [
        "crossing.svg",
        "crossing.html",
        "index.html",
        "dataset_summary.pkl",
        "dataset_mapping.pkl",
        "run.json",
    ];
    let tables = tables.map(str::to_owned);
    for name in files.iter().chain(&tables) {
        symlink(at("victim"), at("out").join(format!("{name}.part"))).unwrap();
        symlink(at("victim"), at("out").join(name)).unwrap();
    }
    let generate =
        ["generate", &example(), "--format", "both", "--force", "--out", text(&at("out"))].map(str::to_owned);
    let generate: Vec<&str> = generate.iter().map(String::as_str).collect();
    stdout(&sage(&[&generate[..], &WEIGHTS].concat()));
    assert_eq!(std::fs::read(at("victim")).unwrap(), b"mine");
    assert!(files.iter().chain(&tables).all(|name| !at("out").join(name).is_symlink()));
    assert!(Recording::read(&at("out").join(&files[0])).is_ok());
    // A lock that is a link is no lock.
    symlink(at("victim"), at("out/.sage-lock")).unwrap();
    let error = failure(&[&generate[..], &WEIGHTS].concat());
    assert_snapshot!(redacted(&error), @r"
    note: weights `procedural` (network densetnt)
    error: cannot write into `[folder]/out`: `[folder]/out/.sage-lock` is no regular file; remove it
    ");
    assert_eq!(std::fs::read(at("victim")).unwrap(), b"mine");
    // Nothing is written to the system's folder of temporary files.
    let output = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(["generate", &example(), "--out", text(&at("other"))])
        .args(WEIGHTS)
        .env("TMPDIR", at("nowhere"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}
