//! `sage simulate` and `bench open-loop --ego` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{fs, path::Path};

use insta::assert_snapshot;
use program::*;
use serde_json::{Value, json};

/// Writes procedural scenes into a folder.
fn scenes(folder: &Path, count: &str) {
    stdout(&sage(&["scenes", "--count", count, "--seed", "4", "--out", text(folder)]));
}

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
    let mut refused = Vec::new();
    for ending in ["json", "safetensors"] {
        let out = folder.path().join(format!("other-{ending}"));
        let attack = by_other.join(format!("{name}.{ending}"));
        let arguments =
            ["simulate", &scene, "--attack", text(&attack), "--ego", "replay", "--json", "--out", text(&out)];
        let row = &rows(&sage(&arguments))[0];
        assert_eq!((&row["adversary"], row["attack"]["verdict"].is_object()), (&json!("leader"), true));
        refused.push((ending, failure(&[&arguments[..], &["--force", "--adversary", "crosser"]].concat())));
    }
    assert_snapshot!(messages(refused), @r"
    json -> error: `[sage]/examples/crossing.pkl`: the adversary of `[folder]/by-other/crossing-lambda1.00.json` is `leader`, not `crosser`
        error: the scene could not be driven
    safetensors -> error: `[sage]/examples/crossing.pkl`: the adversary of `[folder]/by-other/crossing-lambda1.00.safetensors` is `leader`, not `crosser`
        error: the scene could not be driven
    ");

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
fn a_scene_that_fails_is_named_and_the_others_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("scenes"), folder.path().join("out"));
    scenes(&input, "7");
    fs::write(input.join("broken.pkl"), b"no scene").unwrap();
    let arguments = ["simulate", text(&input), "--ego", "idm,expert", "--json", "--out", text(&out)];
    let output = sage(&arguments);
    assert_eq!(output.status.code(), Some(BAD_SCENES));
    assert_snapshot!(redacted(stderr(&output)), @r"
    error: `[folder]/scenes/broken.pkl` is a text file; give a scene file: .pkl, .safetensors or a Waymo TFRecord file
    7 scenes, 14 drives in `[folder]/out` ([time])
    | driver | drives | contact | at fault | off road |
    | ------ | -----: | ------: | -------: | -------: |
    | idm    |      7 | 0 (0 %) |  0 (0 %) |   0 of 7 |
    | expert |      7 | 0 (0 %) |  0 (0 %) |   0 of 7 |
    | driver | time a step | 99 % of steps |
    | ------ | ----------: | ------------: |
    | idm    | [time]
    | expert | [time]
    to watch, open `[folder]/out/index.html` in a browser
    1 of 8 scenes failed; the others are in `[folder]/out`; remove the cause and run the same command again
    ");
    let rows = |output: &std::process::Output| -> Vec<Value> {
        let text = std::str::from_utf8(&output.stdout).unwrap();
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let all = rows(&output);
    assert_eq!(all.len(), 14);
    // The order is that of the scenes, whatever the threads.
    let other = folder.path().join("one");
    let one = sage(&[
        "--threads",
        "1",
        "simulate",
        text(&input),
        "--ego",
        "idm,expert",
        "--json",
        "--out",
        text(&other),
    ]);
    let plain = |rows: Vec<Value>| -> Vec<Value> {
        let strip = |mut row: Value| {
            for key in ["seconds", "step_ms", "run_hash"] {
                row[key] = Value::Null;
            }
            row
        };
        rows.into_iter().map(strip).collect()
    };
    assert_eq!(plain(all.clone()), plain(rows(&one)));

    // After repair the run resumes: only the missing scene is driven.
    fs::remove_file(input.join("broken.pkl")).unwrap();
    let lost = all[2]["scene"].as_str().unwrap();
    fs::remove_file(out.join(format!("{lost}-idm.json"))).unwrap();
    let output = sage(&arguments);
    assert_snapshot!(redacted(stderr(&output)), @r"
    note: `[folder]/out` holds this run unfinished; it resumes
    7 scenes, 6 of them finished before, 14 drives in `[folder]/out` ([time])
    | driver | drives | contact | at fault | off road |
    | ------ | -----: | ------: | -------: | -------: |
    | idm    |      7 | 0 (0 %) |  0 (0 %) |   0 of 7 |
    | expert |      7 | 0 (0 %) |  0 (0 %) |   0 of 7 |
    | driver | time a step | 99 % of steps |
    | ------ | ----------: | ------------: |
    | idm    | [time]
    | expert | [time]
    to watch, open `[folder]/out/index.html` in a browser
    ");
    let again = rows(&output);
    let driven = again.iter().filter(|row| !row["seconds"].is_null()).count();
    assert_eq!((driven, plain(again)), (2, plain(all)));
    let index = fs::read_to_string(out.join("index.html")).unwrap();
    assert_eq!(index.matches("<a href=").count(), 7);
}

#[test]
fn wrong_input_gets_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = example();
    let error = |more: &[&str]| failure(&[&["simulate", &*scene, "--out", text(&out)], more].concat());
    let options: [&[&str]; 5] = [
        &["--ego", "idmm"],
        &["--ego", "idm,idm"],
        &["--lambda", "1"],
        &["--selection", "nonsense"],
        &["--attack", "missing.json"],
    ];
    let mut said = options.map(|more| (more.join(" "), error(more))).to_vec();

    let path = folder.path().join("drive.json");
    let far: Vec<[f64; 3]> = (0..91).map(|k| [1e4 + f64::from(k), 0.0, 0.0]).collect();
    for (name, drive) in [
        ("a drive of two poses", json!([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])),
        ("a drive elsewhere", json!(far)),
    ] {
        fs::write(&path, drive.to_string()).unwrap();
        said.push((name.to_owned(), error(&["--ego", &format!("path:{}", text(&path))])));
    }
    let row = folder.path().join("row.json");
    for wrong in [
        "[1]",
        "{}",
        r#"{"scene": "crossing", "adversary": "2", "source_hash": "0", "trajectory": [[1, 2, 3, 4]]}"#,
    ] {
        fs::write(&row, wrong).unwrap();
        said.push((format!("--attack {wrong}"), error(&["--attack", text(&row)])));
    }
    said.push(("--attack of the scene itself".to_owned(), error(&["--attack", &scene])));

    scenes(&folder.path().join("scenes"), "1");
    let other = fs::read_dir(folder.path().join("scenes")).unwrap().map(|entry| entry.unwrap().path());
    let other = other.filter(|path| path.extension().is_some_and(|e| e != "json")).min().unwrap();
    said.push(("--attack of another scene".to_owned(), error(&["--attack", text(&other)])));
    let attacked = folder.path().join("attacked");
    let generate = ["generate", text(&other), "--method", "rule", "--json", "--out", text(&attacked)];
    let row = &rows(&sage(&generate))[0];
    let name = format!("{}-{}.json", row["scene"].as_str().unwrap(), row["variant"].as_str().unwrap());
    said.push((
        "--attack of a row of another scene".to_owned(),
        error(&["--attack", text(&attacked.join(name))]),
    ));
    assert!(!out.join("crossing.html").exists());
    let two = sage(&["simulate", &scene, "--method", "sage", "--attack", "x.json", "--out", text(&out)]);
    assert_eq!(two.status.code(), Some(2));
    said.push(("--method sage --attack x.json".to_owned(), stderr(&two).to_owned()));
    assert_snapshot!("wrong_options_of_simulate", messages(said));
}

#[test]
fn drivers_are_tested_in_two_stages() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("scenes"), folder.path().join("out"));
    scenes(&input, "5");
    let arguments = [
        "bench",
        "open-loop",
        text(&input),
        "--selection",
        "natural",
        "--method",
        "sage,rule,log",
        "--lambda",
        "1",
        "--ego",
        "replay,idm",
        "--out",
        text(&out),
    ];
    let table = stdout(&sage(&arguments)).to_owned();
    assert_snapshot!("drivers_in_two_stages", table);
    let estimates = fs::read_to_string(out.join("estimates.csv")).unwrap();
    let share = |start: &str| -> f64 {
        let line = estimates.lines().find(|line| line.starts_with(start)).unwrap();
        line.split(',').nth(5).unwrap().parse().unwrap()
    };
    // Nothing happens to a driver whose adversary keeps to its log: the recorded scenes are without contact.
    assert_eq!(share("attacked-drive,replay,log,attack,"), 0.0);
    // Replay repeats the open-loop table: the attack rate is the same.
    let attacks = share("attacked-drive,replay,sage 1.00,attack,");
    assert!((share("trajectory,replay,sage 1.00,attack,") - attacks).abs() < 1e-12);
    // The same command prints the same table again.
    assert_eq!(stdout(&sage(&arguments)), table);
    let unknown = failure(&[
        "bench",
        "open-loop",
        text(&input),
        "--ego",
        "nobody",
        "--out",
        text(&folder.path().join("x")),
    ]);
    assert_snapshot!(unknown, @"error: unknown policy `nobody`; known: replay, idm, idm-release, idm-nuplan, idm-vmax, r157, pdm, expert, expert-release, ppo, td3, tracking, constant-speed, constant, takeover, path, process");
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
