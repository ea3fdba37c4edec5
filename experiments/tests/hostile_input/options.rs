//! Options, pipes and what reaches the terminal.

use std::{
    path::Path,
    process::{Command, Output},
};

use insta::assert_snapshot;
use sage_backbones::Parameters;
use serde_json::Value;

use crate::{experts, has_failed, hostile, program::*, quick};

#[cfg(unix)]
#[test]
fn devices_are_refused_and_numbers_have_limits() {
    let folder = tempfile::tempdir().unwrap();
    let [out, attacked] = ["out", "attacked"].map(|name| folder.path().join(name).display().to_string());
    let scene = example();
    let mut refused = Vec::new();
    for command in [
        vec!["pretrain", "--procedural", "1", "--config", "/dev/zero", "--out", &out],
        vec!["finetune", "--procedural", "1", "--config", "/dev/zero", "--out", &out],
        vec!["inspect", "/dev/zero"],
        vec!["generate", "/dev/zero", "--out", &attacked],
        vec!["score", &scene, "--candidates", "/dev/zero"],
        vec!["calibrate", &scene, "--splits", "/dev/zero", "--split", "a", "--out", &out],
    ] {
        let (code, said) = quick(&command);
        assert!(has_failed(code), "{command:?}: {said}");
        refused.push((command.join(" "), said));
    }
    let many = "10000000000000000000";
    for command in [
        vec!["pretrain", "--procedural", many, "--out", &out],
        vec!["finetune", "--procedural", many, "--out", &out],
        vec!["calibrate", "--procedural", many, "--out", &out],
        vec!["scenes", "--count", many, "--out", &out],
        vec!["finetune", "--procedural", "1", "--roles", many, "--out", &out],
        vec!["predict", &scene, "--k", many],
    ] {
        let (code, said) = quick(&command);
        assert_eq!(code, 2, "{command:?}: {said}");
        refused.push((command.join(" "), said));
    }
    // A large file of options is told from a small one before it is read.
    let large = folder.path().join("large.json");
    std::fs::File::create(&large).unwrap().set_len(1 << 40).unwrap();
    let (code, said) = quick(&["pretrain", "--procedural", "1", "--config", text(&large), "--out", &out]);
    assert!(has_failed(code), "{said}");
    refused.push(("a file of options of 1 TiB".to_owned(), said));
    assert_snapshot!("devices_and_large_numbers", messages(refused));
    assert!(!Path::new(&out).exists());
}

/// Runs the binary with the content of a file on standard input.
fn piped(arguments: &[&str], file: &str) -> Output {
    Command::new("sh")
        .args(["-c", "cat \"$0\" | \"$@\"", file, env!("CARGO_BIN_EXE_sage")])
        .args(arguments)
        .output()
        .unwrap()
}

#[cfg(unix)]
#[test]
fn pipes_on_the_command_line_are_read_once_and_those_in_folders_never() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let scene = example();
    let plain = sage(&["inspect", &scene, "--json"]);
    let row = |output: &Output| -> Value {
        let mut row = rows(output).remove(0);
        row["scene"] = Value::Null;
        row
    };
    let table = at("table").display().to_string();
    let table_of_file = sage(&["bench", "open-loop", &scene, "--methods", "log", "--out", &table]);
    for path in ["-", "/dev/stdin"] {
        assert_eq!(row(&piped(&["inspect", path, "--json"], &scene)), row(&plain), "{path}");
        let table = at(&format!("table{}", path.len())).display().to_string();
        let arguments = ["bench", "open-loop", path, "--methods", "log", "--out", &table];
        assert_eq!(stdout(&piped(&arguments, &scene)), stdout(&table_of_file));
    }
    let out = at("attacked").display().to_string();
    stdout(&piped(&["generate", "-", "--weights", "procedural", "--out", &out], &scene));
    assert!(pickle(Path::new(&out), "stdin-lambda1.00").is_file());
    let native = at("native").display().to_string();
    stdout(&piped(&["convert", "-", "--to", "native", "--out", &native], &scene));
    assert!(Path::new(&native).join("stdin.safetensors").is_file());
    let options = at("options.json");
    std::fs::write(&options, r#"{"epochs": 0}"#).unwrap();
    let config = piped(&["pretrain", "--procedural", "1", "--config", "-", "--out", &out], text(&options));
    assert_snapshot!(stderr(&config), @"error: option `epochs` is 0; expected 1 to 1000000");
    // A pipe that nobody writes to, inside a folder and inside its summary.
    std::fs::create_dir(at("scenes")).unwrap();
    std::fs::copy(&scene, at("scenes/a.pkl")).unwrap();
    assert!(Command::new("mkfifo").arg(at("scenes/b.pkl")).status().unwrap().success());
    let (code, said) = quick(&["inspect", text(&at("scenes"))]);
    assert_eq!(code, 0, "{said}");
    hostile::summary(&at("scenes"), &[("a.pkl", ""), ("b.pkl", "")]);
    let (code, said) = quick(&["inspect", text(&at("scenes"))]);
    assert!(has_failed(code), "{said}");
    assert_snapshot!(redacted(&said), @"error: `[folder]/scenes/dataset_summary.pkl`: field `b.pkl` is a folder, pipe or device; expected a regular file");
}

