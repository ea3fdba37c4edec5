//! `sage explain`, and rows where `draw` and `score` take candidates.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use program::*;
use serde_json::Value;

#[test]
fn explain_counts_what_the_rows_of_generate_hold() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    stdout(&sage(&["scenes", "--count", "8", "--out", text(&at("scenes"))]));
    let scenes = std::fs::read_dir(at("scenes")).unwrap().map(|entry| entry.unwrap().path());
    let scenes: Vec<_> = scenes.filter(|path| path.extension().is_some_and(|e| e == "safetensors")).collect();
    let mut outcomes = std::collections::BTreeSet::new();
    for scene in &scenes {
        let points = ["--lambda", "0,0.5,1"];
        let generated = rows(&sage(
            &[
                &["generate", text(scene), "--json", "--format", "native"][..],
                &WEIGHTS,
                &points,
                &["--force", "--out", text(&at("out"))],
            ]
            .concat(),
        ));
        let explained = rows(&sage(&[&["explain", text(scene), "--json"][..], &WEIGHTS, &points].concat()));
        assert_eq!(generated.len(), explained.len());
        for (row, explained) in generated.iter().zip(&explained) {
            let candidates = row["candidates"].as_array().unwrap();
            let count =
                |is: &dyn Fn(&Value) -> bool| candidates.iter().filter(|one| is(&one["scores"])).count();
            let hits = |scores: &Value| scores["collision"] == true;
            // The selection `natural` uses the rule `drivable`.
            let feasible = |scores: &Value| scores["feasible_drivable"] == true;
            let believed = |scores: &Value| hits(scores) && feasible(scores) && scores["believable"] == true;
            assert_eq!(explained["candidates"], candidates.len());
            assert_eq!(explained["feasible"], count(&feasible));
            assert_eq!(explained["hits"], count(&hits));
            assert_eq!(explained["feasible_hits"], count(&|scores| hits(scores) && feasible(scores)));
            assert_eq!(explained["believable_hits"], count(&believed));
            let chosen = &row["scores"];
            let outcome = explained["outcome"].as_str().unwrap();
            let expected = match (hits(chosen), believed(chosen)) {
                (true, true) => &["attack"][..],
                (true, false) => &["not-believable"],
                _ => &["never-hit", "no-feasible-hit", "not-preferred", "no-feasible-plan"],
            };
            assert!(expected.contains(&outcome), "{outcome}");
            outcomes.insert(outcome.to_owned());
            // The value is the sum of its terms. The selected one is first, and has the largest value, apart from hits that are
            // not believable.
            let best = explained["best"].as_array().unwrap();
            assert_eq!((&best[0]["is_chosen"], &best[0]["number"]), (&Value::Bool(true), &row["chosen"]));
            for one in best {
                let sum: f64 =
                    one["terms"].as_array().unwrap().iter().map(|term| term[1].as_f64().unwrap()).sum();
                assert!((sum - one["value"].as_f64().unwrap()).abs() < 1e-9);
                let is_doubted = one["is_doubted"] == true;
                let is_best = one["value"].as_f64() <= best[0]["value"].as_f64();
                assert!(one["feasible"] == false || is_doubted || is_best);
            }
        }
    }
    assert!(outcomes.contains("attack") && outcomes.contains("never-hit"), "{outcomes:?}");
    let text = stdout(&sage(&[&["explain", &example()][..], &WEIGHTS].concat())).to_owned();
    // The first line holds the path of the scene.
    assert!(text.lines().skip(1).all(|line| line.chars().count() <= 100), "{text}");
    assert_eq!(text.matches("| contact | value |").count(), 5);
}

#[test]
fn explain_draw_and_score_read_rows() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let generate = |format: &str, out: &str| {
        let command = ["generate", &example(), "--lambda", "0,1", "--format", format, "--out", &at(out)];
        stdout(&sage(&[&command[..], &WEIGHTS].concat()));
    };
    let explained = |arguments: &[&str]| -> Vec<Value> {
        let mut all = rows(&sage(&[&["explain"], arguments, &["--json"]].concat()));
        // The label of a row is its variant.
        all.iter_mut().for_each(|one| one["attack"] = Value::Null);
        all
    };
    let whole = explained(&[&[&*example(), "--lambda", "0,1"][..], &WEIGHTS].concat());
    for format in ["pickle", "native", "rows"] {
        generate(format, format);
        for (lambda, expected) in ["0.00", "1.00"].iter().zip(&whole) {
            let row = at(&format!("{format}/crossing-lambda{lambda}.json"));
            // A row is explained from its attacked scene, which has the same values as the scene.
            let scene = example();
            let of: &[&str] = if format == "rows" { &["--of", &scene] } else { &[] };
            assert_eq!(&explained(&[&[&*row][..], of].concat())[0], expected, "{format}");
        }
    }
    let row = at("rows/crossing-lambda1.00.json");
    let scene = example();
    let candidates = serde_json::from_slice::<Value>(&std::fs::read(&row).unwrap()).unwrap();
    let scored = rows(&sage(&["score", &scene, "--candidates", &row, "--json"]));
    let all = candidates["candidates"].as_array().unwrap();
    assert_eq!(scored.len(), all.len());
    for (scored, candidate) in scored.iter().zip(all) {
        assert_eq!(scored["adversarial_reward"], candidate["scores"]["adversarial_reward"]);
    }
    let drawn = stdout(&sage(&["draw", &scene, "--candidates", &row, "--out", "-"])).to_owned();
    assert!(drawn.contains("selected"));
}
