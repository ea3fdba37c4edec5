//! `sage theory` as a user runs it.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use program::*;
use serde_json::Value;

#[test]
fn claims_hold_in_lines_and_as_json() {
    let output = sage(&["theory", "--instances", "100"]);
    let lines = stdout(&output);
    for claim in ["T0 ", "T1 ", "T2 ", "T3 "] {
        assert!(
            lines.lines().any(|line| line.starts_with(claim) && line.contains("holds")),
            "{claim}: {lines}"
        );
    }
    let output =
        sage(&["theory", "--only", "T3", "--instances", "30", "--seed", "4", "--threads", "1", "--json"]);
    let rows = rows(&output);
    assert_eq!(rows.len(), 1);
    assert_eq!((&rows[0]["claim"], &rows[0]["verdict"]), (&Value::from("T3"), &Value::from("holds")));
    assert!(rows[0]["report"]["comparisons"].as_u64() > Some(60));
    let again =
        sage(&["theory", "--only", "T3,T3", "--instances", "30", "--seed", "4", "--threads", "2", "--json"]);
    assert_eq!(stdout(&again), stdout(&output));
    assert!(failure(&["theory", "--only", "T99"]).contains("unknown claim `T99`; known: T0"));
}

#[test]
fn a_page_states_every_claim_and_opens_from_disk() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("page");
    let theory = ["theory", "--instances", "20", "--report", text(&out)];
    let output = sage(&theory);
    assert!(output.status.success(), "{}", stdout(&output));
    assert!(stderr(&output).contains("diagnostics of trained experts are left out"), "{}", stderr(&output));
    let [html, markdown] =
        ["index.html", "theory.md"].map(|file| std::fs::read_to_string(out.join(file)).unwrap());
    for line in stdout(&output).lines().skip(1) {
        let id = line.split(' ').next().unwrap();
        assert!(
            html.contains(&format!("<h2 id=\"{id}\">")) && markdown.contains(&format!("## {id}: ")),
            "{id}"
        );
    }
    assert!(html.contains("<svg") && !html.contains("src=") && !html.contains("http://127"));
    for figure in markdown.lines().filter(|line| line.starts_with("![")) {
        let file = figure.split(['(', ')']).rev().nth(1).unwrap();
        assert!(out.join(file).exists(), "{figure}");
    }
    assert!(!markdown.contains("MISSED") && markdown.contains("| T14x | without k E‖Δf‖² | caught |"));
    // A folder that holds something is not written to unasked.
    assert!(failure(&theory).contains("--force"), "{}", failure(&theory));
    assert!(sage(&[&theory[..], &["--force"]].concat()).status.success());
}

#[test]
fn trained_experts_are_measured_on_scenes_as_diagnostics() {
    let scene = example();
    let theory = ["theory", "--only", "T0", "--instances", "20", "--data", &scene];
    let output = sage(&theory);
    let lines = stdout(&output);
    for id in ["G1", "G2", "G3", "G4", "G5", "G6"] {
        assert!(lines.lines().any(|line| line.starts_with(id)), "{id}: {lines}");
    }
    assert!(lines.contains("too few scenes for a finding (1)"), "{lines}");
    assert!(lines.contains("Diagnostics, no proofs. Experts `procedural` on 1 scene."), "{lines}");
    let rows = rows(&sage(&[&theory[..], &["--json"]].concat()));
    assert_eq!((rows.len(), &rows[1]["diagnostic"]), (7, &Value::from("G1")));
    // The loss of output mixing is the chord less the diversity, exactly.
    let mixing = rows.iter().find(|row| row["diagnostic"] == "G5").unwrap();
    for row in mixing["tables"][0]["rows"].as_array().unwrap() {
        let number =
            |k: usize| -> f64 { row[k].as_str().unwrap().split(' ').next().unwrap().parse().unwrap() };
        assert!((number(1) - number(2) - number(3)).abs() < 0.02, "{row}");
    }
    assert!(failure(&["theory", "--scenes", "a"]).contains("give these with `--data`"));
    assert!(failure(&["theory", "--only", "T0", "--data", "nowhere"]).contains("nowhere"));
    let without_scenes = sage(&["theory", "--weights", "procedural"]);
    assert_eq!(without_scenes.status.code(), Some(2));
    assert!(stderr(&without_scenes).contains("--data"));
}

#[test]
fn injected_faults_are_caught() {
    let output = sage(&["theory", "--inject", "--instances", "100"]);
    let last = stdout(&output).lines().last().unwrap().to_owned();
    let words: Vec<&str> = last.split(' ').collect();
    assert!(words[0] == "caught" && words[1] == words[3] && words[1] != "0", "{last}");
    assert!(output.status.success());
}