#[test]
fn bad_use_ends_with_2_and_says_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let scene = example();
    let generate =
        |more: &[&str]| quick(&[&["generate", &scene, "--out", &out], &WEIGHTS[..], more].concat());
    let mut refused = Vec::new();
    for (expected, flags) in [
        (2, ["--lambda", "nan"]),
        (2, ["--lambda", "inf"]),
        (2, ["--lambda", "0:1:0"]),
        (2, ["--lambda", "0:1:-0.1"]),
        (2, ["--lambda", "0:1:1e-9"]),
        (2, ["--mu", "nan"]),
        (2, ["--aggression", "0:1:0"]),
        (1, ["--lambda", "-0.5"]),
        (1, ["--lambda", "-0.5,0.5"]),
        (1, ["--mu", "-1"]),
        (1, ["--aggression", "-0.5"]),
        (2, ["--options", "[1"]),
        (1, ["--merger", "none"]),
    ] {
        let (code, said) = generate(&flags);
        assert_eq!(code, expected, "{flags:?}: {said}");
        assert!(!Path::new(&out).exists(), "{flags:?}");
        refused.push((format!("generate {}", flags.join(" ")), said));
    }
    let broken = folder.path().join("broken.pkl");
    std::fs::write(&broken, "").unwrap();
    // What can be known at once is known before the scenes are read.
    let broken = text(&broken);
    let commands: [&[&str]; 4] = [
        &["inspect", broken],
        &["generate", broken, "--weights", "procedural", "--out", &out],
        &["pretrain", broken, "--epochs", "0", "--out", &out],
        &["bench", "experts", broken, "--weights", "nowhere", "--out", &out],
    ];
    for command in commands {
        let (code, said) = quick(command);
        assert!(has_failed(code), "{command:?}: {said}");
        refused.push((command.join(" "), said));
    }
    assert_snapshot!("bad_use", messages(refused));
}

#[cfg(unix)]
#[test]
fn a_closed_output_keeps_no_file_from_being_written() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "3", "--out", text(&scenes)]));
    for (number, shell) in ["exec \"$@\" >&-", "\"$@\" | true; exit ${PIPESTATUS[0]}"].into_iter().enumerate()
    {
        let out = folder.path().join(format!("out{number}"));
        let run = |arguments: &[&str]| {
            let output = Command::new("bash")
                .args(["-c", shell, "bash", env!("CARGO_BIN_EXE_sage")])
                .args(arguments)
                .args(WEIGHTS)
                .output()
                .unwrap();
            assert_eq!(output.status.code(), Some(0), "{shell}: {}", stderr(&output));
        };
        run(&["generate", text(&scenes), "--out", text(&out)]);
        // Pickle, row, picture and page of each, and two tables, the record, the manifest and the page of all.
        assert_eq!(hostile::snapshot(&out).len(), 3 * 4 + 5);
        let table = folder.path().join(format!("table{number}"));
        run(&["bench", "open-loop", text(&scenes), "--methods", "log,sage", "--out", text(&table)]);
        assert!(table.join("index.html").is_file() && table.join("table.md").is_file());
    }
}

#[cfg(unix)]
#[test]
fn names_and_licences_do_not_control_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    std::fs::create_dir(&scenes).unwrap();
    std::fs::copy(example(), scenes.join("a\u{1b}[2Jb\u{9b}c\u{202e}d\ne.pkl")).unwrap();
    std::fs::write(scenes.join("z\u{1b}]0;title\u{7}.pkl"), "no scene").unwrap();
    let experts = experts(folder.path());
    let path = experts.join("prior.safetensors");
    let (parameters, mut header) = Parameters::load(&path).unwrap();
    header.license = "Free\u{1b}[31m\u{9b}31m. And so on".to_owned();
    parameters.save(&header, &path).unwrap();
    let out = folder.path().join("out").display().to_string();
    for command in [
        vec!["inspect", text(&scenes)],
        vec!["inspect", text(&scenes), "--json"],
        vec!["generate", text(&scenes), "--weights", text(&experts), "--out", &out],
        vec!["generate", text(&scenes), "--weights", text(&experts), "--force", "--json", "--out", &out],
        vec!["convert", text(&scenes), "--to", "native", "--force", "--out", &out],
    ] {
        let output = sage(&command);
        for said in [&output.stdout, &output.stderr] {
            let said = std::str::from_utf8(said).unwrap();
            let bad = said.chars().find(|c| (c.is_control() && *c != '\n') || *c == '\u{202e}');
            assert_eq!(bad, None, "{command:?}: {said:?}");
        }
    }
}
