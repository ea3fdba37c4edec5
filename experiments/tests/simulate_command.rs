//! Rows and pages of `sage simulate`; the rest is in `commands/simulate.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::fs;

use program::*;
use serde_json::{Value, json};

#[test]
fn rows_have_their_fields_in_the_order_of_drivers_and_lambdas() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = example();
    let arguments = [
        "simulate",
        &scene,
        "--ego",
        "replay,idm",
        "--method",
        "sage",
        "--lambda",
        "0,1",
        "--json",
        "--out",
        text(&out),
    ];
    let arguments = [&arguments[..], &WEIGHTS].concat();
    let all = rows(&sage(&arguments));
    let order: Vec<_> =
        all.iter().map(|row| (row["ego"].as_str().unwrap(), row["lambda"].as_f64().unwrap())).collect();
    assert_eq!(order, [("replay", 0.0), ("replay", 1.0), ("idm", 0.0), ("idm", 1.0)]);
    for row in &all {
        assert_eq!((row["scene"].as_str(), row["method"].as_str()), (Some("crossing"), Some("sage")));
        let (steps, trajectory) = (row["steps"].as_u64().unwrap(), row["trajectory"].as_array().unwrap());
        assert_eq!(trajectory.len() as u64, steps + 1);
        assert!(trajectory.iter().all(|state| state.as_array().unwrap().len() == 4));
        let contacts = row["contacts"].as_array().unwrap();
        match row["end"].as_str().unwrap() {
            "horizon" => assert!(steps == 90 && contacts.is_empty()),
            "contact" => assert_eq!(contacts[0]["step"].as_i64().unwrap(), steps as i64 - 10),
            other => panic!("{other}"),
        }
        for contact in contacts {
            for key in ["with", "overlap", "impact_speed", "side_hit", "rule", "class"] {
                assert!(!contact[key].is_null(), "{key}");
            }
            assert!(contact["at_fault"].is_boolean());
        }
        for key in ["arrived", "off_road", "completion"] {
            assert!(row.as_object().unwrap().contains_key(key), "{key}");
        }
        assert_eq!(row["attack"]["trajectory"].as_array().unwrap().len(), 80);
    }
    // A replayed ego meets the attack as `generate` scores it.
    let attacked = folder.path().join("attacked");
    let generate = ["generate", &scene, "--format", "both", "--json", "--out", text(&attacked)];
    let generated = &rows(&sage(&[&generate[..], &WEIGHTS].concat()))[0];
    let step = &generated["scores"]["collision_step"];
    assert!(step.is_number());
    assert_eq!(
        (&all[1]["contacts"][0]["step"], all[1]["attack"]["verdict"]["attack"].as_bool()),
        (step, Some(true))
    );
    assert_eq!(all[1]["attack"]["trajectory"], generated["trajectory"]);

    // The same attack from its row and from its scene file, and the attacked scene as it is.
    let row = attacked.join("crossing-lambda1.00.json");
    let native = attacked.join("crossing-lambda1.00.safetensors");
    let pickle = pickle(&attacked, "crossing-lambda1.00");
    for (k, attack) in [Some(&row), Some(&native), Some(&pickle), None].into_iter().enumerate() {
        let out = folder.path().join(format!("again-{k}"));
        let mut arguments = vec!["simulate", "--ego", "replay", "--json", "--out", text(&out)];
        match attack {
            Some(attack) => arguments.extend([&*scene, "--attack", text(attack)]),
            None => arguments.push(text(&native)),
        }
        let again = &rows(&sage(&arguments))[0];
        assert_eq!(&again["contacts"][0]["step"], step, "{k}");
        assert_eq!((again["method"].as_str(), again["lambda"].as_f64()), (Some("sage"), Some(1.0)), "{k}");
    }

    // An attack by another car than the default adversary is driven by that car.
    let by_other = folder.path().join("by-other");
    let generate = [
        "generate",
        &scene,
        "--format",
        "both",
        "--adversary",
        "leader",
        "--method",
        "random",
        "--json",
        "--out",
        text(&by_other),
    ];
    let generated = &rows(&sage(&[&generate[..], &WEIGHTS].concat()))[0];
    assert_eq!(generated["adversary"], "leader");
    let name = format!("{}-{}", generated["scene"].as_str().unwrap(), generated["variant"].as_str().unwrap());
    for ending in ["json", "safetensors"] {
        let out = folder.path().join(format!("other-{ending}"));
        let attack = by_other.join(format!("{name}.{ending}"));
        let arguments =
            ["simulate", &scene, "--attack", text(&attack), "--ego", "replay", "--json", "--out", text(&out)];
        let row = &rows(&sage(&arguments))[0];
        assert_eq!((&row["adversary"], row["attack"]["verdict"].is_object()), (&json!("leader"), true));
    }
    // The same command again changes nothing.
    let page = out.join("crossing.html");
    let written = fs::metadata(&page).unwrap().modified().unwrap();
    let mut found = rows(&sage(&arguments));
    for (row, before) in found.iter_mut().zip(&all) {
        assert_eq!(row["seconds"], Value::Null);
        for time in ["seconds", "step_ms"] {
            row[time] = before[time].clone();
        }
        assert_eq!(row, before);
    }
    assert_eq!(fs::metadata(&page).unwrap().modified().unwrap(), written);
}

