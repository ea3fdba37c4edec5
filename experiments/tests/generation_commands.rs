//! `sage generate` and `bench open-loop` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::path::{Path, PathBuf};

use insta::assert_snapshot;
use program::*;
use sage_core::motion::NOW;
use sage_data::Recording;
use serde_json::Value;

#[test]
fn generate_changes_the_adversarys_future_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = example();
    for method in ["sage", "prior", "most-likely", "random", "oracle", "cat", "rule", "log"] {
        let arguments = ["generate", &scene, "--method", method, "--json", "--force", "--out", text(&out)];
        let output = sage(&[&arguments[..], &["--format", "both"], &WEIGHTS].concat());
        let row: Value = serde_json::from_str(stdout(&output).trim()).unwrap();
        for key in [
            "scene",
            "lambda",
            "mu",
            "seed",
            "chosen",
            "feasible",
            "violations",
            "variant",
            "files",
            "source_hash",
            "scores",
            "candidates",
            "seconds",
        ] {
            assert!(!row[key].is_null(), "{method}: `{key}`");
        }
        assert_eq!(row["method"], method);
        let chosen = row["chosen"].as_u64().unwrap() as usize;
        assert_eq!(row["candidates"][chosen]["trajectory"], row["trajectory"]);
        // The chosen one's scores also say whether a driver could have avoided it.
        for (key, value) in row["candidates"][chosen]["scores"].as_object().unwrap() {
            assert_eq!(row["scores"][key], *value, "{key}");
        }
        assert!(row["scores"].get("latest_start").is_some());
        let source = Recording::read(Path::new(&scene)).unwrap().scene;
        let adversary = source.adversary.unwrap();
        let has_point = !["cat", "rule", "log"].contains(&method);
        let variant = if has_point { "lambda1.00" } else { method };
        assert_eq!((&row["scene"], &row["variant"]), (&"crossing".into(), &variant.into()), "{method}");
        let name = format!("crossing-{variant}");
        for ending in ["pkl", "safetensors"] {
            let native = out.join(format!("{name}.safetensors"));
            let file = if ending == "pkl" { pickle(&out, &name) } else { native };
            let made = Recording::read(&file).unwrap();
            let document = made.document().unwrap().unwrap();
            let metadata = document.get(document.root(), "metadata").unwrap();
            let told =
                document.get(metadata, sage_data::PROVENANCE).and_then(|id| document.text(id)).unwrap();
            let told: Value = serde_json::from_str(told).unwrap();
            assert_eq!((&told["method"], &told["seed"]), (&row["method"], &row["seed"]), "{ending}");
            let made = made.scene;
            assert_eq!((made.frames, &made.map, made.ego), (source.frames, &source.map, source.ego));
            for (k, (a, b)) in made.tracks.iter().zip(&source.tracks).enumerate() {
                if k != adversary {
                    assert_eq!(a, b, "{method}: track {k}");
                }
            }
            let track = &made.tracks[adversary];
            for frame in 0..=NOW {
                assert_eq!(track.position[frame], source.tracks[adversary].position[frame]);
            }
            for frame in [NOW + 1, NOW + 40, NOW + 80] {
                for axis in 0..2 {
                    let planned = row["trajectory"][frame - NOW - 1][axis].as_f64().unwrap();
                    assert!(
                        (track.position[frame][axis] - planned).abs() < 1e-3,
                        "{method} {ending} {frame}"
                    );
                }
            }
        }
        assert!(out.join("crossing.svg").is_file() && out.join(format!("{name}.json")).is_file());
    }
}

/// Every shipped folder of experts can be named by its path, although driving policies lie in it.
#[test]
fn shipped_weights_are_read_from_their_folders() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights");
    let experts = ["procedural", "waymo", "waymo/query", "waymo-paper", "waymo-paper/query", "waymo-literal"];
    for name in experts.iter().filter(|name| shipped.join(name).is_dir()) {
        let (scene, weights) = (example(), shipped.join(name));
        let out = folder.path().join(name.replace('/', "-"));
        let output = sage(&["generate", &scene, "--weights", text(&weights), "--out", text(&out)]);
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn a_sweep_follows_lambda_and_is_the_same_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    let sweep = |name: &str, threads: &str| {
        let out: PathBuf = folder.path().join(name);
        let arguments =
            ["generate", &scene, "--lambda", "0:1:0.25", "--json", "--threads", threads, "--out", text(&out)];
        let output = sage(&[&arguments[..], &WEIGHTS].concat());
        rows(&output)
            .into_iter()
            .map(|row| (row["lambda"].clone(), row["trajectory"].clone(), row["scores"].clone()))
            .collect::<Vec<_>>()
    };
    let one = sweep("one", "1");
    assert_eq!(one.len(), 5);
    assert!(one == sweep("two", "2"));
    let reward = |k: usize| one[k].2["adversarial_reward"].as_f64().unwrap();
    assert!(reward(4) >= reward(0), "{} at 1, {} at 0", reward(4), reward(0));
    assert!(pickle(&folder.path().join("one"), "crossing-lambda0.25").is_file());
}

