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
        sage(&["theory", "--only", "T3", "--instances", "30", "--seed", "4", "--threads", "2", "--json"]);
    assert_eq!(stdout(&again), stdout(&output));
    assert!(failure(&["theory", "--only", "T99"]).contains("unknown claim `T99`; known: T0"));
}

#[test]
fn planted_errors_are_caught() {
    let output = sage(&["theory", "--plant", "--instances", "100"]);
    let last = stdout(&output).lines().last().unwrap().to_owned();
    let words: Vec<&str> = last.split(' ').collect();
    assert!(words[0] == "caught" && words[1] == words[3] && words[1] != "0", "{last}");
    assert!(output.status.success());
}
