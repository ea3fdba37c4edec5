//! `sage generate`, `finetune` and `bench open-loop` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use sage_core::motion::NOW;
use sage_data::Recording;
use serde_json::Value;

fn example() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/crossing.pkl").display().to_string()
}

fn sage(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sage")).args(arguments).env_remove("SAGE_WEIGHTS").output().unwrap()
}

fn stdout(output: &Output) -> &str {
    assert!(output.status.success(), "{}", stderr(output));
    std::str::from_utf8(&output.stdout).unwrap()
}

fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).unwrap()
}

fn failure(arguments: &[&str]) -> String {
    let output = sage(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {}", stderr(&output));
    stderr(&output).to_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

const WEIGHTS: [&str; 2] = ["--weights", "procedural"];

#[test]
fn generate_changes_the_adversarys_future_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let scene = example();
    for method in ["sage", "prior", "most-likely", "random", "oracle", "cat", "rule", "log"] {
        let arguments = ["generate", &scene, "--method", method, "--json", "--force", "--out", text(&out)];
        let output = sage(&[&arguments[..], &WEIGHTS].concat());
        let row: Value = serde_json::from_str(stdout(&output).trim()).unwrap();
        for key in [
            "scene",
            "lambda",
            "mu",
            "seed",
            "chosen",
            "feasible",
            "reasons",
            "scores",
            "candidates",
            "seconds",
        ] {
            assert!(!row[key].is_null(), "{method}: `{key}`");
        }
        assert_eq!(row["method"], method);
        let chosen = row["chosen"].as_u64().unwrap() as usize;
        assert_eq!(row["candidates"][chosen]["trajectory"], row["trajectory"]);
        assert_eq!(row["candidates"][chosen]["scores"], row["scores"]);
        let source = Recording::read(Path::new(&scene)).unwrap().scene;
        let adversary = source.adversary.unwrap();
        for ending in ["pkl", "safetensors"] {
            let made = Recording::read(&out.join(format!("crossing.{ending}"))).unwrap();
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
        assert!(out.join("crossing.svg").is_file() && out.join("crossing.json").is_file());
    }
}

#[test]
fn a_sweep_is_steered_and_repeats_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    let sweep = |name: &str, threads: &str| {
        let out: PathBuf = folder.path().join(name);
        let arguments =
            ["generate", &scene, "--lambda", "0:1:0.25", "--json", "--threads", threads, "--out", text(&out)];
        let output = sage(&[&arguments[..], &WEIGHTS].concat());
        let rows: Vec<Value> =
            stdout(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        rows.into_iter()
            .map(|row| (row["lambda"].clone(), row["trajectory"].clone(), row["scores"].clone()))
            .collect::<Vec<_>>()
    };
    let one = sweep("one", "1");
    assert_eq!(one.len(), 5);
    assert!(one == sweep("two", "2"));
    let reward = |k: usize| one[k].2["adversarial_reward"].as_f64().unwrap();
    assert!(reward(4) >= reward(0), "{} at 1, {} at 0", reward(4), reward(0));
    assert!(folder.path().join("one/crossing-0.25.pkl").is_file());
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
    assert!(error.contains("b.pkl") && error.contains("1 of 3 scenes failed"), "{error}");
    assert!(out.join("a.svg").is_file() && out.join("c.svg").is_file());

    let scene = example();
    let other = folder.path().join("other");
    let wrong =
        |more: &[&str]| failure(&[&["generate", &scene, "--out", text(&other)][..], &WEIGHTS, more].concat());
    assert!(wrong(&["--method", "none"]).contains("unknown generator `none`"));
    assert!(wrong(&["--lambda", "1.5"]).contains("going beyond the experts comes later"));
    assert!(wrong(&["--mu", "2"]).contains("mu is 2; expected 0 to 1"));
    assert!(wrong(&["--adversary", "nobody"]).contains("no track `nobody`"));
    assert_eq!(sage(&["generate", &scene, "--lambda", "x", "--out", "y"]).status.code(), Some(2));
    let error = failure(&[&["generate", &scene, "--out", text(&out)][..], &WEIGHTS].concat());
    assert!(error.contains("is not empty; give --force"), "{error}");
}

#[test]
fn experts_are_tuned_from_either_network_merged_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("quick.json");
    std::fs::write(&config, r#"{"epochs": 1, "candidates": 16}"#).unwrap();
    for backbone in ["densetnt", "query-transformer"] {
        let [prior, experts, out] =
            ["prior", "experts", "out"].map(|part| folder.path().join(format!("{backbone}-{part}")));
        let small = r#"{"hidden": 16, "rounds": 1}"#;
        let arguments = [
            "pretrain",
            "--backbone",
            backbone,
            "--network",
            small,
            "--made",
            "2",
            "--epochs",
            "1",
            "--out",
            text(&prior),
        ];
        stdout(&sage(&arguments));
        let tune = |out: &Path, threads: &str| {
            let arguments = [
                "finetune",
                "--made",
                "4",
                "--prior",
                text(&prior),
                "--config",
                text(&config),
                "--threads",
                threads,
                "--out",
                text(out),
            ];
            let output = sage(&arguments);
            assert!(output.status.success(), "{}", stderr(&output));
            assert!(stderr(&output).contains("adversarial epoch 1: loss"), "{}", stderr(&output));
        };
        tune(&experts, "2");
        let again = folder.path().join(format!("{backbone}-again"));
        tune(&again, "1");
        let weights = |dir: &Path| {
            sage_backbones::Parameters::load(&dir.join("adversarial.safetensors")).unwrap().0.hash().unwrap()
        };
        assert_eq!(weights(&experts), weights(&again), "bits depend on the number of threads");
        let scene = example();
        let arguments =
            ["generate", &scene, "--weights", text(&experts), "--lambda", "0.5", "--out", text(&out)];
        assert!(stdout(&sage(&arguments)).starts_with("crossing: "));
        // Experts of one prior do not go with another.
        let other = folder.path().join(format!("{backbone}-other"));
        std::fs::create_dir(&other).unwrap();
        for file in ["realistic.safetensors", "adversarial.safetensors"] {
            std::fs::copy(experts.join(file), other.join(file)).unwrap();
        }
        let stranger = folder.path().join(format!("{backbone}-stranger"));
        let arguments = [
            "pretrain",
            "--backbone",
            backbone,
            "--network",
            small,
            "--made",
            "2",
            "--epochs",
            "1",
            "--seed",
            "3",
            "--out",
            text(&stranger),
        ];
        stdout(&sage(&arguments));
        std::fs::copy(stranger.join("prior.safetensors"), other.join("prior.safetensors")).unwrap();
        let error = failure(&[
            "generate",
            &scene,
            "--weights",
            text(&other),
            "--out",
            text(&folder.path().join("x")),
        ]);
        assert!(
            error.contains("the realistic expert") && error.contains("tuned from another one"),
            "{error}"
        );
    }
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
    for method in [
        "sage 0.00",
        "sage 1.00",
        "prior, choice 1.00",
        "most likely 1.00",
        "random goals, choice 1.00",
        "oracle, choice 1.00",
        "cat",
        "rule",
        "log",
    ] {
        assert!(table.contains(&format!("| {method} | 3 |")), "{method}: {table}");
    }
    assert!(table.contains("Without choice, expectations under the policy"));
    for file in ["table.md", "table.csv", "scenes.csv", "run.json", "index.html", "00-strongest.svg"] {
        assert!(out.join(file).is_file(), "{file}");
    }
    let csv = std::fs::read_to_string(out.join("table.csv")).unwrap();
    assert!(csv.starts_with("method,measure,value,low,high,n\n") && csv.contains("sage 1.00,attack,"));
    let page = std::fs::read_to_string(out.join("index.html")).unwrap();
    assert!(page.contains("<img src=\"00-strongest.svg\"") && !out.join(".sage-rows").exists());

    // A run that was broken off goes on: what was kept is read, the rest is run.
    let run = out.join("run.json");
    let mut record: Value = serde_json::from_str(&std::fs::read_to_string(&run).unwrap()).unwrap();
    record["seconds"] = Value::Null;
    std::fs::write(&run, record.to_string()).unwrap();
    std::fs::create_dir(out.join(".sage-rows")).unwrap();
    let kept = r#"{"method": "sage 0.00", "rows": [], "errors": []}"#;
    std::fs::write(out.join(".sage-rows/000.json"), kept).unwrap();
    std::fs::write(out.join(".sage-rows/001.json"), "cut off").unwrap();
    let again = sage(&[&arguments[..], &WEIGHTS].concat());
    assert!(stdout(&again).contains("| sage 0.00 | 0 |") && stderr(&again).contains("it goes on"));
    assert!(stdout(&again).contains("| sage 1.00 | 3 |"));
    let error = failure(&[&arguments[..], &WEIGHTS].concat());
    assert!(error.contains("is not empty; give --force"), "a finished run is not gone on with: {error}");
}

#[test]
fn one_dial_is_even_refitted_and_kept_beside_its_experts() {
    let folder = tempfile::tempdir().unwrap();
    let scene = example();
    let out = folder.path().join("out");
    let arguments = ["generate", &scene, "--aggression", "0:1:0.5", "--json", "--out", text(&out)];
    let output = sage(&[&arguments[..], &WEIGHTS].concat());
    let rows: Vec<Value> = stdout(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(rows.len(), 3);
    for (row, a) in rows.iter().zip([0.0, 0.5, 1.0]) {
        assert_eq!((row["aggression"].as_f64(), row["lambda"].as_f64()), (Some(a), Some(a)));
    }
    assert_eq!((rows[0]["mu"].as_f64(), rows[2]["mu"].as_f64()), (Some(0.0), Some(1.0)));
    assert!(out.join("crossing-a0.50.pkl").is_file());
    let both = ["generate", &scene, "--aggression", "1", "--lambda", "1", "--out", "x"];
    assert_eq!(sage(&both).status.code(), Some(2));

    let experts = folder.path().join("experts");
    std::fs::create_dir(&experts).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    for file in ["prior", "realistic", "adversarial"].map(|name| format!("{name}.safetensors")) {
        std::fs::copy(shipped.join(&file), experts.join(&file)).unwrap();
    }
    let other = folder.path().join("other");
    let generate =
        ["generate", &scene, "--weights", text(&experts), "--aggression", "0.3", "--out", text(&other)];
    assert!(failure(&generate).contains("`sage calibrate` fits one"));
    let dial = experts.join("dial.json");
    let calibrate = [
        "calibrate",
        "--made",
        "8",
        "--weights",
        text(&experts),
        "--choice",
        "natural",
        "--out",
        text(&dial),
    ];
    let output = sage(&calibrate);
    assert!(output.status.success(), "{}", stderr(&output));
    stdout(&sage(&generate));
    assert!(failure(&calibrate).contains("exists"));

    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "4", "--out", text(&scenes)]));
    let report = folder.path().join("dial");
    let output = sage(&["bench", "dial", text(&scenes), "--weights", text(&experts), "--out", text(&report)]);
    assert!(stdout(&output).contains("Shapley share of lambda"), "{}", stdout(&output));
    for file in ["dial.md", "dial.csv", "dial.svg", "run.json"] {
        assert!(report.join(file).is_file(), "{file}");
    }
}

