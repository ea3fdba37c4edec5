//! The real binary on the shipped scene: output, streams and exit codes.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use serde_json::Value;

fn example(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples").join(name)
}

fn sage(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sage")).args(arguments).output().unwrap()
}

fn path(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).unwrap()
}

fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).unwrap()
}

fn rows(output: &Output) -> Vec<Value> {
    stdout(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn inspect_shows_a_scene() {
    let run = sage(&["inspect", path(&example("crossing.pkl"))]);
    assert!(run.status.success());
    let text = stdout(&run);
    assert!(
        text.contains("crosser") && text.contains("one-point-lanes: 1 lane has a single point"),
        "{text}"
    );
    assert!(text.ends_with("1 scene, 5 tracks, 963 map points; warnings: 1 one-point-lanes\n"), "{text}");

    let run = sage(&["inspect", path(&example("crossing.pkl")), "--json"]);
    let row = &rows(&run)[0];
    for (key, value) in [
        ("scene", Value::from("crossing")),
        ("id", "crossing".into()),
        ("frames", 91.into()),
        ("map_features", 12.into()),
        ("map_points", 963.into()),
        ("lights", 1.into()),
        ("ego", "ego".into()),
        ("adversary", "crosser".into()),
        ("adversary_history", 11.into()),
        ("adversary_future", 80.into()),
    ] {
        assert_eq!(row[key], value, "{key}");
    }
    assert_eq!(row["tracks"]["VEHICLE"], 4);
    assert!(stderr(&run).starts_with("1 scene, "), "the totals go to stderr");
}

#[test]
fn a_folder_with_a_broken_file_is_read_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(example("crossing.pkl"), folder.path().join("2.pkl")).unwrap();
    std::fs::copy(example("crossing.pkl"), folder.path().join("10.pkl")).unwrap();
    std::fs::write(folder.path().join("1.pkl"), b"\x80\x04cos\nsystem\n.").unwrap();
    for threads in ["1", "2"] {
        let run = sage(&["inspect", path(folder.path()), "--json", "--threads", threads]);
        assert_eq!(run.status.code(), Some(1));
        assert!(
            stderr(&run).contains("1.pkl` at byte 2: global `os.system` is not allowed"),
            "{}",
            stderr(&run)
        );
        let rows = rows(&run);
        let scenes: Vec<&str> = rows.iter().map(|row| row["scene"].as_str().unwrap()).collect();
        assert_eq!(scenes, ["1", "2", "10"]);
        assert!(rows[0]["error"].as_str().unwrap().contains("os.system"));
        assert_eq!(rows[2]["warnings"][1], "duplicate: same content as scene 2");
    }
}

#[test]
fn score_gives_every_measure() {
    let (scene, candidates) = (example("crossing.pkl"), example("crossing.json"));
    let arguments = ["score", path(&scene), "--candidates", path(&candidates), "--json"];
    for convention in ["paper", "release"] {
        let run = sage(&[&arguments[..], &["--convention", convention]].concat());
        assert!(run.status.success(), "{}", stderr(&run));
        let rows = rows(&run);
        assert_eq!(rows.len(), 5);
        for key in [
            "name",
            "adversarial_reward",
            "collision",
            "collision_step",
            "kinematic_penalty",
            "behavior_penalty",
            "cross_line",
            "crash_object",
            "feasible",
            "feasible_drivable",
            "violations",
            "wd_speed",
            "wd_acceleration",
            "wd_yaw_rate",
            "time_to_collision",
            "post_encroachment_time",
            "required_deceleration",
            "impact_speed",
            "side_hit",
        ] {
            assert!(rows.iter().all(|row| row.get(key).is_some()), "{convention} {key}");
        }
        let [log, meet, _, kerb, _] = &rows[..] else { panic!() };
        assert_eq!((&log["collision"], &log["collision_step"]), (&false.into(), &Value::Null));
        assert_eq!((&meet["collision"], &meet["collision_step"]), (&true.into(), &29.into()));
        // 10 (1 − 29/80), and 10 (1 − 28/80) where steps count from 0.
        let reward = if convention == "paper" { 6.375 } else { 6.5 };
        assert!((meet["adversarial_reward"].as_f64().unwrap() - reward).abs() < 1e-12);
        assert_eq!((&kerb["cross_line"], &kerb["feasible"]), (&50.0.into(), &false.into()));
        assert_eq!(kerb["violations"][0]["rule"], "road_edge");
    }
    let wide = sage(&[&arguments[..], &["--sizes", "metadrive"]].concat());
    assert!(wide.status.success());
    assert_ne!(stdout(&wide), stdout(&sage(&arguments)));
    let table = sage(&arguments[..4]);
    assert!(stdout(&table).contains("road edge edge0 at step 27"), "{}", stdout(&table));
}

#[test]
fn roles_can_be_named() {
    let (scene, candidates) = (example("crossing.pkl"), example("crossing.json"));
    let run =
        |extra: &[&str]| sage(&[&["score", path(&scene), "--candidates", path(&candidates)], extra].concat());
    assert!(run(&["--adversary", "leader"]).status.success());
    let missing = run(&["--adversary", "nobody"]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(stderr(&missing).contains("no track `nobody`"), "{}", stderr(&missing));
    let same = run(&["--ego", "crosser", "--adversary", "crosser"]);
    assert!(stderr(&same).contains("cannot be ego and adversary at once"), "{}", stderr(&same));
    // For a new ego the adversary is selected by conflict, and a note is printed.
    let turned = run(&["--ego", "crosser"]);
    assert!(
        turned.status.success() && stderr(&turned).contains("was selected because its logged path conflicts")
    );
}

/// Runs `score` with candidates on standard input.
fn score_text(text: &str) -> Output {
    let scene = example("crossing.pkl");
    let mut child = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(["score", path(&scene), "--candidates", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

#[test]
fn bad_candidates_are_named() {
    let path = |n: usize| serde_json::to_string(&vec![[0.0, 0.0]; n]).unwrap();
    for (text, expected) in [
        (String::new(), "is not a JSON list"),
        (r#"[{"name": "a"}]"#.into(), "missing field `trajectory`"),
        (r#"[{"name": "a", "trajectory": [], "colour": 1}]"#.into(), "unknown field `colour`"),
        (
            format!(r#"[{{"name": "a", "trajectory": {}}}]"#, path(79)),
            "candidate 0 `a`: `trajectory`: 79 points, expected 80",
        ),
        (
            format!(r#"[{{"name": "a", "trajectory": {}}}]"#, path(80).replacen("0.0", "1e300", 1)),
            "point 0 is [1",
        ),
        (
            format!(r#"[{{"name": "a", "trajectory": {}, "ego": [[0.0]]}}]"#, path(80)),
            "`ego` row 0 has 1 numbers; expected [x, y]",
        ),
    ] {
        let run = score_text(&text);
        assert_eq!(run.status.code(), Some(1), "{text}");
        assert!(stderr(&run).contains(expected), "{}", stderr(&run));
        assert!(!stderr(&run).contains("panicked"));
    }
}

#[test]
fn the_registries_are_listed() {
    let run = sage(&["list", "--json"]);
    let names: Vec<(String, String)> = rows(&run)
        .iter()
        .map(|row| (row["kind"].as_str().unwrap().to_owned(), row["name"].as_str().unwrap().to_owned()))
        .collect();
    for (kind, name) in [
        ("reward", "adversarial"),
        ("reward", "realism"),
        ("feasibility", "paper"),
        ("feasibility", "drivable"),
    ] {
        assert!(names.contains(&(kind.into(), name.into())), "{names:?}");
    }
    let list = sage(&["list"]);
    assert!(stdout(&list).contains("options: height_gap = 3.0"));
    assert!(
        stdout(&list).contains("most likely goal, without selection (knows history only)"),
        "{}",
        stdout(&list)
    );
    assert!(stdout(&list).contains("(knows ego's path, others' log)"));
}

#[test]
fn help_completions_and_exit_codes() {
    for command in ["demo", "inspect", "draw", "score", "convert", "scenes", "list", "completions"] {
        let help = sage(&[command, "--help"]);
        assert!(help.status.success() && stdout(&help).contains("Example"), "{command}");
    }
    assert!(stdout(&sage(&["bench", "speed", "--help"])).contains("Example"));
    assert!(stdout(&sage(&["completions", "bash"])).contains("_sage"));
    assert_eq!(sage(&["inspekt"]).status.code(), Some(2));
    assert_eq!(sage(&["inspect"]).status.code(), Some(2));
    assert_eq!(sage(&["inspect", "/nonexistent/scene.pkl"]).status.code(), Some(1));
}

#[test]
fn bench_speed_measures_without_any_data() {
    let run = sage(&["bench", "speed", "--repeat", "1", "--json"]);
    assert!(run.status.success(), "{}", stderr(&run));
    let rows = rows(&run);
    assert!(rows.iter().any(|row| row["name"].as_str().unwrap().contains("32 candidates")));
    assert!(rows.iter().all(|row| row["median_ms"].as_f64().is_some_and(|ms| ms > 0.0)), "{rows:?}");
}

#[test]
fn draw_writes_a_picture_and_overwrites_only_with_force() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("crossing.svg");
    let (scene, candidates) = (example("crossing.pkl"), example("crossing.json"));
    let arguments = ["draw", path(&scene), "--candidates", path(&candidates), "--out", path(&picture)];
    let run = sage(&arguments);
    assert!(run.status.success(), "{}", stderr(&run));
    let text = std::fs::read_to_string(&picture).unwrap();
    for part in [
        "<svg ",
        "ego ego",
        "adversary crosser",
        "slow to meet: hit 2.9 s",
        "first contact",
        "road edge",
        "20 m",
        "</svg>",
    ] {
        assert!(text.contains(part), "{part}");
    }
    assert!(text.len() < 800_000);
    let again = sage(&arguments);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("exists; give --force"), "{}", stderr(&again));
    assert!(sage(&[&arguments[..], &["--force", "--frame", "40"]].concat()).status.success());
    let beyond = sage(&["draw", path(&scene), "--out", "-", "--frame", "91"]);
    assert!(stderr(&beyond).contains("has no frame 91; its last is 90"), "{}", stderr(&beyond));
    assert!(stdout(&sage(&["draw", path(&scene), "--out", "-"])).starts_with("<svg "));
}

#[test]
fn demo_writes_scenes_attacks_and_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo");
    let run = sage(&["demo", "--out", path(&out)]);
    assert!(run.status.success(), "{}", stderr(&run));
    assert_eq!(stdout(&run).lines().count(), 6, "a head and five lambdas");
    let hits = |line: &str| -> f64 {
        line.split_whitespace().nth(1).unwrap().trim_end_matches('%').parse().unwrap()
    };
    let lines: Vec<&str> = stdout(&run).lines().collect();
    assert!(
        hits(lines[5]) >= hits(lines[1]) + 40.0,
        "the attack rate rises with aggression: {}",
        stdout(&run)
    );
    for kind in ["straight", "curve", "merge", "four-way", "t-junction", "roundabout", "divided"] {
        assert!(lines[0].contains(kind));
        assert!(
            out.join(format!("{kind}-1-0.svg")).is_file()
                && out.join(format!("{kind}-1-0.safetensors")).is_file()
                && out.join(format!("{kind}-1-0-attacked.pkl")).is_file()
        );
    }
    let again = sage(&["demo", "--out", path(&out)]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("is not empty; give --force"), "{}", stderr(&again));
    assert_eq!(stdout(&sage(&["demo", "--out", path(&out), "--force"])), stdout(&run));
}

#[test]
fn scenes_are_the_same_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let make = |name: &str, threads: &str| {
        let out = folder.path().join(name);
        let run =
            sage(&["scenes", "--count", "12", "--seed", "9", "--out", path(&out), "--threads", threads]);
        assert!(run.status.success(), "{}", stderr(&run));
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files.iter().map(|file| std::fs::read(file).unwrap()).collect::<Vec<_>>()
    };
    let one = make("one", "1");
    assert_eq!(one.len(), 12);
    assert!(one == make("two", "2"), "bits differ");
}

#[test]
fn convert_is_lossless_in_both_directions_and_keeps_folders() {
    let folder = tempfile::tempdir().unwrap();
    let (source, native, back) =
        (folder.path().join("in"), folder.path().join("native"), folder.path().join("back"));
    std::fs::create_dir_all(source.join("part")).unwrap();
    std::fs::copy(example("crossing.pkl"), source.join("part/a.pkl")).unwrap();
    std::fs::write(source.join("b.pkl"), b"no scene").unwrap();
    let run = sage(&["convert", path(&source), "--to", "native", "--out", path(&native)]);
    assert_eq!(run.status.code(), Some(1), "one file is not a scene");
    assert!(stderr(&run).contains("b.pkl") && stderr(&run).contains("1 scene in"), "{}", stderr(&run));
    let run = sage(&["convert", path(&native), "--to", "pickle", "--out", path(&back)]);
    assert!(run.status.success(), "{}", stderr(&run));
    let inspect = |file: &Path| stdout(&sage(&["inspect", path(file), "--json"])).to_owned();
    let (first, again) = (inspect(&source.join("part/a.pkl")), inspect(&back.join("part/a.pkl")));
    assert_eq!(first, again);
    assert_eq!(first, inspect(&native.join("part/a.safetensors")));
    let twice = sage(&["convert", path(&source), "--to", "native", "--out", path(&native)]);
    assert!(stderr(&twice).contains("unfinished; it resumes"), "{}", stderr(&twice));
    let other = sage(&["convert", path(&source), "--to", "pickle", "--out", path(&native)]);
    assert!(stderr(&other).contains("is not empty"), "{}", stderr(&other));
}
