//! `sage theory` as a user runs it.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use insta::assert_snapshot;
use program::*;
use serde_json::Value;

/// A table of claims without its numbers, some of which are rounding errors.
fn without_numbers(table: &str) -> String {
    let line = |line: &str| {
        let cells: Vec<&str> = line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect();
        match cells[..] {
            [claim, _, verdict, statement] => format!("{claim}: {verdict}: {statement}\n"),
            _ => format!("{line}\n"),
        }
    };
    table.lines().map(line).collect()
}

#[test]
fn claims_hold_in_lines_and_as_json() {
    let output = sage(&["theory", "--instances", "100"]);
    assert_snapshot!("claims", without_numbers(stdout(&output)));
    let output =
        sage(&["theory", "--only", "T3", "--instances", "30", "--seed", "4", "--threads", "1", "--json"]);
    let rows = rows(&output);
    assert_eq!(rows.len(), 1);
    assert_eq!((&rows[0]["claim"], &rows[0]["verdict"]), (&Value::from("T3"), &Value::from("holds")));
    assert!(rows[0]["report"]["comparisons"].as_u64() > Some(60));
    let again =
        sage(&["theory", "--only", "T3,T3", "--instances", "30", "--seed", "4", "--threads", "2", "--json"]);
    assert_eq!(stdout(&again), stdout(&output));
    assert_snapshot!(failure(&["theory", "--only", "T99"]), @"error: unknown claim `T99`; known: T0, T1, T1b, T2, T3, T4, T5, T5s, T6, T7, T8, T9, T10, T11, T12, T13, T14, T14x, T15, T16, T17, T18, T19");
}

#[test]
fn a_page_states_every_claim_and_opens_from_disk() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("page");
    let theory = ["theory", "--instances", "20", "--out", text(&out)];
    let output = sage(&theory);
    assert!(output.status.success(), "{}", stdout(&output));
    assert_snapshot!(redacted(stderr(&output)), @r"
    23 claims ([time])
    diagnostics of trained experts are left out: they need scenes (--data) and weights (--weights)
    index.html, theory.md and figures are in `[folder]/page`
    ");
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
    // A folder that holds something is not written to unasked.
    assert_snapshot!(redacted(&failure(&theory)), @"error: `[folder]/page` is not empty; give --force to write into it anyway");
}

#[test]
fn trained_experts_are_measured_on_scenes_as_diagnostics() {
    let scene = example();
    let theory = ["theory", "--only", "T0", "--instances", "20", "--data", &scene];
    let output = sage(&theory);
    assert_snapshot!("diagnostics_of_trained_experts", without_numbers(stdout(&output)));
    let rows = rows(&sage(&[&theory[..], &["--json"]].concat()));
    assert_eq!((rows.len(), &rows[1]["diagnostic"]), (7, &Value::from("G1")));
    // The loss of output mixing is the chord less the diversity, exactly.
    let mixing = rows.iter().find(|row| row["diagnostic"] == "G5").unwrap();
    for row in mixing["tables"][0]["rows"].as_array().unwrap() {
        let number =
            |k: usize| -> f64 { row[k].as_str().unwrap().split(' ').next().unwrap().parse().unwrap() };
        assert!((number(1) - number(2) - number(3)).abs() < 0.02, "{row}");
    }
    let without_scenes = sage(&["theory", "--weights", "procedural"]);
    assert_eq!(without_scenes.status.code(), Some(2));
    let said = [
        ("--scenes a", failure(&["theory", "--scenes", "a"])),
        ("--data nowhere", failure(&["theory", "--only", "T0", "--data", "nowhere"])),
        ("--weights procedural", stderr(&without_scenes).to_owned()),
    ];
    assert_snapshot!("wrong_options_of_theory", messages(said));
}

#[test]
fn injected_faults_are_caught() {
    let output = sage(&["theory", "--inject", "--instances", "100"]);
    let last = stdout(&output).lines().last().unwrap().to_owned();
    let words: Vec<&str> = last.split(' ').collect();
    assert!(words[0] == "caught" && words[1] == words[3] && words[1] != "0", "{last}");
    assert!(output.status.success());
}