#[test]
fn a_broken_off_fine_tuning_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("quick.json");
    std::fs::write(&config, r#"{"epochs": 3, "candidates": 16}"#).unwrap();
    let tune = |out: &Path| {
        let arguments =
            ["finetune", "--made", "4", "--roles", "1", "--config", text(&config), "--out", text(out)];
        Command::new(env!("CARGO_BIN_EXE_sage")).args(arguments).env_remove("SAGE_WEIGHTS").spawn().unwrap()
    };
    let [whole, broken] = ["whole", "broken"].map(|name| folder.path().join(name));
    assert!(tune(&whole).wait().unwrap().success());
    let mut child = tune(&broken);
    // Killed as soon as the first expert has a state to go on from.
    while !broken.join("realistic.state").exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let _ = child.kill();
    child.wait().unwrap();
    assert!(tune(&broken).wait().unwrap().success());
    for expert in ["realistic", "adversarial"] {
        let [a, b] = [&whole, &broken].map(|dir| {
            let file = dir.join(format!("{expert}.safetensors"));
            sage_backbones::Parameters::load(&file).unwrap().0.hash().unwrap()
        });
        assert_eq!(a, b, "{expert}");
    }
    let table = |dir: &Path| std::fs::read_to_string(dir.join("finetune.csv")).unwrap().lines().count();
    assert_eq!((table(&whole), table(&broken)), (7, 7));
}

