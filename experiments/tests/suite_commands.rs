//! `sage suite` and `sage test`: failures as a test suite.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod found_failures;
mod program;

use std::{fs, path::Path, process::Output};

use found_failures::*;
use insta::assert_snapshot;
use program::*;
use serde_json::Value;

#[test]
fn the_driver_of_the_search_fails_every_test_and_a_better_one_passes_some() {
    let desk = Desk::new();
    let idm = desk.test("idm", &["--json"]);
    assert_eq!(idm.status.code(), Some(1), "{}", stderr(&idm));
    let rows = results(&idm);
    let tests = desk.suite()["tests"].as_array().unwrap().clone();
    assert!(rows.len() > 3 && rows.len() == tests.len());
    for (row, test) in rows.iter().zip(&tests) {
        assert_eq!((&row["test"], &row["result"]), (&test["name"], &Value::from("failed")));
        // Driven again with the bits of the search.
        assert_eq!(row["contact"], test["found"]["contact"]);
        assert_eq!((&row["at_fault"], &row["shortfall"]), (&true.into(), &"at-fault".into()));
    }
    let expert = desk.test("expert", &["--json"]);
    let passed = results(&expert).iter().filter(|row| row["result"] == "passed").count();
    assert!(passed > 0, "the expert passes some tests");
    // Threads change nothing.
    let again = desk.test("expert", &["--json", "--threads", "1"]);
    let without_times = |output: &Output| {
        let mut rows = results(output);
        rows.iter_mut().for_each(|row| drop(row.as_object_mut().unwrap().remove("seconds")));
        rows
    };
    assert_eq!(without_times(&expert), without_times(&again));
}

