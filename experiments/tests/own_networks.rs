//! Networks from outside, as `docs/extending.md` describes them: each example program is trained, tuned and mixed.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{path::Path, process::Output};

use insta::assert_snapshot;
use program::*;

fn done(program: &Path, arguments: &[&str]) -> Output {
    let output = run(program, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    output
}

#[test]
fn a_network_of_ready_layers_is_trained_tuned_and_mixed() {
    let Some(program) = own("own_backbone") else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let done = |arguments: &[&str]| done(&program, arguments);
    let (prior, experts) = (at("prior"), at("experts"));
    done(&["pretrain", "--backbone", "goal-scorer", "--procedural", "12", "--epochs", "2", "--out", &prior]);
    let found = rows(&done(&["predict", &example(), "--weights", &prior, "--json", "--k", "4"]));
    assert_eq!(found.len(), 4);
    let shipped = sage(&["predict", &example(), "--weights", &prior]);
    assert_snapshot!(redacted(stderr(&shipped)), @"error: `[folder]/prior/prior.safetensors`: cannot be used: unknown backbone `goal-scorer`; known: densetnt, query-transformer, diffusion, lane-graph, densetnt-cat");
    let tune = ["finetune", "--procedural", "12", "--roles", "0", "--prior", &prior, "--out", &experts];
    done(&tune);
    let generate = ["generate", &example(), "--weights", &experts, "--lambda", "0,0.5,1", "--json"];
    let found = rows(&done(&[&generate[..], &["--out", &at("attacks")]].concat()));
    assert!(found.len() == 3 && found[0]["trajectory"] != found[2]["trajectory"], "λ changes nothing");
}

#[test]
fn a_diffusion_network_is_tuned_by_its_own_preferences_mixed_and_searched_with() {
    let Some(program) = own("own_diffusion") else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let done = |arguments: &[&str]| done(&program, arguments);
    let (prior, experts, dev) = (at("prior"), at("experts"), at("dev"));
    done(&["scenes", "--count", "24", "--seed", "7", "--out", &dev]);
    let config = folder.path().join("tune.json");
    let tune =
        r#"{"weight_decay": 0.0, "rate": 1e-3, "experts": {"realistic": {"epochs": 4}, "adversarial": {}}}"#;
    std::fs::write(&config, tune).unwrap();
    let backbone = ["--backbone", "waypoint-diffusion", "--procedural", "48", "--epochs", "8"];
    done(&[&["pretrain"], &backbone[..], &["--dev", &dev, "--out", &prior]].concat());
    let scenes = ["--procedural", "48", "--roles", "0", "--dev", &dev];
    let tune = ["finetune", "--prior", &prior, "--config", text(&config), "--out", &experts];
    let output = done(&[&tune[..], &scenes].concat());
    let said = stderr(&output);
    // What each expert learnt holds on scenes that it was not tuned on.
    for expert in ["realistic", "adversarial"] {
        let start = format!(
            "{expert} on dev, by how much more than the prior it prefers the better of two futures: "
        );
        let line =
            said.lines().find_map(|line| line.strip_prefix(&start)).unwrap_or_else(|| panic!("{said}"));
        let low: f64 = line.split(['[', ',']).nth(1).unwrap().parse().unwrap();
        assert!(low > 0.0, "{line}");
    }
    let mut seen = Vec::new();
    for merger in ["linear", "ties", "probability"] {
        let out = at(merger);
        let generate =
            ["generate", &example(), "--weights", &experts, "--merger", merger, "--lambda", "0:1:0.25"];
        let found = rows(&done(&[&generate[..], &["--json", "--out", &out]].concat()));
        assert_eq!(found.len(), 5);
        seen.push(found.iter().map(|row| row["trajectory"].to_string()).collect::<Vec<_>>());
    }
    // Mixing weights or outputs is the expert at both ends.
    assert!(seen[0][0] == seen[2][0] && seen[0][4] == seen[2][4]);
    assert!(seen[0] != seen[1] && seen[0] != seen[2], "mergers mix alike");
    assert!(seen[0][0] != seen[0][4], "both experts draw the same futures");
    let search = ["search", &example(), "--weights", &experts, "--ego", "idm", "--budget", "8"];
    done(&[&search[..], &["--out", &at("search")]].concat());
}