#[test]
fn a_generator_of_ones_own_runs_like_the_shipped_ones() {
    let program = Path::new(env!("CARGO_BIN_EXE_sage")).with_file_name("examples").join("own_generator");
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let output = Command::new(&program).args(arguments).env_remove("SAGE_WEIGHTS").output().unwrap();
        stdout(&output).to_owned()
    };
    assert!(run(&["list"]).contains("brakes straight on"));
    let (scene, out) = (example(), folder.path().join("out"));
    let generate = ["generate", &scene, "--method", "brake", "--lambda", "0,1", "--out", text(&out)];
    assert_eq!(run(&[&generate[..], &WEIGHTS].concat()).lines().count(), 2);
    assert!(out.join("crossing-1.00.pkl").is_file());
}

#[test]
fn nothing_is_lost_where_names_meet() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    stdout(&sage(&["scenes", "--count", "2", "--out", text(&scenes)]));
    let files = |dir: &Path| std::fs::read_dir(dir).unwrap().count();
    let before = files(&scenes);
    let over = ["generate", text(&scenes), "--force", "--out", text(&scenes)];
    assert!(failure(&[&over[..], &WEIGHTS].concat()).contains("could be overwritten"));
    let twins = folder.path().join("twins");
    for side in ["a", "b"] {
        std::fs::create_dir_all(twins.join(side)).unwrap();
        std::fs::copy(example(), twins.join(side).join("s.pkl")).unwrap();
    }
    let out = folder.path().join("out");
    let both = ["generate", text(&twins), "--out", text(&out)];
    assert!(failure(&[&both[..], &WEIGHTS].concat()).contains("would become one file"));
    assert_eq!(files(&scenes), before);
    // Places that two digits do not tell apart have files of their own.
    let scene = example();
    let near = ["generate", &scene, "--lambda", "0.501,0.502", "--out", text(&out)];
    stdout(&sage(&[&near[..], &WEIGHTS].concat()));
    assert!(out.join("crossing-0.501.pkl").is_file() && out.join("crossing-0.502.pkl").is_file());
    // What comes out of a made scene goes in again.
    let attacked = folder.path().join("attacked");
    let generate = ["generate", text(&scenes), "--out", text(&attacked)];
    stdout(&sage(&[&generate[..], &WEIGHTS].concat()));
    for entry in std::fs::read_dir(&attacked).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|ending| ending == "safetensors") {
            let made = Recording::read(&path).unwrap();
            assert!(made.scene.notes.iter().any(|note| note.contains("sage_provenance")), "{path:?}");
            assert!(made.to_pickle().is_ok() && made.to_native().is_ok(), "{path:?}");
        }
    }
}

