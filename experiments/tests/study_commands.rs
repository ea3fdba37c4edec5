//! Studies as a user writes, runs, joins and extends them.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod program;

use std::{
    fs,
    path::{Path, PathBuf},
};

use insta::assert_snapshot;
use program::*;

/// A path in a folder, as text that lives as long as the test.
fn path_in(folder: &Path, name: &str) -> &'static str {
    Box::leak(folder.join(name).display().to_string().into_boxed_str())
}

/// The study that `docs/benchmarks.md` shows.
fn documented(folder: &Path) -> PathBuf {
    let page =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/benchmarks.md")).unwrap();
    let study = page.split("```yaml\n").nth(1).unwrap().split("```").next().unwrap();
    let file = folder.join("calm.yaml");
    fs::write(&file, study).unwrap();
    file
}

/// Lines without the commands and times in them.
fn files(folder: &Path) -> Vec<(String, String)> {
    let mut all: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file() && !path.ends_with("run.json") && !path.ends_with("study.json"))
        .map(|path| {
            let text = fs::read_to_string(&path).unwrap();
            let text = text.split("```text").next().unwrap().to_owned();
            (path.file_name().unwrap().to_str().unwrap().to_owned(), text)
        })
        .filter(|(name, _)| !name.starts_with('.') && !name.ends_with("index.html"))
        .collect();
    all.sort();
    all
}

#[test]
fn shards_are_joined_to_the_report_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| path_in(folder.path(), name);
    let study = documented(folder.path());
    stdout(&sage(&["scenes", "--count", "5", "--out", at("scenes")]));
    let run = |more: &[&str], out: &str| {
        let bench = ["bench", text(&study), at("scenes"), "--out", at(out)];
        stdout(&sage(&[&bench[..], more].concat())).to_owned()
    };
    let whole = run(&[], "whole");
    assert!(Path::new(at("whole/calm.svg")).is_file());
    assert_snapshot!("report_of_the_documented_study", whole);
    run(&["--shard", "2/2"], "shards");
    run(&["--shard", "1/2", "--threads", "1"], "shards");
    assert_eq!(stdout(&sage(&["join", at("shards")])), whole);
    assert_eq!(files(Path::new(at("shards"))), files(Path::new(at("whole"))));
    // The folders of other scenes come one after another.
    for half in ["a", "b"] {
        let names =
            if half == "a" { "curve-1-1,four-way-1-3" } else { "merge-1-2,straight-1-0,t-junction-1-4" };
        run(&["--scenes", names], half);
    }
    let report = ["bench", "report", at("a"), at("b"), "--out", at("both")];
    assert_eq!(stdout(&sage(&report)), whole);
    // Once more from one folder, with other columns.
    let other = at("other.yaml");
    let narrow =
        fs::read_to_string(&study).unwrap().replace("[attack, believable, P_real, lane distance]", "[R_adv]");
    fs::write(other, narrow).unwrap();
    let again = ["bench", "report", at("whole"), "--study", other, "--out", at("again")];
    assert_snapshot!("report_of_other_columns", stdout(&sage(&again)));
    let twice = ["bench", "report", at("a"), at("a"), "--out", at("twice")];
    assert_snapshot!(redacted(&failure(&twice)), @"error: scene `curve-1-1` is in two folders");
}

#[test]
fn without_attacks_only_unchanged_scenes_are_driven() {
    let folder = tempfile::tempdir().unwrap();
    let out = path_in(folder.path(), "unchanged");
    let study = ["bench", "closed-loop", "--procedural", "2", "--ego", "idm", "--unattacked", "--out", out];
    stdout(&sage(&study));
    let estimates = fs::read_to_string(Path::new(out).join("estimates.csv")).unwrap();
    let mut rows = estimates.lines().skip(1).peekable();
    assert!(rows.peek().is_some());
    for row in rows {
        let fields: Vec<&str> = row.split(',').collect();
        assert_eq!((fields[0], fields[2]), ("episode", ""), "{row}");
    }
    let refused = sage(&["bench", "open-loop", "--unattacked", "--out", path_in(folder.path(), "none")]);
    assert_snapshot!(stderr(&refused), @"error: --unattacked: study `open-loop` measures no drive without an attack; `drivers` does");
}