#[test]
fn generate_says_what_is_wrong_and_goes_on_with_the_other_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    std::fs::create_dir(&scenes).unwrap();
    std::fs::copy(example(), scenes.join("a.pkl")).unwrap();
    std::fs::write(scenes.join("b.pkl"), "no scene").unwrap();
    std::fs::copy(example(), scenes.join("c.pkl")).unwrap();
    let out = folder.path().join("out");
    let error = failure(&[&["generate", text(&scenes), "--out", text(&out)][..], &WEIGHTS].concat());
    assert_snapshot!(redacted(&error), @r"
    note: weights `procedural` (network densetnt)
    error: `[folder]/scenes/b.pkl` is a text file; give a scene file: .pkl, .safetensors or a Waymo TFRecord file
    2 scenes, 2 attempts in `[folder]/out` ([time])
    to look at the attacks, open `[folder]/out/index.html`
    1 of 3 scenes failed; the others are in `[folder]/out`; remove the cause and run the same command again
    ");
    assert!(out.join("a.svg").is_file() && out.join("c.svg").is_file());

    let scene = example();
    let other = folder.path().join("other");
    let wrong =
        |more: &[&str]| failure(&[&["generate", &scene, "--out", text(&other)][..], &WEIGHTS, more].concat());
    let refused = [["--method", "none"], ["--lambda", "1.5"], ["--mu", "2"], ["--adversary", "nobody"]];
    assert_snapshot!(
        "wrong_options_of_generate",
        messages(refused.map(|more| (more.join(" "), wrong(&more))))
    );
    assert_eq!(sage(&["generate", &scene, "--lambda", "x", "--out", "y"]).status.code(), Some(2));
    let error = failure(&[&["generate", &scene, "--out", text(&out)][..], &WEIGHTS].concat());
    assert_snapshot!(redacted(&error), @r"
    note: weights `procedural` (network densetnt)
    error: `[folder]/out` holds another run: it is of `sage generate [folder]/scenes --weights procedural`; name another --out, or give --force to write into it anyway
    ");
}

#[test]
fn open_loop_compares_methods_and_keeps_its_table() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    let out = folder.path().join("table");
    stdout(&sage(&["scenes", "--count", "3", "--out", text(&scenes)]));
    let arguments = ["bench", "open-loop", text(&scenes), "--lambda", "0,1", "--out", text(&out)];
    let output = sage(&[&arguments[..], &WEIGHTS].concat());
    let table = stdout(&output);
    assert_snapshot!("open_loop_table", table);
    for file in ["table.md", "estimates.csv", "rows.csv", "study.json", "run.json", "index.html"] {
        assert!(out.join(file).is_file(), "{file}");
    }
    let csv = std::fs::read_to_string(out.join("estimates.csv")).unwrap();
    assert_snapshot!(csv.lines().next().unwrap(), @"subject,arm,attack,metric,unit,value,low,high,n,deviation over seeds");
    assert!(csv.contains("trajectory,recording,sage 1.00,attack,"), "{csv}");
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    // Each of the three scenes is shown with its verdict: attacks that are believable, and those that failed.
    let names = ["01-strongest-1", "01-failed-1"].map(|name| format!("{name}.svg"));
    let shown = names.iter().filter(|name| out.join(name).is_file()).collect::<Vec<_>>();
    assert!(!shown.is_empty() && shown.iter().all(|name| page.contains(&format!("<img src=\"{name}\""))));
    assert!(page.contains("believable") && !out.join(".sage-rows").exists());

    // A run that was broken off goes on: what was kept is read, the rest is run.
    let run = out.join("run.json");
    let mut record: Value = serde_json::from_str(&std::fs::read_to_string(&run).unwrap()).unwrap();
    record["seconds"] = Value::Null;
    std::fs::write(&run, record.to_string()).unwrap();
    let results = out.join(".sage-rows");
    std::fs::create_dir(&results).unwrap();
    std::fs::write(results.join("000000.json"), "cut off").unwrap();
    let again = sage(&[&arguments[..], &WEIGHTS].concat());
    assert!(stdout(&again) == table && !results.exists());
    let done = sage(&[&arguments[..], &WEIGHTS].concat());
    assert_eq!(stdout(&done), table);
    let other = failure(&[&arguments[..], &WEIGHTS, &["--seed", "1"]].concat());
    let said = [("broken off", stderr(&again)), ("done", stderr(&done)), ("of another seed", &other)];
    assert_snapshot!("a_folder_that_holds_a_table", messages(said));
}

