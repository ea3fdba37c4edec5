//! Numbers and the page of `sage theory`; the claims are in `commands/theory.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use program::*;
use serde_json::Value;

#[test]
fn a_claim_is_the_same_on_any_number_of_threads() {
    let output =
        sage(&["theory", "--only", "T3", "--instances", "30", "--seed", "4", "--threads", "1", "--json"]);
    let rows = rows(&output);
    assert_eq!(rows.len(), 1);
    assert_eq!((&rows[0]["claim"], &rows[0]["verdict"]), (&Value::from("T3"), &Value::from("holds")));
    assert!(rows[0]["report"]["comparisons"].as_u64() > Some(60));
    let again =
        sage(&["theory", "--only", "T3,T3", "--instances", "30", "--seed", "4", "--threads", "2", "--json"]);
    assert_eq!(stdout(&again), stdout(&output));
}

#[test]
fn a_page_states_every_claim_and_opens_from_disk() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("page");
    let theory = ["theory", "--instances", "20", "--out", text(&out)];
    let output = sage(&theory);
    assert!(output.status.success(), "{}", stdout(&output));
    let [html, markdown] =
        ["index.html", "theory.md"].map(|file| std::fs::read_to_string(out.join(file)).unwrap());
    let is_claim = |line: &&str| line.starts_with('T') && line[1..2].parse::<u8>().is_ok();
    for line in stdout(&output).lines().filter(is_claim) {
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
}

#[test]
fn trained_experts_are_measured_on_scenes_as_diagnostics() {
    let scene = example();
    let theory = ["theory", "--only", "T0", "--instances", "20", "--data", &scene];
    let rows = rows(&sage(&[&theory[..], &["--json"]].concat()));
    assert_eq!((rows.len(), &rows[1]["diagnostic"]), (7, &Value::from("G1")));
    // The loss of output mixing is the chord less the diversity, exactly.
    let mixing = rows.iter().find(|row| row["diagnostic"] == "G5").unwrap();
    for row in mixing["tables"][0]["rows"].as_array().unwrap() {
        let number =
            |k: usize| -> f64 { row[k].as_str().unwrap().split(' ').next().unwrap().parse().unwrap() };
        assert!((number(1) - number(2) - number(3)).abs() < 0.02, "{row}");
    }
}
