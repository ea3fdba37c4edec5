//! Studies of another crate and of the paper; `commands/bench.md` and `commands/own-study.md` show how studies are written and joined.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

mod program;

use std::{fs, path::Path};

use insta::assert_snapshot;
use program::*;

/// A path in a folder, as text that lives as long as the test.
fn path_in(folder: &Path, name: &str) -> &'static str {
    Box::leak(folder.join(name).display().to_string().into_boxed_str())
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

#[test]
fn a_replayed_ego_has_one_rate_of_attacks_whether_it_is_driven_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let out = path_in(folder.path(), "out");
    let study = ["bench", "open-loop", "--set", "procedural=28", "--selection", "natural", "--lambda", "1"];
    // CAT and Rule select plans that `natural` finds infeasible and the paper's rule does not.
    let attacks = ["--method", "sage,cat,rule", "--ego", "replay", "--out", out];
    stdout(&run(Path::new(env!("CARGO_BIN_EXE_sage")), &[&study[..], &attacks].concat()));
    let rows = fs::read_to_string(folder.path().join("out/rows.csv")).unwrap();
    let of = |subject: &str| -> Vec<String> {
        let start = format!("open-loop,{subject},replay,");
        let rows = rows.lines().filter(|row| row.starts_with(&start) && row.contains(",attack,"));
        // Generator, scene and value.
        rows.map(|row| [5, 12, 16].map(|column| row.split(',').nth(column).unwrap()).join(" ")).collect()
    };
    let (planned, driven) = (of("trajectory"), of("attacked-drive"));
    assert_eq!(planned.len(), 3 * 28);
    assert_eq!(planned, driven);
}