/// Sums of differences, as the page decodes them.
fn sums(differences: &Value, unit: f64) -> Vec<f64> {
    let mut sum = 0;
    let mut next = |d: &Value| {
        sum += d.as_i64().unwrap();
        sum as f64 * unit
    };
    differences.as_array().unwrap().iter().map(&mut next).collect()
}

#[test]
fn the_page_is_self_contained_and_holds_the_drive() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = example();
    let row = &rows(&sage(&["simulate", &scene, "--json", "--out", text(&out)]))[0];
    let page = fs::read_to_string(out.join("crossing.html")).unwrap();
    assert!(page.len() < 2_000_000);
    // An icon of its own keeps a browser from asking for one.
    let page = page.replace("href=\"data:,\"", "");
    for outside in ["http:", "https:", "src=", "href=", "@import", "url(", "fetch("] {
        assert!(!page.contains(outside), "{outside}");
    }
    let (_, data) = page.split_once("type=\"application/json\">").unwrap();
    let data: Value = serde_json::from_str(data.split_once("</script>").unwrap().0).unwrap();
    assert_eq!((data["title"].as_str(), data["frames"].as_u64()), (Some("crossing"), Some(91)));
    assert!(data["map"].as_array().unwrap().len() > 5);
    let run = &data["panels"][0]["ego"]["runs"][0];
    let [x, y] = [sums(&run["x"], 0.01), sums(&run["y"], 0.01)];
    let trajectory = row["trajectory"].as_array().unwrap();
    assert_eq!(x.len(), trajectory.len());
    let start = [0, 1].map(|k| trajectory[0][k].as_f64().unwrap());
    for (frame, state) in trajectory.iter().enumerate() {
        let gap = [x[frame] + start[0], y[frame] + start[1]];
        let [dx, dy] = [0, 1].map(|k| gap[k] - state[k].as_f64().unwrap());
        assert!(dx.abs() <= 0.0051 && dy.abs() <= 0.0051, "frame {frame}: {dx} {dy}");
    }
}

#[test]
fn names_cannot_break_out_of_the_page() {
    let folder = tempfile::tempdir().unwrap();
    let name = "a{{DATA}}<img src=x>&{{TITLE}}";
    let scene = folder.path().join(format!("{name}.pkl"));
    fs::copy(example(), &scene).unwrap();
    let out = folder.path().join("out");
    stdout(&sage(&["simulate", text(&scene), "--out", text(&out)]));
    let page = fs::read_to_string(out.join(format!("{name}.html"))).unwrap();
    assert!(!page.contains("<img"), "{page}");
    let (_, data) = page.split_once("type=\"application/json\">").unwrap();
    let data: Value = serde_json::from_str(data.split_once("</script>").unwrap().0).unwrap();
    assert_eq!(data["title"], name);
}

#[test]
fn many_operating_points_share_a_box_with_a_slider() {
    let folder = tempfile::tempdir().unwrap();
    let page = |lambda: &str, out: &str| -> Value {
        let out = folder.path().join(out);
        let command = ["simulate", &example(), "--ego", "idm,expert", "--method", "sage", "--lambda", lambda];
        stdout(&sage(&[&command[..], &WEIGHTS, &["--out", text(&out)]].concat()));
        let page = fs::read_to_string(out.join("crossing.html")).unwrap();
        let (_, data) = page.split_once("type=\"application/json\">").unwrap();
        serde_json::from_str(data.split_once("</script>").unwrap().0).unwrap()
    };
    let swept = page("0:1:0.2", "swept");
    let sweeps: Vec<(u64, f64)> = swept["panels"]
        .as_array()
        .unwrap()
        .iter()
        .map(|panel| {
            assert_eq!(panel["sweep"]["axis"], "lambda");
            (panel["sweep"]["group"].as_u64().unwrap(), panel["sweep"]["value"].as_f64().unwrap())
        })
        .collect();
    let expected = |group| [0.0, 0.2, 0.4, 0.6, 0.8, 1.0].map(|lambda| (group, lambda));
    assert_eq!(sweeps, [expected(0), expected(1)].concat());
    // A few stand side by side.
    let few = page("0,0.5,1", "few");
    assert!(few["panels"].as_array().unwrap().iter().all(|panel| panel["sweep"].is_null()));
}