#[test]
fn nothing_is_lost_where_names_meet() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "2", "--out", text(&scenes)]));
    let files = |dir: &Path| std::fs::read_dir(dir).unwrap().count();
    let before = files(&scenes);
    let over = ["generate", text(&scenes), "--force", "--out", text(&scenes)];
    assert_snapshot!(redacted(&failure(&[&over[..], &WEIGHTS].concat())), @r"
    note: weights `procedural` (network densetnt)
    error: `[folder]/scenes/curve-1-1.safetensors` would take the place of an input; name another --out
    ");
    let twins = folder.path().join("twins");
    for side in ["a", "b"] {
        std::fs::create_dir_all(twins.join(side)).unwrap();
        std::fs::copy(example(), twins.join(side).join("s.pkl")).unwrap();
    }
    let out = folder.path().join("out");
    let both = ["generate", text(&twins), "--out", text(&out)];
    let apart = sage(&[&both[..], &WEIGHTS].concat());
    stdout(&apart);
    assert_snapshot!(redacted(stderr(&apart)), @r"
    note: weights `procedural` (network densetnt)
    note: outputs of 2 scenes have names with a hash of the path, because their own are not unique or cannot be those of outputs
    2 scenes, 2 attempts in `[folder]/out` ([time])
    to look at the attacks, open `[folder]/out/index.html`
    ");
    let rows = |dir: &Path| {
        let names = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name());
        names.filter(|name| name.to_str().unwrap().ends_with("-lambda1.00.json")).count()
    };
    assert_eq!((rows(&out), files(&scenes)), (2, before));
    let out = folder.path().join("near");
    // Values of lambda that differ in the third digit have files of their own.
    let scene = example();
    let near = ["generate", &scene, "--lambda", "0.501,0.502", "--out", text(&out)];
    stdout(&sage(&[&near[..], &WEIGHTS].concat()));
    assert!(pickle(&out, "crossing-lambda0.501").is_file() && pickle(&out, "crossing-lambda0.502").is_file());
    // What comes out of a procedural scene goes in again.
    let attacked = folder.path().join("attacked");
    let generate = ["generate", text(&scenes), "--out", text(&attacked)];
    stdout(&sage(&[&generate[..], &WEIGHTS].concat()));
    for entry in std::fs::read_dir(&attacked).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "safetensors") {
            let made = Recording::read(&path).unwrap();
            assert!(
                made.scene.notes.iter().any(|note| note.to_string().contains("sage_provenance")),
                "{path:?}"
            );
            assert!(made.to_pickle().is_ok() && made.to_native().is_ok(), "{path:?}");
        }
    }
}

#[test]
fn a_table_of_some_scenes_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("table"));
    stdout(&sage(&["scenes", "--count", "3", "--out", text(&scenes)]));
    let mut names: Vec<String> = std::fs::read_dir(&scenes)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "safetensors"))
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    names.sort();
    let table = |names: &str| {
        let places = ["--data", text(&scenes), "--scenes", names, "--out", text(&out)];
        sage(&[&["bench", "open-loop", "--method", "log"], &places[..], &WEIGHTS].concat())
    };
    let unknown = table(&format!("{},nobody", names[0]));
    assert!(!unknown.status.success());
    assert_snapshot!(redacted(stderr(&unknown)), @r"
    note: weights `procedural` (network densetnt)
    error: no scene `nobody` among the 3 given
    ");
    assert_snapshot!("table_of_two_scenes_by_name", stdout(&table(&names[..2].join(","))));
}

