//! `sage finetune`, `calibrate` and `bench dial` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{path::Path, process::Command};

use insta::assert_snapshot;
use program::*;

#[test]
fn experts_are_tuned_from_either_network_merged_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("quick.json");
    std::fs::write(&config, r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    for backbone in ["densetnt", "query-transformer"] {
        let [prior, experts, out] =
            ["prior", "experts", "out"].map(|part| folder.path().join(format!("{backbone}-{part}")));
        let small = r#"{"hidden": 16, "rounds": 1}"#;
        let pretrain = |out: &Path, seed: &str| {
            let network = ["pretrain", "--backbone", backbone, "--network", small];
            let run = ["--procedural", "2", "--epochs", "1", "--seed", seed, "--out", text(out)];
            stdout(&sage(&[&network[..], &run].concat()));
        };
        pretrain(&prior, "0");
        let tune = |out: &Path, threads: &str| {
            let arguments = [
                "finetune",
                "--procedural",
                "4",
                "--prior",
                text(&prior),
                "--config",
                text(&config),
                "--threads",
                threads,
                "--out",
                text(out),
            ];
            let output = sage(&arguments);
            assert!(output.status.success(), "{}", stderr(&output));
            assert!(stderr(&output).contains("adversarial epoch 1: loss"), "{}", stderr(&output));
        };
        tune(&experts, "2");
        let again = folder.path().join(format!("{backbone}-again"));
        tune(&again, "1");
        let weights = |dir: &Path| {
            sage_backbones::Parameters::load(&dir.join("adversarial.safetensors")).unwrap().0.hash().unwrap()
        };
        assert_eq!(weights(&experts), weights(&again), "bits depend on the number of threads");
        let scene = example();
        let arguments =
            ["generate", &scene, "--weights", text(&experts), "--lambda", "0.5", "--out", text(&out)];
        assert!(stdout(&sage(&arguments)).starts_with("crossing lambda0.50: "));
        // Experts of one prior are refused with another prior.
        let other = folder.path().join(format!("{backbone}-other"));
        std::fs::create_dir(&other).unwrap();
        for file in ["realistic.safetensors", "adversarial.safetensors"] {
            std::fs::copy(experts.join(file), other.join(file)).unwrap();
        }
        let stranger = folder.path().join(format!("{backbone}-stranger"));
        pretrain(&stranger, "3");
        std::fs::copy(stranger.join("prior.safetensors"), other.join("prior.safetensors")).unwrap();
        let error = failure(&[
            "generate",
            &scene,
            "--weights",
            text(&other),
            "--out",
            text(&folder.path().join("x")),
        ]);
        insta::allow_duplicates! { assert_snapshot!(redacted(&error).replace(backbone, "[backbone]"), @"error: weights `[folder]/[backbone]-other`: `[folder]/[backbone]-other/realistic.safetensors`: the realistic expert was tuned from another prior ([hash]) than the given prior ([hash]): recreate the experts with `sage finetune`") };
    }
}

