//! `sage predict`, `pretrain` and `bench prediction` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use insta::assert_snapshot;
use program::*;
use serde_json::Value;

#[test]
fn predict_prints_candidates_and_draws_them() {
    let folder = tempfile::tempdir().unwrap();
    let picture: PathBuf = folder.path().join("crossing.svg");
    let scene = example();
    let common = ["predict", &scene, "--weights", "procedural", "--json"];
    let output =
        sage(&[&common[..], &["--k", "6", "--select", "nms", "--out", picture.to_str().unwrap()]].concat());
    let found = rows(&output);
    assert_eq!(found.len(), 6);
    assert_snapshot!(redacted(stderr(&output)), @"note: weights `procedural` (network densetnt)");
    for (k, row) in found.iter().enumerate() {
        assert_eq!(row["rank"], k + 1);
        let points = row["trajectory"].as_array().unwrap();
        assert_eq!(points.len(), 80);
        let gap = |axis: usize| points[79][axis].as_f64().unwrap() - row["goal"][axis].as_f64().unwrap();
        assert!(gap(0).hypot(gap(1)) < 0.01, "a trajectory ends at its goal");
    }
    let log_probs: Vec<f64> = found.iter().map(|row| row["log_prob"].as_f64().unwrap()).collect();
    assert!(log_probs.windows(2).all(|w| w[0] >= w[1]) && log_probs[0] < 0.0);
    let svg = std::fs::read_to_string(&picture).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("6: p = "), "six candidates in the legend");

    assert_eq!(rows(&sage(&common)).len(), 32, "32 by default");
    let draw = |seed: &str| rows(&sage(&[&common[..], &["--select", "gumbel", "--seed", seed]].concat()));
    assert_eq!(draw("1"), draw("1"));
    assert_ne!(draw("1"), draw("2"));
    let threads = |n: &str| rows(&sage(&[&common[..], &["--threads", n]].concat()));
    assert_eq!(threads("1"), threads("2"));
    assert_eq!(
        rows(&sage(&["predict", &scene, "--weights", "lane-graph", "--json", "--agent", "ego"])).len(),
        32
    );
    assert_snapshot!(stdout(&sage(&["predict", &scene, "--weights", "procedural", "--k", "2"])), @r"
    rank     log p       goal x       goal y length m   end m/s
       1    -3.668       -42.25        -0.00     52.5       7.5
       2    -3.689       -44.25        -0.00     54.3       7.9
    ");
}

#[test]
fn predict_says_what_is_wrong() {
    let scene = example();
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("a.svg").display().to_string();
    std::fs::write(&picture, "mine").unwrap();
    let wrong = [
        ["--agent", "nobody"],
        ["--weights", "nowhere"],
        ["--weights", "densetnt"],
        ["--weights", &scene],
        ["--out", &picture],
    ];
    let said = wrong.map(|more| (more.join(" "), failure(&[&["predict", &scene], &more[..]].concat())));
    assert_snapshot!("wrong_options_of_predict", messages(said));
    assert_eq!(std::fs::read(&picture).unwrap(), b"mine");
    assert_eq!(sage(&["predict", &scene, "--k", "0"]).status.code(), Some(2));
    assert_eq!(sage(&["predict", &scene, "--radius", "x"]).status.code(), Some(2));
}

#[test]
fn pretrain_resumes_after_an_interruption_and_its_weights_predict() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("prior").display().to_string();
    let small = r#"{"hidden": 16, "rounds": 1}"#;
    let train = |out: &str, more: &[&str]| {
        sage(
            &[&["pretrain", "--procedural", "2", "--epochs", "2", "--network", small, "--out", out], more]
                .concat(),
        )
    };
    let output = train(&out, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("best of 2 epochs"), "{}", stderr(&output));
    for file in ["prior.safetensors", "last.safetensors", "curve.csv", "curve.svg", "run.json"] {
        assert!(Path::new(&out).join(file).is_file(), "{file}");
    }
    let record: Value =
        serde_json::from_slice(&std::fs::read(Path::new(&out).join("run.json")).unwrap()).unwrap();
    assert!(record["command"].as_str().unwrap().starts_with("sage pretrain --procedural 2"));
    let csv = std::fs::read_to_string(Path::new(&out).join("curve.csv")).unwrap();
    assert_eq!(csv.lines().count(), 3, "{csv}");

    // The same command again changes nothing.
    let weights = std::fs::read(Path::new(&out).join("prior.safetensors")).unwrap();
    let again = train(&out, &[]);
    assert!(again.status.success(), "{}", stderr(&again));
    assert_eq!(weights, std::fs::read(Path::new(&out).join("prior.safetensors")).unwrap());
    let other = train(&out, &["--seed", "5"]);
    assert_eq!(other.status.code(), Some(1));
    let said = [("the same again", stderr(&again)), ("another seed", stderr(&other))];
    assert_snapshot!("a_folder_that_holds_a_prior", messages(said));

    // A killed run resumes and gives the same weights.
    let killed = folder.path().join("killed").display().to_string();
    let mut child = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(["pretrain", "--procedural", "2", "--epochs", "2", "--network", small, "--out", &killed])
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let state = Path::new(&killed).join("last.safetensors");
    while !state.is_file() && child.try_wait().unwrap().is_none() {
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let output = train(&killed, &[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let found = sage_backbones::Parameters::load(&Path::new(&killed).join("prior.safetensors")).unwrap().0;
    let expected = sage_backbones::Parameters::load(&Path::new(&out).join("prior.safetensors")).unwrap().0;
    assert_eq!(found.hash().unwrap(), expected.hash().unwrap());

    let found = rows(&sage(&["predict", &example(), "--weights", &out, "--json", "--k", "3"]));
    assert_eq!(found.len(), 3);
    let error = failure(&[
        "pretrain",
        "--procedural",
        "1",
        "--from",
        &out,
        "--out",
        folder.path().join("x").to_str().unwrap(),
    ]);
    assert_snapshot!("a_network_of_another_size", redacted(&error));
}

#[test]
fn pretrain_refuses_what_it_cannot_learn_from() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    let out = folder.path().join("out").display().to_string();
    let wrong: [&[&str]; 5] = [
        &[text(&empty)],
        &["--procedural", "0"],
        &["--backbone", "none"],
        &["--backbone", "lane-graph", "--procedural", "1"],
        &["--network", r#"{"hiden": 3}"#],
    ];
    let refused = |more: &[&str]| failure(&[&["pretrain"], more, &["--out", &out]].concat());
    assert_snapshot!(
        "wrong_options_of_pretrain",
        messages(wrong.map(|more| (more.join(" "), refused(more))))
    );
}

#[test]
fn bench_prediction_compares_with_constant_velocity() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("errors");
    let bench = ["bench", "prediction", &example(), "--weights", "lane-graph", "--weights", "procedural"];
    let output = sage(&[&bench[..], &["--out", text(&out)]].concat());
    // Four vehicles, of which two are ego and adversary.
    assert_snapshot!("errors_of_predictions", stdout(&output));
    let rows = std::fs::read_to_string(out.join("estimates.csv")).unwrap();
    assert!(rows.contains("prediction,lane-graph,target 6,\"minFDE, all, moving\",m,"), "{rows}");
    assert!(rows.contains("prediction,procedural,target 1,top 32: P_kin,"), "{rows}");
}