#[test]
fn the_drive_of_another_planner_is_attacked_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let source = Recording::read(Path::new(&example())).unwrap().scene;
    let drive = |shift: f64, frames: usize| -> Vec<[f64; 3]> {
        let pose = |frame: usize| {
            let [x, y] = source.ego().point(frame);
            [x, y + shift, source.ego().heading[frame]]
        };
        (0..frames).map(pose).collect()
    };
    let generate = |name: &str, drive: &Value| {
        let file = folder.path().join(format!("{name}.json"));
        std::fs::write(&file, drive.to_string()).unwrap();
        let (ego, out) = (format!("path:{}", text(&file)), folder.path().join(name));
        let arguments = ["generate", &example(), "--ego", &ego, "--json", "--out", text(&out)];
        sage(&[&arguments[..], &WEIGHTS].concat())
    };
    // The recording as a drive gives the attack on the recording.
    let plain = folder.path().join("plain");
    let arguments = ["generate", &example(), "--json", "--out", text(&plain)];
    let plain: Value = serde_json::from_str(stdout(&sage(&[&arguments[..], &WEIGHTS].concat()))).unwrap();
    let same: Value =
        serde_json::from_str(stdout(&generate("same", &serde_json::json!(drive(0.0, source.frames)))))
            .unwrap();
    assert_eq!(plain["trajectory"], same["trajectory"]);
    assert!(plain["ego"].is_null() && same["ego"].as_str().unwrap().starts_with("path"));
    // Another drive is in the written scene.
    let shifted = generate("shifted", &serde_json::json!({ source.id.as_str(): drive(0.5, source.frames) }));
    assert!(shifted.status.success(), "{}", stderr(&shifted));
    let made = Recording::read(&pickle(&folder.path().join("shifted"), "crossing-lambda1.00")).unwrap().scene;
    let ([x, y], [logged_x, logged_y]) = (made.ego().point(40), source.ego().point(40));
    assert!((x - logged_x).abs() < 1e-4 && (y - logged_y - 0.5).abs() < 1e-4);
    // What cannot be driven is named.
    let short = generate("short", &serde_json::json!(drive(0.0, 50)));
    assert_eq!(short.status.code(), Some(BAD_SCENES));
    assert_snapshot!(redacted(stderr(&short)), @r"
    note: weights `procedural` (network densetnt)
    error: `[sage]/examples/crossing.pkl`: scene `crossing`: the drive in `[folder]/short.json` has 50 poses; expected 91, one a frame
    error: the scene could not be attacked
    ");
}

#[test]
fn drivers_are_compared_by_scene() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("drivers");
    let drivers = |more: &[&str]| {
        sage(
            &[
                &[
                    "bench",
                    "drivers",
                    "--procedural",
                    "7",
                    "--ego",
                    "constant-speed,idm",
                    "--out",
                    text(&out),
                ],
                more,
            ]
            .concat(),
        )
    };
    let first = drivers(&[]);
    // Each driver meets an attack in each scene, and of the attacks it is known whether they are avoidable.
    let table = stdout(&first);
    assert_snapshot!("drivers_with_attacks", table);
    let rows = || std::fs::read_to_string(out.join("rows.csv")).unwrap();
    let count = |text: &str, of: &str| text.lines().filter(|line| line.contains(of)).count();
    assert_eq!(count(&rows(), ",comfortable,"), 14);
    assert_eq!(count(&rows(), ",at-fault attack,"), 14);
    let written = rows();
    let searched =
        |line: &&str| line.contains("\"avoidable, of the attacks\",,0") || line.contains("attacks\",,1");
    let attacks = count(&written, ",attack,,1,");
    assert!(attacks > 0 && written.lines().filter(searched).count() <= attacks, "{attacks}");
    let other = failure(&["bench", "drivers", "--procedural", "3", "--out", text(&out)]);
    assert_eq!(stdout(&drivers(&["--force", "--threads", "1"])), table);
    let unattacked = drivers(&["--force", "--unattacked"]);
    assert_snapshot!("drivers_without_attacks", stdout(&unattacked));
    assert_eq!(count(&rows(), "attacked-drive"), 0);
    let twice = sage(&["bench", "drivers", "--ego", "idm,idm", "--out", text(&folder.path().join("twice"))]);
    let unknown = sage(&["bench", "drivers", "--ego", "idn", "--out", text(&folder.path().join("unknown"))]);
    let said =
        [("the folder of another run", &*other), ("idm,idm", stderr(&twice)), ("idn", stderr(&unknown))];
    assert_snapshot!("refused_runs_of_drivers", messages(said));
}