#[test]
fn aggression_uses_a_dial_that_calibrate_fits_and_stores_with_the_experts() {
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    let out = folder.path().join("out");
    let arguments = ["generate", &scene, "--aggression", "0:1:0.5", "--json", "--out", text(&out)];
    let output = sage(&[&arguments[..], &WEIGHTS].concat());
    let rows = rows(&output);
    assert_eq!(rows.len(), 3);
    for (row, a) in rows.iter().zip([0.0, 0.5, 1.0]) {
        assert_eq!((row["aggression"].as_f64(), row["lambda"].as_f64()), (Some(a), Some(a)));
    }
    assert_eq!((rows[0]["mu"].as_f64(), rows[2]["mu"].as_f64()), (Some(0.0), Some(1.0)));
    assert!(pickle(&out, "crossing-aggression0.50").is_file());
    let both = ["generate", &scene, "--aggression", "1", "--lambda", "1", "--out", "x"];
    assert_eq!(sage(&both).status.code(), Some(2));

    let experts = folder.path().join("experts");
    std::fs::create_dir(&experts).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    for file in ["prior", "realistic", "adversarial"].map(|name| format!("{name}.safetensors")) {
        std::fs::copy(shipped.join(&file), experts.join(&file)).unwrap();
    }
    let other = folder.path().join("other");
    let generate =
        ["generate", &scene, "--weights", text(&experts), "--aggression", "0.3", "--out", text(&other)];
    let without_dial = failure(&generate);
    let dial = experts.join("dial.json");
    let calibrate = [
        "calibrate",
        "--procedural",
        "8",
        "--weights",
        text(&experts),
        "--selection",
        "natural",
        "--out",
        text(&dial),
    ];
    let output = sage(&calibrate);
    assert!(output.status.success(), "{}", stderr(&output));
    stdout(&sage(&generate));
    let said = [("generate without a dial", without_dial), ("calibrate again", failure(&calibrate))];
    assert_snapshot!("dials_of_experts", messages(said));

    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "4", "--out", text(&scenes)]));
    let report = folder.path().join("dial");
    let output = sage(&["bench", "dial", text(&scenes), "--weights", text(&experts), "--out", text(&report)]);
    assert_snapshot!("dial_of_experts_measured", stdout(&output));
    for file in ["table.md", "estimates.csv", "dial.svg", "run.json"] {
        assert!(report.join(file).is_file(), "{file}");
    }
}

#[test]
fn an_interrupted_fine_tuning_resumes_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("quick.json");
    std::fs::write(&config, r#"{"epochs": 3, "candidates": 16}"#).unwrap();
    let tune = |out: &Path| {
        let arguments =
            ["finetune", "--procedural", "4", "--roles", "1", "--config", text(&config), "--out", text(out)];
        Command::new(env!("CARGO_BIN_EXE_sage")).args(arguments).env_remove("SAGE_WEIGHTS").spawn().unwrap()
    };
    let [whole, interrupted] = ["whole", "interrupted"].map(|name| folder.path().join(name));
    assert!(tune(&whole).wait().unwrap().success());
    let mut child = tune(&interrupted);
    // Killed as soon as the first expert has a state to resume from.
    while !interrupted.join("realistic.state").exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let _ = child.kill();
    child.wait().unwrap();
    assert!(tune(&interrupted).wait().unwrap().success());
    for expert in ["realistic", "adversarial", "lawful"] {
        let [a, b] = [&whole, &interrupted].map(|dir| {
            let file = dir.join(format!("{expert}.safetensors"));
            sage_backbones::Parameters::load(&file).unwrap().0.hash().unwrap()
        });
        assert_eq!(a, b, "{expert}");
    }
    let table = |dir: &Path| std::fs::read_to_string(dir.join("finetune.csv")).unwrap().lines().count();
    assert_eq!((table(&whole), table(&interrupted)), (10, 10));
}

#[test]
fn bad_options_fail_before_work_starts() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("config.json");
    let out = folder.path().join("out");
    let tune = ["finetune", "--procedural", "2", "--config", text(&config), "--out", text(&out)];
    let mut said = Vec::new();
    for wrong in [r#"{"epoch": 1}"#, r#"{"seed": 1}"#, r#"{"epochs": 0}"#] {
        std::fs::write(&config, wrong).unwrap();
        said.push((format!("finetune {wrong}"), failure(&tune)));
        assert!(!out.exists(), "nothing was written");
    }
    let far = folder.path().join("no/dial.json");
    let dial = folder.path().join("d.json");
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural/adversarial.safetensors");
    let (scene, out) = (example(), text(&out));
    let wrong: [&[&str]; 4] = [
        &["calibrate", "--procedural", "2", "--out", text(&far)],
        &["calibrate", "--procedural", "0", "--out", text(&dial)],
        &["bench", "open-loop", &scene, "--method", r#"log,rule{"row": true}"#, "--out", out],
        &["generate", &scene, "--weights", text(&shipped), "--out", out],
    ];
    said.extend(wrong.map(|command| (command.join(" "), failure(command))));
    assert_snapshot!("wrong_options_of_tuning", messages(said));
}