#[test]
fn what_can_fail_at_once_fails_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("config.json");
    let out = folder.path().join("out");
    let tune = ["finetune", "--made", "2", "--config", text(&config), "--out", text(&out)];
    for (wrong, why) in [
        (r#"{"epoch": 1}"#, "unknown field `epoch`"),
        (r#"{"seed": 1}"#, "`seed` is given by --seed"),
        (r#"{"epochs": 0}"#, "epochs"),
    ] {
        std::fs::write(&config, wrong).unwrap();
        assert!(failure(&tune).contains(why), "{wrong}");
        assert!(!out.exists(), "nothing was begun");
    }
    let far = folder.path().join("no/dial.json");
    assert!(failure(&["calibrate", "--made", "2", "--out", text(&far)]).contains("make it first"));
    let error = failure(&["calibrate", "--made", "0", "--out", text(&folder.path().join("d.json"))]);
    assert!(error.contains("none of 0 scenes"), "{error}");
    let scene = example();
    let raw = ["bench", "open-loop", &scene, "--methods", "log", "--raw", "--out", text(&out)];
    assert!(failure(&[&raw[..], &WEIGHTS].concat()).contains("--raw is for the method `rule`"));
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural/adversarial.safetensors");
    let error = failure(&["generate", &scene, "--weights", text(&shipped), "--out", text(&out)]);
    assert!(error.contains("is the adversarial expert of a prior, no prior"), "{error}");
}
