//! Results of `sage test`; the rest of it and `sage suite` are in `commands/suite.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod found_failures;
mod program;

use std::{fs, path::Path, process::Output};

use found_failures::*;
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

fn stdout_of(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).unwrap()
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
fn pages_of_tests_are_written_and_two_drivers_compared() {
    let desk = Desk::new();
    let data = |page: &str| -> Value {
        let page = fs::read_to_string(desk.path(page)).unwrap();
        let (_, data) = page.split_once(r#"type="application/json">"#).unwrap();
        serde_json::from_str(data.split_once("</script>").unwrap().0).unwrap()
    };
    let idm = desk.test("idm", &["--json", "--out", &desk.at("of-idm")]);
    let written = fs::read_to_string(desk.path("of-idm/results.jsonl")).unwrap();
    assert_eq!(written, stdout_of(&idm));
    let expert = results(&desk.test("expert", &["--json", "--out", &desk.at("of-expert")]));
    let passed = expert.iter().filter(|row| row["result"] == "passed").count();
    assert_eq!(data("of-expert/index.html")["items"].as_array().unwrap().len(), expert.len());
    // A folder that is there is not written over, with --force it is.
    let again = desk.test("idm", &["--out", &desk.at("of-idm")]);
    assert!(stderr(&again).contains("--force"), "{}", stderr(&again));
    assert_eq!(desk.test("idm", &["--out", &desk.at("of-idm"), "--force"]).status.code(), Some(1));

    let compare = |a: &str, b: &str, out: &str| {
        sage(&["report", "--compare", &desk.at(a), &desk.at(b), "--out", &desk.at(out)])
    };
    let compared = compare("of-idm", "of-expert", "compared");
    assert!(compared.status.success(), "{}", stderr(&compared));
    let items = data("compared/index.html")["items"].as_array().unwrap().clone();
    let fixed = items.iter().filter(|item| item["result"] == "fixed").count();
    assert_eq!((items.len(), fixed), (expert.len(), passed));
    for item in &items {
        let page = item["page"].as_str().unwrap().split('#').next().unwrap();
        // Both drives of a test have its name, so that a link shows them together.
        let panels = data(&format!("compared/{page}"))["panels"].as_array().unwrap().clone();
        assert_eq!(panels.iter().filter(|panel| panel["id"] == item["name"]).count(), 2);
    }
    // The other way round what was fixed fails anew.
    compare("of-expert", "of-idm", "other");
    let items = data("other/index.html")["items"].as_array().unwrap().clone();
    assert_eq!(items.iter().filter(|item| item["result"] == "new failure").count(), passed);
    let wrong = compare("of-idm", "suite", "wrong");
    assert!(stderr(&wrong).contains("no output of `sage test --out`"), "{}", stderr(&wrong));
}
