//! `sage train-adversary` and what it trains; what is refused is in `commands/train-wrong.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{fs, path::Path};

use program::*;

/// Parts that are trained in seconds.
const SMALL: &str =
    r#"{"hidden": 8, "criticality": {"epochs": 3}, "skills": {"epochs": 2}, "prior": {"epochs": 4}}"#;

fn train(out: &Path, more: &[&str]) -> std::process::Output {
    let run = ["train-adversary", "seal", "--procedural", "8", "--options", SMALL, "--out", text(out)];
    sage(&[&run[..], more].concat())
}

/// A folder of weights with the trained parts beside the prior.
fn weights(folder: &Path, trained: &Path) -> std::path::PathBuf {
    let weights = folder.join("weights");
    fs::create_dir(&weights).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    for name in ["prior.safetensors", "realistic.safetensors", "adversarial.safetensors", "dial.json"] {
        fs::copy(shipped.join(name), weights.join(name)).unwrap();
    }
    for name in ["seal.safetensors", "seal-benign.safetensors"] {
        fs::copy(trained.join(name), weights.join(name)).unwrap();
    }
    weights
}

#[test]
fn trained_parts_are_found_beside_the_prior_and_attack_the_same_way_twice() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [one, two] = ["one", "two"].map(path);
    assert!(train(&one, &["--threads", "2"]).status.success());
    assert!(train(&two, &["--threads", "1"]).status.success());
    for name in ["seal.safetensors", "seal-benign.safetensors", "curves.csv", "skills.svg"] {
        assert!(fs::read(one.join(name)).unwrap() == fs::read(two.join(name)).unwrap(), "{name}");
    }
    let named = weights(folder.path(), &one);
    let attack = |out: &str, more: &[&str]| {
        let (scene, out) = (example(), path(out));
        let run = ["generate", &scene, "--weights", text(&named), "--json", "--out", text(&out)];
        rows(&sage(&[&run[..], more].concat())).remove(0)
    };
    let plan = attack("score", &["--method", "seal-score"]);
    let driven = attack("seal", &["--method", "seal"]);
    let again = attack("again", &["--method", "seal", "--threads", "1"]);
    assert_eq!(driven["trajectory"], again["trajectory"]);
    // The path that it drove is a further candidate.
    assert_eq!(
        (driven["chosen"].as_u64(), driven["candidates"].as_array().map(Vec::len)),
        (Some(32), Some(33))
    );
    let note = driven["note"].as_str().unwrap();
    assert!(
        note.starts_with("the adversary reacts from ") && note.ends_with("against the ego's recording"),
        "{note}"
    );
    assert!(plan["note"].is_null(), "{plan}");
    // The plan up to the hand-over, which is never at its first step in this scene, then another path.
    let [a, b] = [&plan, &driven].map(|row| row["trajectory"].as_array().unwrap());
    assert!(a[0] == b[0] && a[79] != b[79]);

    // Against a driver it reacts to that driver; its file replays what it drove.
    let file = path("seal").join("crossing-seal.json");
    let simulate = |out: &str, more: &[&str]| {
        let (scene, out) = (example(), path(out));
        let run = ["simulate", &scene, "--ego", "idm", "--json", "--out", text(&out)];
        rows(&sage(&[&run[..], more].concat())).remove(0)
    };
    let reacting = simulate("reacting", &["--method", "seal", "--weights", text(&named)]);
    let replayed = simulate("replayed", &["--attack", text(&file)]);
    assert_eq!(replayed["attack"]["trajectory"], driven["trajectory"]);
    assert_ne!(reacting["attack"]["trajectory"], driven["trajectory"]);
    let benign =
        attack("benign", &["--method", "seal", "--options", r#"{"file": "seal-benign.safetensors"}"#]);
    assert_ne!(benign["trajectory"], driven["trajectory"]);

    // The score is a measure and an objective.
    let objective = path("learned.json");
    let term = format!(
        r#"{{"terms": [{{"name": "learned-criticality", "weight": 1, "options": {{"weights": "{}"}}}}]}}"#,
        text(&named)
    );
    fs::write(&objective, term).unwrap();
    let learned = attack("learned", &["--method", "cat", "--selection", text(&objective)]);
    assert!(
        learned["scores"]["rewards"]["learned-criticality"]
            .as_f64()
            .is_some_and(|x| (0.0..=1.0).contains(&x)),
        "{learned}"
    );
}

/// A policy that is trained in seconds.
const SHORT: &str = r#"{"decisions": 60, "random": 20, "batch": 8, "roles": 1}"#;

fn train_goose(out: &Path, more: &[&str]) -> std::process::Output {
    let run = ["train-adversary", "goose", "--procedural", "8", "--options", SHORT, "--out", text(out)];
    sage(&[&run[..], more].concat())
}

#[test]
fn a_trained_policy_queries_the_driver_and_plans_the_same_way_twice() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [one, two] = ["one", "two"].map(path);
    assert!(train_goose(&one, &["--threads", "2"]).status.success());
    assert!(train_goose(&two, &["--threads", "1"]).status.success());
    for name in ["goose.safetensors", "curves.csv", "success.svg"] {
        assert!(fs::read(one.join(name)).unwrap() == fs::read(two.join(name)).unwrap(), "{name}");
    }
    let card = fs::read_to_string(one.join("README.md")).unwrap();
    assert!(card.contains("| in the last fifth |"), "{card}");
    let named = policy_weights(folder.path(), &one);
    let attack = |out: &str, more: &[&str]| {
        let (scene, out) = (example(), path(out));
        let run = ["generate", &scene, "--method", "goose", "--weights", text(&named), "--json"];
        rows(&sage(&[&run[..], &["--out", text(&out)], more].concat())).remove(0)
    };
    let recording = attack("recording", &[]);
    let again = attack("again", &["--threads", "1"]);
    assert_eq!(recording["trajectory"], again["trajectory"]);
    assert!(recording["queries"].is_null(), "a recording is not asked");
    let candidates = |row: &serde_json::Value| row["candidates"].as_array().map(Vec::len);
    assert_eq!(recording["chosen"].as_u64().map(|k| k as usize + 1), candidates(&recording));
    // Against a driver each trial is one of its drives.
    let driver = attack("driver", &["--ego", "idm"]);
    assert_eq!(driver["queries"].as_u64().map(|k| k as usize), candidates(&driver));
    let out = path("simulated");
    let run = ["simulate", &example(), "--ego", "idm", "--method", "goose", "--weights", text(&named)];
    let drive = rows(&sage(&[&run[..], &["--json", "--out", text(&out)]].concat())).remove(0);
    assert_eq!(drive["attack"]["queries"], driver["queries"]);
    assert_eq!(drive["attack"]["trajectory"], driver["trajectory"]);
    // As published, the encoder may be random: another plan, but the same one each time.
    let random = r#"{"random_encoder": true}"#;
    let [a, b] = ["a", "b"].map(|out| attack(out, &["--options", random]));
    assert_eq!(a["trajectory"], b["trajectory"]);
    assert_ne!(a["trajectory"], recording["trajectory"]);
}

/// A folder of weights with the policy beside the prior.
fn policy_weights(folder: &Path, trained: &Path) -> std::path::PathBuf {
    let weights = folder.join("policy-weights");
    fs::create_dir(&weights).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    for name in ["prior.safetensors", "realistic.safetensors", "adversarial.safetensors", "dial.json"] {
        fs::copy(shipped.join(name), weights.join(name)).unwrap();
    }
    fs::copy(trained.join("goose.safetensors"), weights.join("goose.safetensors")).unwrap();
    weights
}
