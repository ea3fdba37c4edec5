//! Measures of the shipped candidates, and the help text of every command.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::process::Command;

use clap::CommandFactory;
use program::*;
use serde_json::Value;

#[test]
fn score_gives_every_measure() {
    let (scene, candidates) = (example(), example().replace(".pkl", ".json"));
    let arguments = ["score", &scene, "--candidates", &candidates, "--json"];
    for convention in ["paper", "release"] {
        let run = sage(&[&arguments[..], &["--convention", convention]].concat());
        assert!(run.status.success(), "{}", stderr(&run));
        let rows = rows(&run);
        assert_eq!(rows.len(), 5);
        for key in [
            "name",
            "adversarial_reward",
            "collision",
            "collision_step",
            "kinematic_penalty",
            "behavior_penalty",
            "cross_line",
            "crash_object",
            "feasible",
            "feasible_drivable",
            "violations",
            "wd_speed",
            "wd_acceleration",
            "wd_yaw_rate",
            "time_to_collision",
            "post_encroachment_time",
            "required_deceleration",
            "impact_speed",
            "side_hit",
        ] {
            assert!(rows.iter().all(|row| row.get(key).is_some()), "{convention} {key}");
        }
        let [log, meet, _, kerb, _] = &rows[..] else { panic!() };
        assert_eq!((&log["collision"], &log["collision_step"]), (&false.into(), &Value::Null));
        assert_eq!((&meet["collision"], &meet["collision_step"]), (&true.into(), &29.into()));
        // 10 (1 − 29/80), and 10 (1 − 28/80) where steps count from 0.
        let reward = if convention == "paper" { 6.375 } else { 6.5 };
        assert!((meet["adversarial_reward"].as_f64().unwrap() - reward).abs() < 1e-12);
        assert_eq!((&kerb["cross_line"], &kerb["feasible"]), (&50.0.into(), &false.into()));
        assert_eq!(kerb["violations"][0]["rule"], "road_edge");
    }
    let wide = sage(&[&arguments[..], &["--sizes", "metadrive"]].concat());
    assert!(wide.status.success());
    assert_ne!(stdout(&wide), stdout(&sage(&arguments)));
}

/// Words of every command, `sage` itself included.
fn commands() -> Vec<Vec<String>> {
    let mut open = vec![(Vec::new(), experiments::Cli::command())];
    let mut found = Vec::new();
    while let Some((words, command)) = open.pop() {
        let under = |sub: &clap::Command| ([&words[..], &[sub.get_name().to_owned()]].concat(), sub.clone());
        open.extend(command.get_subcommands().map(under));
        found.push(words);
    }
    found
}

/// A help text in a terminal of some width, as far as COLUMNS says.
fn help(words: &[&str], columns: &str) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_sage")).args(words).env("COLUMNS", columns).output().unwrap();
    assert!(run.status.success(), "{words:?}: {}", stderr(&run));
    stdout(&run).to_owned()
}

#[test]
fn every_command_has_a_help_text_of_at_most_100_columns() {
    let all = commands();
    assert!(all.len() > 25, "{all:?}");
    for command in &all {
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let [long, short] = ["--help", "-h"].map(|option| help(&[&words[..], &[option]].concat(), "300"));
        for line in long.lines().chain(short.lines()) {
            assert!(line.chars().count() <= 100, "{words:?}: {line}");
        }
        assert_eq!(help(&[&["help"], &words[..]].concat(), "100"), long, "{words:?}");
    }
}
