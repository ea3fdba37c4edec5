//! Bits of what `sage finetune` makes; the rest, with `calibrate` and `bench dial`, is in `commands/tune.md`.

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
