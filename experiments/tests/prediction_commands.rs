//! What `sage predict` prints, and `sage pretrain` that was interrupted; the rest is in `commands/predict.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use program::*;

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
}

#[test]
fn pretrain_resumes_after_an_interruption_with_the_same_weights() {
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
}
