//! Evasive manoeuvres, as a user sees them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::fs;

use program::*;
use serde_json::{Value, json};

fn example_candidates() -> String {
    format!("{}/../examples/crossing.json", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn a_witness_given_back_as_the_egos_path_is_not_hit() {
    let (scene, candidates) = (example(), example_candidates());
    let score = |candidates: &str, more: &[&str]| {
        let all = ["score", &scene, "--candidates", candidates, "--json"];
        rows(&sage(&[&all[..], more].concat()))
    };
    let scored = score(&candidates, &["--avoidable"]);
    assert!(score(&candidates, &[])[0].get("avoidable").is_none());
    let hit = scored.iter().find(|row| row["name"] == "slow to meet").unwrap();
    assert_eq!((&hit["avoidable"], &hit["hit_from_behind"]), (&json!(true), &json!(false)));
    let time = hit["latest_start"].as_f64().unwrap();
    assert!(time <= hit["latest_brake"].as_f64().unwrap() && time > 0.0, "{hit}");
    let witness = hit["witness"].as_array().unwrap();
    assert_eq!(witness.len(), 80);
    let missed = scored.iter().find(|row| row["name"] == "as logged").unwrap();
    assert_eq!((&missed["avoidable"], &missed["avoidable_reason"]), (&Value::Null, &json!("no contact")));

    // The same trajectory against the witness.
    let text_of = fs::read_to_string(&candidates).unwrap();
    let given: Value = serde_json::from_str(&text_of).unwrap();
    let list = given.as_array().cloned().or_else(|| given["candidates"].as_array().cloned()).unwrap();
    let trajectory = &list.iter().find(|one| one["name"] == "slow to meet").unwrap()["trajectory"];
    let again = json!([{"name": "again", "trajectory": trajectory, "ego": witness}]);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("again.json");
    fs::write(&file, again.to_string()).unwrap();
    let row = score(text(&file), &[]).remove(0);
    assert_eq!(row["collision"], json!(false), "{row}");

    // A driver who cannot brake or steer hard must react earlier.
    let weak = score(&candidates, &["--avoidable", r#"{"brake": 2, "lateral": 1, "accelerate": 0.5}"#]);
    let weak = weak.iter().find(|row| row["name"] == "slow to meet").unwrap();
    assert!(weak["latest_start"].as_f64().unwrap() > time, "{weak}");
}

#[test]
fn generated_attacks_say_how_late_they_are_avoidable_and_a_latest_start_chooses() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "4", "--seed", "4", "--out", text(&scenes)]));
    let generate = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let all =
            ["generate", text(&scenes), "--lambda", "1", "--format", "native", "--json", "--out", text(&out)];
        rows(&sage(&[&all[..], more].concat()))
    };
    let plain = generate("plain", &[]);
    assert_eq!(plain.len(), 4);
    let mut avoided = 0;
    for row in &plain {
        let scores = &row["scores"];
        let is_hit = scores["collision"] == json!(true);
        assert_eq!(
            scores["avoidable"].is_boolean(),
            is_hit && scores["avoidable_reason"].is_null(),
            "{scores}"
        );
        assert!(row["candidates"][0]["scores"].get("avoidable").is_none());
        assert!(is_hit || scores.get("references").is_none(), "{scores}");
        avoided += usize::from(scores["avoidable"] == json!(true));
    }
    assert!(avoided >= 2, "{avoided}");
    let name = plain[0]["scene"].as_str().unwrap();
    let picture = fs::read_to_string(folder.path().join(format!("plain/{name}.svg"))).unwrap();
    assert_eq!(picture.contains("evasive manoeuvre from"), plain[0]["scores"]["avoidable"] == json!(true));

    for target in ["0.3", "1"] {
        let mut notes = 0;
        for row in generate(&format!("latest{target}"), &["--latest-start", target]) {
            assert_eq!(row["wanted_latest_start"].as_f64(), target.parse().ok());
            let (time, note) = (row["scores"]["latest_start"].as_f64(), row["note"].as_str());
            let gap = time.map(|time| (time - target.parse::<f64>().unwrap()).abs());
            match note {
                None => assert!(gap.unwrap() <= 0.25 + 1e-9, "{time:?}"),
                Some(note) => {
                    notes += 1;
                    assert!(note.contains("latest start"), "{note}");
                    assert!(gap.is_none_or(|gap| gap > 0.25), "{time:?} with {note}");
                }
            }
        }
        assert!(notes < 4, "{target}");
    }
}
