//! The promises of `SECURITY.md`, and the tests that hold each.

use std::path::Path;

/// A promise, and its tests: scripts of this folder, and functions of tests in files.
const PROMISES: &[(&str, &[&str])] = &[
    (
        "Values only.",
        &[
            "sage-data/tests/hostile/main.rs: programs_are_refused_or_values",
            "sage-data/tests/hostile/main.rs: random_damage_is_refused_or_read",
            "programs.script",
        ],
    ),
    ("We read what Python reads.", &["sage-data/tests/same_as_cpython.rs: ", "programs.script"]),
    ("No other program gets a stranger's bytes.", &["programs.script"]),
    (
        "Only the command line names a program.",
        &["sage-sim/tests/process_planners.rs: ", "experiments/tests/planner_commands.rs: "],
    ),
    (
        "Writes and deletes only under `--out`.",
        &["outside.script", "experiments/tests/links_in_outputs/main.rs: "],
    ),
    ("Inputs are never replaced.", &["inputs.script"]),
    ("Reads only what is named.", &["outside.script"]),
    ("Whole files or none.", &["experiments/tests/interrupted_runs.rs: killed", "runs.script"]),
    ("One run per folder.", &["runs.script", "experiments/tests/data_sets.rs: "]),
    (
        "Weights, policies and checkpoints are checked.",
        &["weights.script", "experiments/tests/scripts/weights.rs: ", "sage-sim/tests/checkpoints.rs: "],
    ),
    ("Words of strangers stay words.", &["names.script"]),
    (
        "One bad scene costs nothing else.",
        &["shards.script", "defects.script", "far.script", "experiments/tests/odd_scenes.rs: "],
    ),
    (
        "Bounded memory and time.",
        &[
            "sage-data/tests/hostile/main.rs: values_that_no_scene_has_are_named",
            "sage-data/tests/hostile/shards.rs: crafted_shards_are_refused_or_read",
            "options.script",
            "experiments/tests/full_disks_and_memory.rs: memory",
        ],
    ),
];

#[test]
fn promises_are_those_of_the_page_and_each_has_its_tests() {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let page = std::fs::read_to_string(project.join("SECURITY.md")).unwrap();
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| **")).collect();
    let names: Vec<&str> = PROMISES.iter().map(|(name, _)| *name).collect();
    let told: Vec<&str> = rows.iter().map(|row| row[4..].split("**").next().unwrap()).collect();
    assert_eq!(names, told);
    for ((name, tests), row) in PROMISES.iter().zip(rows) {
        let cell = row.trim_end_matches([' ', '|']).rsplit(" | ").next().unwrap();
        for test in *tests {
            let (file, function) = test.split_once(": ").unwrap_or((test, ""));
            let short = file.rsplit('/').find(|part| *part != "main.rs").unwrap().trim_end_matches(".rs");
            assert!(cell.contains(short), "{name} does not name `{short}`: {cell}");
            let place = if file.ends_with(".script") {
                format!("experiments/tests/scripts/{file}")
            } else {
                file.to_owned()
            };
            let text = std::fs::read_to_string(project.join(&place))
                .unwrap_or_else(|_| panic!("{name}: no {place}"));
            assert!(text.contains(&format!("fn {function}")) || function.is_empty(), "{name}: no {test}");
        }
    }
}