#[test]
fn a_driver_that_stands_creeps_or_leaves_the_road_passes_no_test_that_asks_for_progress() {
    let desk = Desk::new();
    let mut asked = 0;
    for (ego, reasons) in [
        (r#"constant{"throttle":-1}"#, &["no-progress", "at-fault"][..]),
        (r#"constant{"throttle":0.4,"steer":0.6}"#, &["off-road", "at-fault", "no-progress"]),
        // A car that creeps at 2 m/s, a fifth of what others drive here.
        (r#"idm{"model":{"desired_speed":2.0},"speed_limits":false}"#, &["no-progress", "at-fault"]),
    ] {
        let rows = results(&desk.test(ego, &["--json"]));
        for row in rows.iter().filter(|row| row["progress"]["compared"].as_f64().unwrap() >= 5.0) {
            asked += 1;
            assert_eq!(row["result"], "failed", "{row}");
            assert!(reasons.contains(&row["shortfall"].as_str().unwrap()), "{row}");
        }
    }
    assert!(asked > 5, "{asked} tests ask for progress");
    // A contact that is not its fault passes with a mark, which `--strict` does not let pass.
    let stands = r#"constant{"throttle":-1}"#;
    let rows = results(&desk.test(stands, &["--json"]));
    let marked = rows.iter().filter(|row| row["result"] == "passed" && !row["contact"].is_null()).count();
    let strict = results(&desk.test(stands, &["--json", "--strict"]));
    assert_eq!(strict.iter().filter(|row| row["shortfall"] == "contact").count(), marked);
    let table = desk.test(stands, &["--junit", &desk.at("report.xml")]);
    assert_eq!(stdout_of(&table).matches("| passed, contact |").count(), marked);
    let xml = fs::read_to_string(desk.path("report.xml")).unwrap();
    assert_eq!(xml.matches("<property name=\"contact\"").count(), marked);
}

#[test]
fn another_version_of_a_suite_or_of_results_is_refused() {
    let desk = Desk::new();
    let now = desk.at("now.jsonl");
    let results = desk.test("idm", &["--json"]);
    fs::write(&now, stdout_of(&results).replace(r#""suite":2"#, r#""suite":1"#)).unwrap();
    let refused = desk.test("idm", &["--baseline", &now]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("they mean different things"), "{}", stderr(&refused));
    let mut suite = desk.suite();
    suite["suite"] = 1.into();
    fs::write(desk.path("suite/suite.json"), suite.to_string()).unwrap();
    let refused = desk.test("idm", &[]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        stderr(&refused).contains("its version is 1; this program reads version 2"),
        "{}",
        stderr(&refused)
    );
}

#[test]
fn a_baseline_lets_only_new_failures_count() {
    let desk = Desk::new();
    let [idm, expert] = ["idm", "expert"].map(|ego| {
        let file = desk.path(&format!("{ego}.jsonl"));
        fs::write(&file, desk.test(ego, &["--json"]).stdout).unwrap();
        file.display().to_string()
    });
    let same = desk.test("idm", &["--baseline", &idm]);
    assert_eq!(same.status.code(), Some(0), "{}", stderr(&same));
    assert!(stderr(&same).contains("0 not in the baseline as failed"));
    assert!(stdout_of(&same).contains("| failed before |") && !stdout_of(&same).contains("FAILED"));
    let worse = desk.test("idm", &["--baseline", &expert]);
    assert_eq!(worse.status.code(), Some(1));
    let better = desk.test("expert", &["--baseline", &idm]);
    assert_eq!(better.status.code(), Some(0), "{}", stderr(&better));
    fs::write(desk.path("no.jsonl"), "nonsense\n").unwrap();
    let refused = desk.test("idm", &["--baseline", &desk.at("no.jsonl")]);
    assert!(stderr(&refused).contains("line 1: no result of `sage test --json`"));
    // Results that say nothing of this suite excuse nothing.
    fs::write(desk.path("empty.jsonl"), "").unwrap();
    let refused = desk.test("idm", &["--baseline", &desk.at("empty.jsonl")]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(stderr(&refused).contains("holds no result of a test of this suite"));
    let first = fs::read_to_string(&expert).unwrap().lines().next().unwrap().to_owned();
    fs::write(desk.path("first.jsonl"), first).unwrap();
    let partly = desk.test("idm", &["--baseline", &desk.at("first.jsonl")]);
    assert_eq!(partly.status.code(), Some(1));
    assert!(stderr(&partly).contains("they count if they fail"), "{}", stderr(&partly));
}

#[test]
fn only_a_failure_at_the_same_plan_excuses_a_failure() {
    let desk = Desk::new();
    let baseline = |change: &dyn Fn(&mut Value)| {
        let rows = results(&desk.test("idm", &["--json"])).into_iter().map(|mut row| {
            change(&mut row);
            row.to_string()
        });
        fs::write(desk.path("base.jsonl"), rows.collect::<Vec<_>>().join("\n")).unwrap();
        desk.test(
            "idm",
            &["--baseline", &desk.at("base.jsonl"), "--junit", &desk.at("report.xml"), "--force"],
        )
    };
    let same = baseline(&|_| ());
    assert_eq!(same.status.code(), Some(0), "{}", stderr(&same));
    let tests = desk.suite()["tests"].as_array().unwrap().len();
    let xml = fs::read_to_string(desk.path("report.xml")).unwrap();
    assert!(xml.contains(&format!("failures=\"0\" errors=\"0\" skipped=\"{tests}\"")), "{xml}");
    let erred = baseline(&|row| row["result"] = "error".into());
    assert_eq!(erred.status.code(), Some(1), "an error is no failure");
    let other = baseline(&|row| {
        if row["test"] != desk.suite()["tests"][0]["name"] {
            row["plan_hash"] = "0".into();
        }
    });
    assert_eq!(other.status.code(), Some(1), "{}", stderr(&other));
    assert!(stderr(&other).contains(&format!("does not know {} tests", tests - 1)), "{}", stderr(&other));
    let driver = baseline(&|row| row["ego"] = "pdm".into());
    assert!(stderr(&driver).contains("holds results of `pdm`, not of `idm`"), "{}", stderr(&driver));
}

#[test]
fn folders_may_have_the_names_of_commands() {
    let desk = Desk::new();
    let run = |arguments: &[&str]| {
        let mut program = std::process::Command::new(env!("CARGO_BIN_EXE_sage"));
        let output = program.args(arguments).current_dir(desk.folder.path()).output().unwrap();
        stdout(&output);
    };
    for _ in 0..2 {
        run(&["suite", "found", "--out", "suite", "--force"]);
        run(&["report", "found", "--out", "report", "--force"]);
        run(&[
            "search",
            "scenes",
            "--ego",
            "idm",
            "--budget",
            "2",
            "--weights",
            "procedural",
            "--out",
            "search",
        ]);
    }
    // A failure that is found twice is one test.
    run(&["suite", "found", "found", "--out", "twice"]);
    let tests = |folder: &str| {
        let bytes = fs::read(desk.path(folder).join("suite.json")).unwrap();
        serde_json::from_slice::<Value>(&bytes).unwrap()["tests"].as_array().unwrap().len()
    };
    assert_eq!(tests("twice"), tests("suite"));
    let search = sage(&["test", &desk.at("found"), "--ego", "idm"]);
    assert!(stderr(&search).contains("make one of it: sage suite"), "{}", stderr(&search));
}

#[test]
fn a_suite_takes_the_rows_of_one_run_and_replaces_an_earlier_suite() {
    let desk = Desk::new();
    let all = desk.suite()["tests"].as_array().unwrap().len();
    let one = desk.suite()["tests"][0]["scene"].as_str().unwrap().replace(".scene", ".pkl");
    // Another run in the same folder, of one scene: the rows of the others stay, and are none of it.
    let scene = desk.path("scenes").join(&one).display().to_string();
    let search = ["search", &scene, "--ego", "idm", "--budget", "10", "--force", "--out", &desk.at("found")];
    stdout(&sage(&[&search[..], &WEIGHTS].concat()));
    let make = ["suite", &desk.at("found"), "--force", "--format", "both", "--out", &desk.at("suite")];
    stdout(&sage(&make));
    let tests = desk.suite()["tests"].as_array().unwrap().len();
    assert!(tests == 1 && all > 1);
    let files = |ending: &str| {
        let names = fs::read_dir(desk.path("suite")).unwrap();
        names.filter(|name| name.as_ref().unwrap().path().extension().is_some_and(|e| e == ending)).count()
    };
    assert_eq!((files("safetensors"), files("pkl")), (1, 3), "one scene, and the tables of the data set");
    let again = ["suite", &desk.at("found"), "--force", "--out", &desk.at("suite")];
    stdout(&sage(&again));
    assert_eq!((files("safetensors"), files("pkl")), (1, 0));
}

#[test]
fn a_report_for_build_servers_counts_failures_and_errors() {
    let desk = Desk::new();
    let output = desk.test("idm", &["--junit", &desk.at("report.xml")]);
    assert_eq!(output.status.code(), Some(1));
    let xml = fs::read_to_string(desk.path("report.xml")).unwrap();
    let count = desk.suite()["tests"].as_array().unwrap().len();
    assert!(xml.contains(&format!("tests=\"{count}\" failures=\"{count}\" errors=\"0\"")), "{xml}");
    assert_eq!(xml.matches("<failure message=\"contact after ").count(), count);
    assert!(stdout_of(&output).contains("| FAILED |"));
    // Written again only with --force.
    assert!(stderr(&desk.test("idm", &["--junit", &desk.at("report.xml")])).contains("--force"));
    let wrong = desk.test("path:no-such-file.json", &[]);
    assert_eq!(wrong.status.code(), Some(1));
}

fn stdout_of(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).unwrap()
}

#[cfg(unix)]
#[test]
fn a_planner_that_fails_is_an_error_of_its_tests() {
    let desk = Desk::new();
    let output = desk.test("cmd:false", &["--json", "--junit", &desk.at("report.xml")]);
    assert_eq!(output.status.code(), Some(1));
    assert!(results(&output).iter().all(|row| row["result"] == "error" && row["error"].is_string()));
    let xml = fs::read_to_string(desk.path("report.xml")).unwrap();
    assert!(xml.contains("<error message=") && !xml.contains("<failure"), "{xml}");
}

#[cfg(unix)]
#[test]
fn a_planner_in_python_is_tested() {
    let planners = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/planners").canonicalize().unwrap();
    let python = std::process::Command::new("python3").arg("--version").output();
    if !python.is_ok_and(|output| output.status.success()) {
        return;
    }
    let desk = Desk::new();
    let planner = format!("cmd:python3 {}/idm.py", planners.display());
    let output = desk.test(&planner, &["--json"]);
    let rows = results(&output);
    assert!(!rows.is_empty() && rows.iter().all(|row| row["result"] != "error"), "{}", stderr(&output));
}

#[test]
fn suites_that_were_changed_or_lead_out_are_refused_and_nothing_happens() {
    let desk = Desk::new();
    let mut said = Vec::new();
    let first = |suite: &mut Value, key: &str, value: Value| suite["tests"][0][key] = value;
    let moved = |suite: &mut Value| {
        let x = &mut suite["tests"][0]["plan"][5][0];
        *x = (x.as_f64().unwrap() + 0.001).into();
    };
    said.push(("scene outside", desk.refused(|s| first(s, "scene", "../../etc/passwd".into()))));
    said.push(("markup in a name", desk.refused(|s| first(s, "name", "<script>alert(1)</script>".into()))));
    said.push(("a command", desk.refused(|s| first(s, "command", "touch owned".into()))));
    said.push(("another plan", desk.refused(moved)));
    said.push(("a later version", desk.refused(|s| s["suite"] = 9.into())));
    said.push(("no tests", desk.refused(|s| s["tests"] = Value::Array(Vec::new()))));
    said.push(("an unknown rule", desk.refused(|s| s["feasibility"]["name"] = "anything".into())));
    let mask = |text: String| -> String {
        // Numbers of a changed scene differ from machine to machine only in names.
        text.lines().filter(|line| !line.starts_with("note:")).collect::<Vec<_>>().join("\n")
    };
    let said: Vec<(&str, String)> = said.into_iter().map(|(what, text)| (what, mask(text))).collect();
    assert_snapshot!("refused_suites", messages(said));
    // A scene that was changed.
    let scene = desk.suite()["tests"][0]["scene"].as_str().unwrap().to_owned();
    let file = desk.path("suite/scenes").join(scene);
    let mut bytes = fs::read(&file).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&file, bytes).unwrap();
    let refused = desk.test("idm", &[]);
    assert!(
        stderr(&refused).contains("is not the scene that the suite was made with"),
        "{}",
        stderr(&refused)
    );
    // A folder that is no search, and one without failures.
    let nothing = sage(&["suite", &desk.at("scenes"), "--out", &desk.at("none")]);
    assert!(stderr(&nothing).contains("it is no output of `sage search`"), "{}", stderr(&nothing));
    assert!(!desk.path("none").exists());
}

#[test]
fn a_diverse_suite_keeps_more_kinds_of_failures_than_the_first_ones() {
    let desk = Desk::new();
    let clusters = |suite: &Value, count: usize| -> std::collections::BTreeSet<String> {
        let tests = suite["tests"].as_array().unwrap().iter().take(count);
        tests.map(|test| test["found"]["cluster"].as_str().unwrap().to_owned()).collect()
    };
    let all = desk.suite();
    let count = clusters(&all, usize::MAX).len();
    assert!(count > 2 && all["tests"].as_array().unwrap().len() > count, "{count} clusters");
    let make = ["suite", &desk.at("found"), "--diverse", &count.to_string(), "--out", &desk.at("diverse")];
    let said = sage(&make);
    stdout(&said);
    let suite = fs::read(desk.path("diverse/suite.json")).unwrap();
    let diverse: Value = serde_json::from_slice(&suite).unwrap();
    assert_eq!(diverse["tests"].as_array().unwrap().len(), count);
    assert!(clusters(&diverse, count).len() >= clusters(&all, count).len());
    assert!(clusters(&diverse, count).len() > count / 2, "{}", stderr(&said));
    assert!(stderr(&said).contains(&format!(" of {count} clusters, entropy ")), "{}", stderr(&said));
    // The same choice at one thread.
    let again = ["suite", &desk.at("found"), "--diverse", &count.to_string(), "--out", &desk.at("again")];
    stdout(&sage(&[&again[..], &["--threads", "1"]].concat()));
    assert_eq!(fs::read(desk.path("again/suite.json")).unwrap(), suite);
    // One failure is the worst of all.
    stdout(&sage(&["suite", &desk.at("found"), "--diverse", "1", "--out", &desk.at("one")]));
    let one: Value = serde_json::from_slice(&fs::read(desk.path("one/suite.json")).unwrap()).unwrap();
    assert_eq!(one["tests"].as_array().unwrap().len(), 1);
    assert_eq!(
        sage(&["suite", &desk.at("found"), "--diverse", "0", "--out", &desk.at("none")]).status.code(),
        Some(2)
    );
}