#[test]
fn a_study_is_checked_before_scenes_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let (study, out) = (documented(folder.path()), folder.path().join("out"));
    let text_of = fs::read_to_string(&study).unwrap();
    let error = |from: &str, to: &str| {
        fs::write(&study, text_of.replace(from, to)).unwrap();
        failure(&["bench", text(&study), "no-scenes", "--out", text(&out)])
    };
    let wrong = [
        ("[sage, rule]", "[sage, rul]"),
        ("[attack, P_real]", "[atack]"),
        ("selection: natural", "selection: nice"),
        ("merger: [linear]", "merger: [liner]"),
        ("lambda: [0, 0.5, 1]", "lambda: [0, 2]"),
        ("measure:", "measures:"),
    ];
    let said = wrong.map(|(from, to)| (to, error(from, to)));
    assert_snapshot!("wrong_studies", messages(said));
    assert_snapshot!(failure(&["bench", "nothing", "--out", text(&out)]), @"error: there is no study `nothing`; known: open-loop, drivers, front, pareto, dial, mixtures, prediction, closed-loop, ablation, experts, latest-start, connectivity, search, threshold, transfer, learned-selection, learned-experts, paper-table-replay, paper-table-rl, paper-table-expert, paper-table-idm, paper-ablation, paper-parts, paper-pareto, paper-extrapolation, paper-cases; or the file of a study (YAML)");
    assert!(!out.exists());
    assert_snapshot!("list_of_studies", stdout(&sage(&["bench", "list"])));
}

#[test]
fn failed_scenes_are_named_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("out"));
    stdout(&sage(&["scenes", "--count", "2", "--format", "pickle", "--out", text(&scenes)]));
    fs::write(scenes.join("broken.pkl"), b"\x80\x04N.").unwrap();
    let mut said = Vec::new();
    for study in ["drivers", "latest-start", "prediction"] {
        let run = sage(&["bench", study, text(&scenes), "--force", "--out", text(&out)]);
        assert_eq!(run.status.code(), Some(BAD_SCENES), "{study}: {}", stderr(&run));
        assert!(out.join("rows.csv").is_file(), "{study}");
        said.push((study, stderr(&run).to_owned()));
    }
    assert_snapshot!("studies_with_a_broken_scene", messages(said));
}

