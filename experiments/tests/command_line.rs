//! The real binary on the shipped scene: output, streams and exit codes.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use clap::CommandFactory;
use insta::assert_snapshot;
use program::{BAD_SCENES, messages, redacted};
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
    assert_snapshot!(stdout(&run), @r"
    scene              frames vehicles others  ego        adversary  future  warnings
    crossing               91        4      1  ego        crosser     80/80  one-point-lanes
        has edges, lights, speed limits, heights, sizes; not recorded: medians
        one-point-lanes: 1 lane has a single point
    1 scene, 5 tracks, 963 map points; warnings: 1 one-point-lanes
    ");

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
    // The totals go to stderr.
    assert_snapshot!(stderr(&run), @"1 scene, 5 tracks, 963 map points; warnings: 1 one-point-lanes");
}

#[test]
fn a_folder_with_a_broken_file_is_read_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(example("crossing.pkl"), folder.path().join("2.pkl")).unwrap();
    std::fs::copy(example("crossing.pkl"), folder.path().join("10.pkl")).unwrap();
    std::fs::write(folder.path().join("1.pkl"), b"\x80\x04cos\nsystem\n.").unwrap();
    for threads in ["1", "2"] {
        let run = sage(&["inspect", path(folder.path()), "--json", "--threads", threads]);
        assert_eq!(run.status.code(), Some(BAD_SCENES));
        insta::allow_duplicates! { assert_snapshot!(redacted(stderr(&run)), @r"
        error: `[folder]/1.pkl` at byte 2: global `os.system` is not allowed in a scene file; nothing was imported or run
        2 scenes, 10 tracks, 1926 map points, 1 file not read; warnings: 1 duplicate, 2 one-point-lanes
        ") };
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
    assert_snapshot!("scores_of_candidates", stdout(&sage(&arguments[..4])));
}

#[test]
fn roles_can_be_named() {
    let (scene, candidates) = (example("crossing.pkl"), example("crossing.json"));
    let run =
        |extra: &[&str]| sage(&[&["score", path(&scene), "--candidates", path(&candidates)], extra].concat());
    assert!(run(&["--adversary", "leader"]).status.success());
    let missing = run(&["--adversary", "nobody"]);
    assert_eq!(missing.status.code(), Some(1));
    let same = run(&["--ego", "crosser", "--adversary", "crosser"]);
    assert_eq!(same.status.code(), Some(1));
    // For a new ego the adversary is selected by conflict, and a note is printed.
    let turned = run(&["--ego", "crosser"]);
    assert!(turned.status.success());
    let said = [
        ("--adversary nobody", &missing),
        ("--ego and --adversary crosser", &same),
        ("--ego crosser", &turned),
    ];
    assert_snapshot!("roles_of_named_tracks", messages(said.map(|(roles, run)| (roles, stderr(run)))));
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
    let cases = [
        ("nothing", String::new()),
        ("no trajectory", r#"[{"name": "a"}]"#.into()),
        ("an unknown field", r#"[{"name": "a", "trajectory": [], "colour": 1}]"#.into()),
        ("79 points", format!(r#"[{{"name": "a", "trajectory": {}}}]"#, path(79))),
        ("1e300", format!(r#"[{{"name": "a", "trajectory": {}}}]"#, path(80).replacen("0.0", "1e300", 1))),
        ("one coordinate", format!(r#"[{{"name": "a", "trajectory": {}, "ego": [[0.0]]}}]"#, path(80))),
    ];
    let said = cases.map(|(name, text)| {
        let run = score_text(&text);
        assert_eq!(run.status.code(), Some(1), "{text}");
        (name, stderr(&run).to_owned())
    });
    assert_snapshot!("bad_candidates", messages(said));
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
    assert_snapshot!("list", stdout(&sage(&["list"])));
}

/// Words of every command, `sage` itself included.
fn commands() -> Vec<Vec<String>> {
    let mut open = vec![(Vec::new(), experiments::Cli::command())];
    let mut found = Vec::new();
    while let Some((words, command)) = open.pop() {
        let under = |sub: &clap::Command| ([&words[..], &[sub.get_name().to_owned()]].concat(), sub.clone());
        open.extend(command.get_subcommands().map(under));
        found.push(words);
    }
    found
}

/// A help text in a terminal of some width, as far as COLUMNS says.
fn help(words: &[&str], columns: &str) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_sage")).args(words).env("COLUMNS", columns).output().unwrap();
    assert!(run.status.success(), "{words:?}: {}", stderr(&run));
    stdout(&run).to_owned()
}

#[test]
fn every_command_has_a_help_text_of_at_most_100_columns() {
    let all = commands();
    assert!(all.len() > 25, "{all:?}");
    for command in &all {
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let [long, short] = ["--help", "-h"].map(|option| help(&[&words[..], &[option]].concat(), "300"));
        for line in long.lines().chain(short.lines()) {
            assert!(line.chars().count() <= 100, "{words:?}: {line}");
        }
        assert_eq!(help(&[&["help"], &words[..]].concat(), "100"), long, "{words:?}");
        // `docs/reference/commands.md` holds all options.
        if words == ["search"] {
            assert_snapshot!("help_of_search", long);
        }
    }
}

#[test]
fn completions_and_exit_codes() {
    assert!(stdout(&sage(&["completions", "bash"])).contains("_sage"));
    let wrong: [(&[&str], i32); 3] =
        [(&["inspekt"], 2), (&["inspect"], 2), (&["inspect", "/nonexistent/scene.pkl"], BAD_SCENES)];
    let said = wrong.map(|(command, code)| {
        let run = sage(command);
        assert_eq!(run.status.code(), Some(code), "{command:?}");
        (command.join(" "), stderr(&run).to_owned())
    });
    assert_snapshot!("wrong_commands", messages(said));
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
    assert!(sage(&[&arguments[..], &["--force", "--frame", "40"]].concat()).status.success());
    let beyond = sage(&["draw", path(&scene), "--out", "-", "--frame", "91"]);
    let said = [("a picture that exists", stderr(&again)), ("--frame 91", stderr(&beyond))];
    assert_snapshot!("refused_pictures", messages(said));
    assert!(stdout(&sage(&["draw", path(&scene), "--out", "-"])).starts_with("<svg "));
}

#[test]
fn the_demo_attacks_every_kind_of_scene_and_the_rate_rises_with_aggression() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo");
    let run = sage(&["demo", "--out", path(&out)]);
    assert!(run.status.success(), "{}", stderr(&run));
    let table: Vec<&str> =
        stdout(&run).lines().filter(|line| line.starts_with("| 0.") || line.starts_with("| 1.")).collect();
    assert_eq!(table.len(), 5, "{}", stdout(&run));
    let attacked = |row: &str| -> u32 {
        row.split('|').nth(3).unwrap().split_whitespace().next().unwrap().parse().unwrap()
    };
    let rates: Vec<u32> = table.iter().map(|row| attacked(row)).collect();
    assert!(
        rates.is_sorted() && rates[4] >= rates[0] + 20,
        "the attack rate rises with aggression: {rates:?}"
    );
    for (number, kind) in
        ["straight", "curve", "merge", "four-way", "t-junction", "roundabout", "divided"].iter().enumerate()
    {
        let name = format!("{kind}-1-{number}");
        assert!(out.join(format!("scenes/{name}.safetensors")).is_file());
        for ending in ["html", "svg"] {
            assert!(out.join(format!("attacks/{name}.{ending}")).is_file());
        }
    }
    assert!(out.join("attacks/index.html").is_file());
    assert!(stderr(&run).contains("attacks/index.html"), "it ends with the page to open: {}", stderr(&run));
    let again = sage(&["demo", "--out", path(&out)]);
    assert_eq!(again.status.code(), Some(1));
    assert_snapshot!(redacted(stderr(&again)), @"error: `[folder]/demo` is not empty; give --force to write into it anyway");
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
    assert_eq!(run.status.code(), Some(BAD_SCENES), "one file is not a scene");
    let partly = stderr(&run).to_owned();
    let run = sage(&["convert", path(&native), "--to", "pickle", "--out", path(&back)]);
    assert!(run.status.success(), "{}", stderr(&run));
    let inspect = |file: &Path| stdout(&sage(&["inspect", path(file), "--json"])).to_owned();
    let (first, again) = (inspect(&source.join("part/a.pkl")), inspect(&back.join("part/a.pkl")));
    assert_eq!(first, again);
    assert_eq!(first, inspect(&native.join("part/a.safetensors")));
    let twice = sage(&["convert", path(&source), "--to", "native", "--out", path(&native)]);
    let other = sage(&["convert", path(&source), "--to", "pickle", "--out", path(&native)]);
    let said = [
        ("a file that is no scene", &*partly),
        ("the same again", stderr(&twice)),
        ("another format", stderr(&other)),
    ];
    assert_snapshot!("what_convert_says", messages(said));
}