#[test]
fn a_part_of_another_crate_is_in_every_command() {
    let program = Path::new(env!("CARGO_BIN_EXE_sage")).with_file_name("examples").join("own_study");
    if !program.exists() {
        eprintln!("left out: `{}` is built by `cargo test --workspace` alone", program.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| path_in(folder.path(), name);
    let scene = example();
    assert_snapshot!("own_parts_in_the_list", added(&program, &["list"]));
    assert_snapshot!("own_study_in_the_list", added(&program, &["bench", "list"]));
    // The study of its own, with every part as an axis or a column.
    let own = run(&program, &["bench", "own", "--wide", "--out", at("own")]);
    assert_snapshot!("report_of_an_own_study", stdout(&own));
    let rows = fs::read_to_string(at("own/rows.csv")).unwrap();
    assert!(
        rows.contains(",top speed,m/s,") && rows.contains(",start gap,") && rows.contains("policy,halfway,")
    );
    // Columns of the shipped studies that list `*`, and axes of all.
    let open_loop =
        ["bench", "open-loop", &scene, "--method", "coast,sage", "--merger", "halfway", "--lambda", "1"];
    let table = run(&program, &[&open_loop[..], &WEIGHTS, &["--out", at("table")]].concat());
    assert_snapshot!("table_with_own_parts", stdout(&table));
    let rows = fs::read_to_string(at("table/rows.csv")).unwrap();
    assert!(rows.contains(",top speed,") && rows.contains(",start gap,"));
    for study in ["front", "latest-start", "dial", "pareto"] {
        let metrics =
            ["--set", r#"metrics={"trajectory": ["*", "attack"]}"#, "--set", "measure=[trajectory]"];
        let run = run(&program, &[&["bench", study, &scene, "--out", at(study)][..], &metrics].concat());
        assert!(study == "latest-start" || run.status.success(), "{study}: {}", stderr(&run));
        if study != "latest-start" {
            assert!(
                fs::read_to_string(at(&format!("{study}/rows.csv"))).unwrap().contains(",top speed,"),
                "{study}"
            );
        }
    }
    let drivers = ["bench", "drivers", &scene, "--ego", "roll", "--method", "coast", "--out", at("drivers")];
    assert_snapshot!("drivers_with_own_parts", stdout(&run(&program, &drivers)));
    assert!(fs::read_to_string(at("drivers/rows.csv")).unwrap().contains("attacked-drive,roll,,,coast,"));
    let episodes = ["bench", "closed-loop", "--procedural", "2", "--ego", "roll", "--method", "coast,sage"];
    let more =
        ["--untrained", "0", "--merger", "halfway", "--weights", "procedural", "--out", at("episodes")];
    stdout(&run(&program, &[&episodes[..], &more].concat()));
    assert!(fs::read_to_string(at("episodes/rows.csv")).unwrap().contains("episode,roll,,,coast,"));
    let generate =
        ["generate", &scene, "--merger", "halfway", "--ego", "roll", "--json", "--out", at("scenes")];
    let row = program::rows(&run(&program, &[&generate[..], &WEIGHTS].concat())).remove(0);
    assert!(row["scores"]["rewards"]["start gap"].is_f64() && row["merger"] == "halfway", "{row}");
    let simulate = ["simulate", &scene, "--ego", "roll", "--method", "coast", "--out", at("driven")];
    stdout(&run(&program, &simulate));
    let train = ["train-ego", "--procedural", "3", "--updates", "300", "--evaluations", "1"];
    let small = [
        "--config",
        r#"{"td3": {"hidden": [16, 16], "batch": 16, "random_steps": 200}}"#,
        "--eval-method",
        "none",
        "--merger",
        "halfway",
    ];
    let attacked = ["--method", "coast", "--out", at("trained")];
    stdout(&run(&program, &[&train[..], &small, &attacked].concat()));
}

#[test]
fn studies_of_the_paper_run_on_any_scenes_and_their_reports_come_from_rows() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| path_in(folder.path(), name);
    stdout(&sage(&["scenes", "--count", "3", "--out", at("scenes")]));
    let short = ["--weights", "procedural", "--lambda", "0,1"];
    let with_methods = [&short[..], &["--method", "sage,sage-published,rule"]].concat();
    for (name, options, has_verdicts) in [
        ("paper-table-replay", &with_methods[..], true),
        ("paper-table-idm", &with_methods, true),
        ("paper-table-expert", &with_methods, true),
        ("paper-table-rl", &with_methods, true),
        ("paper-pareto", &short, false),
        ("paper-extrapolation", &short, false),
        ("paper-cases", &with_methods, false),
    ] {
        let out = at(name);
        let bench = ["bench", name, at("scenes"), "--out", out];
        let whole = stdout(&sage(&[&bench[..], options].concat())).to_owned();
        assert_eq!(whole.contains("Ours less the paper's"), has_verdicts, "{name}");
        assert_eq!(whole.contains("*paper*"), has_verdicts || name == "paper-pareto", "{name}");
        // Pooled distances, too, are made again from rows.csv.
        let again = ["bench", "report", out, "--out", at(&format!("{name}-again"))];
        assert_eq!(stdout(&sage(&again)), whole, "{name}");
    }
    let page = fs::read_to_string(at("paper-cases/index.html")).unwrap();
    assert!(page.contains("All methods in") && page.contains("least-realistic-1"));
    let rows = fs::read_to_string(at("paper-table-idm/rows.csv")).unwrap();
    assert!(rows.contains("the log") && rows.contains("its drive"));
}
