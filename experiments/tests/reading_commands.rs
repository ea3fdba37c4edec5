//! Recordings of other lengths, rates and quality through the commands: what is said, and what is written.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::path::{Path, PathBuf};

use insta::assert_snapshot;
use program::*;
use sage_core::{motion::NOW, scene::Scene};
use sage_data::Recording;
use serde_json::Value;

/// The example with another content, as a pickle.
fn made(folder: &Path, name: &str, change: impl FnOnce(&mut Scene)) -> PathBuf {
    let mut scene = Recording::read(Path::new(&example())).unwrap().scene;
    scene.id = name.to_owned();
    scene.notes.clear();
    change(&mut scene);
    let path = folder.join(format!("{name}.pkl"));
    std::fs::write(&path, Recording::procedural(scene).to_pickle().unwrap()).unwrap();
    path
}

/// Frames of a scene by index; an index may occur twice.
fn frames(scene: &mut Scene, indices: &[usize], step: f64) {
    for track in &mut scene.tracks {
        track.position = indices.iter().map(|f| track.position[*f]).collect();
        track.heading = indices.iter().map(|f| track.heading[*f]).collect();
        track.velocity = indices.iter().map(|f| track.velocity[*f]).collect();
        track.size = indices.iter().map(|f| track.size[*f]).collect();
        track.valid = indices.iter().map(|f| track.valid[*f]).collect();
    }
    for light in &mut scene.lights {
        light.states = indices.iter().map(|f| light.states[*f]).collect();
    }
    scene.frames = indices.len();
    scene.timestamps = (0..indices.len()).map(|f| f as f64 * step).collect();
}

fn first(count: usize) -> impl FnOnce(&mut Scene) {
    move |scene| frames(scene, &(0..count).collect::<Vec<_>>(), 0.1)
}

/// Moves the adversary onto the ego's side.
fn beside_now(scene: &mut Scene) {
    let (ego, adversary) = (scene.ego, scene.adversary.unwrap());
    let ([x, y], [a, b]) = (scene.tracks[ego].point(NOW), scene.tracks[adversary].point(NOW));
    for position in &mut scene.tracks[adversary].position {
        position[0] += x - a + 1.5;
        position[1] += y - b;
    }
}

fn row(out: &Path, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(out.join(name)).unwrap()).unwrap()
}

#[test]
fn a_short_recording_is_attacked_over_what_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let scene = made(folder.path(), "short", first(50));
    let out = folder.path().join("out");
    let run = sage(
        &[&["generate", text(&scene), "--format", "native", "--out", text(&out)][..], &WEIGHTS].concat(),
    );
    assert!(run.status.success(), "{}", stderr(&run));
    assert_snapshot!(redacted(stderr(&run)), @r"
    note: weights `procedural` (network densetnt)
    warning: short: short-recording: it ends at frame 49: attacks are scored over 3.9 s instead of 8 s
    warnings that may change results: 1 scene short-recording; `sage inspect` says all
    1 scene, 1 attempt in `[folder]/out` ([time])
    to look at the attacks, open `[folder]/out/index.html`
    ");
    let row = row(&out, "short-lambda1.00.json");
    assert_eq!((&row["scores"]["horizon"], row["trajectory"].as_array().unwrap().len()), (&39.into(), 80));
    assert!(row["scores"]["collision_step"].as_u64().is_none_or(|step| step <= 39));
    let written = Recording::read(&out.join("short-lambda1.00.safetensors")).unwrap().scene;
    assert_eq!((written.frames, written.horizon()), (50, 39));
    let drives = folder.path().join("drives");
    let run = sage(&["simulate", text(&scene), "--ego", "idm,replay", "--out", text(&drives)]);
    assert!(run.status.success(), "{}", stderr(&run));
    let row = self::row(&drives, "short-replay.json");
    assert_eq!((&row["horizon"], &row["steps"]), (&39.into(), &49.into()));
    assert!((row["completion"].as_f64().unwrap() - 1.0).abs() < 0.05);
}

#[test]
fn eleven_frames_are_predicted_drawn_and_driven_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let scene = made(folder.path(), "history", first(11));
    let [picture, drives, attacked, logged, driven] =
        ["history.svg", "drives", "attacked", "logged", "driven"].map(|name| folder.path().join(name));
    let works: [&[&str]; 3] = [
        &["predict", text(&scene), "--k", "2", "--weights", "procedural"],
        &["draw", text(&scene), "--out", text(&picture)],
        &["simulate", text(&scene), "--ego", "idm,constant-speed", "--out", text(&drives)],
    ];
    for arguments in works {
        let run = sage(arguments);
        assert!(run.status.success(), "{arguments:?}: {}", stderr(&run));
    }
    let fails: [&[&str]; 3] = [
        &["generate", text(&scene), "--weights", "procedural", "--out", text(&attacked)],
        &["generate", text(&scene), "--method", "log", "--out", text(&logged)],
        &["simulate", text(&scene), "--ego", "idm", "--method", "rule", "--out", text(&driven)],
    ];
    let said = fails.map(|arguments| (arguments.join(" "), failure(arguments)));
    assert_snapshot!("commands_that_need_a_future", messages(said));
}

#[test]
fn another_frame_rate_is_said_and_converted_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    // Each frame twice would be 20 Hz that stands still every second frame: linear motion in between.
    let scene = made(folder.path(), "fast", |scene| {
        let old = scene.clone();
        frames(scene, &(0..181).map(|f| f / 2).collect::<Vec<_>>(), 0.05);
        for (track, old) in scene.tracks.iter_mut().zip(&old.tracks) {
            for frame in (1..181).step_by(2) {
                let (a, b) = (old.position[frame / 2], old.position[frame / 2 + 1]);
                track.position[frame] = [0, 1, 2].map(|k| 0.5 * (a[k] + b[k]));
                track.valid[frame] = old.valid[frame / 2] && old.valid[frame / 2 + 1];
            }
        }
    });
    let out = folder.path().join("out");
    let arguments = ["generate", text(&scene), "--lambda", "1", "--format", "pickle", "--out", text(&out)];
    let run = sage(&[&arguments[..], &WEIGHTS].concat());
    assert!(run.status.success());
    assert_snapshot!(redacted(stderr(&run)), @r"
    note: weights `procedural` (network densetnt)
    warning: fast: frame-rate: recorded at 20 Hz; resampled to 10 Hz
    warnings that may change results: 1 scene frame-rate; `sage inspect` says all
    1 scene, 1 attempt in `[folder]/out` ([time])
    to look at the attacks, open `[folder]/out/index.html`
    ");
    let written = sage_data::folder::scene_files(&out).unwrap();
    assert_eq!(Recording::read(&written[0]).unwrap().scene.frames, 91);
    let back = folder.path().join("back");
    let run = sage(&["convert", text(&scene), "--to", "pickle", "--out", text(&back)]);
    assert_snapshot!(redacted(stderr(&run)), @r"
    note: `[folder]/fast.pkl`: frame-rate: recorded at 20 Hz; resampled to 10 Hz
    1 scene in `[folder]/back`, 0 failed ([time])
    ");
    assert_eq!(std::fs::read(back.join("fast.pkl")).unwrap(), std::fs::read(&scene).unwrap());
    let window = folder.path().join("window");
    stdout(&sage(&["convert", text(&scene), "--to", "native", "--now", "30", "--out", text(&window)]));
    assert_eq!(Recording::read(&window.join("fast-now30.safetensors")).unwrap().scene.frames, 71);
}

#[test]
fn now_is_chosen_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let scene = made(folder.path(), "long", |scene| {
        let there_and_back = (0..91).chain((0..90).rev()).collect::<Vec<_>>();
        frames(scene, &there_and_back, 0.1);
    });
    let out = folder.path().join("out");
    let arguments = ["generate", text(&scene), "--format", "native", "--now", "40", "--out", text(&out)];
    let run = sage(&[&arguments[..], &WEIGHTS].concat());
    assert!(run.status.success(), "{}", stderr(&run));
    let written = Recording::read(&out.join("long-now40-lambda1.00.safetensors")).unwrap().scene;
    let whole = Recording::read(&scene).unwrap().scene;
    assert_eq!(written.frames, 91);
    assert_eq!(written.tracks[0].position[..91], whole.tracks[0].position[30..121]);
    let run = sage(&["inspect", text(&scene), "--now", "300"]);
    assert_snapshot!(redacted(stderr(&run)), @"error: `[folder]/long.pkl`: field `length` is 181 frames at 10 Hz, so frame 300 cannot be now; expected --now 10 to 180");
}

#[test]
fn a_contact_at_now_is_left_out_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    std::fs::create_dir(&scenes).unwrap();
    let bad = made(&scenes, "touching", beside_now);
    made(&scenes, "apart", |_| ());
    let at = |name: &str| folder.path().join(name);
    let mut said = Vec::new();
    for method in ["sage", "log", "rule", "cat"] {
        let out = at(method);
        let arguments = ["generate", text(&scenes), "--method", method, "--lambda", "1", "--out", text(&out)];
        let run = sage(&[&arguments[..], &WEIGHTS].concat());
        assert!(run.status.success(), "{method}: {}", stderr(&run));
        said.push((format!("generate --method {method}"), stderr(&run).to_owned()));
        assert_eq!(
            row(&out, "run.json")["results"],
            serde_json::json!({"scenes": 2, "done": 1, "left_out": 1})
        );
        let name =
            std::fs::read_dir(&out).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let name =
            name.into_iter().find(|name| name.starts_with("touching") && name.ends_with(".json")).unwrap();
        let row = row(&out, &name);
        assert!(row["left_out"].as_str().unwrap().contains("contact_now") && row["scores"].is_null());
        let again = sage(&[&arguments[..], &WEIGHTS].concat());
        assert!(again.status.success(), "{method}: {}", stderr(&again));
    }
    let alone = failure(&["generate", text(&bad), "--method", "log", "--out", text(&at("alone"))]);
    said.push(("generate of this scene alone".to_owned(), alone));
    let run =
        sage(&["simulate", text(&scenes), "--ego", "idm", "--method", "rule", "--out", text(&at("driven"))]);
    assert!(run.status.success(), "{}", stderr(&run));
    said.push(("simulate".to_owned(), stderr(&run).to_owned()));
    let table = at("table");
    let arguments = ["bench", "open-loop", text(&scenes), "--method", "log,rule", "--out", text(&table)];
    let run = sage(&[&arguments[..], &WEIGHTS].concat());
    assert_snapshot!("table_without_a_scene_in_contact", stdout(&run));
    said.push(("bench open-loop".to_owned(), stderr(&run).to_owned()));
    let drivers = at("drivers");
    let arguments =
        ["bench", "drivers", text(&scenes), "--ego", "idm", "--method", "rule", "--out", text(&drivers)];
    let run = sage(&arguments);
    assert!(run.status.success(), "{}", stderr(&run));
    said.push(("bench drivers".to_owned(), stderr(&run).to_owned()));
    assert_snapshot!("a_scene_in_contact_is_left_out", messages(said));
    let rows = std::fs::read_to_string(drivers.join("rows.csv")).unwrap();
    assert_eq!(rows.lines().filter(|line| line.contains(",at-fault attack,")).count(), 1);
}

#[test]
fn a_bad_bystander_and_a_file_that_is_no_scene_do_not_stop_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = folder.path().join("scenes");
    std::fs::create_dir(&scenes).unwrap();
    let bad = made(&scenes, "bad", |scene| {
        let (ego, adversary) = (scene.ego, scene.adversary.unwrap());
        let other =
            (0..scene.tracks.len()).find(|k| *k != ego && *k != adversary && scene.tracks[*k].valid[40]);
        scene.tracks[other.unwrap()].position[40][0] = f64::NAN;
    });
    let run = sage(&["inspect", text(&bad)]);
    assert_snapshot!(redacted(stdout(&run)), @r"
    scene              frames vehicles others  ego        adversary  future  warnings
    bad                    91        3      1  ego        crosser     80/80
        track-left-out, one-point-lanes
        has edges, lights, speed limits, heights, sizes; not recorded: medians
        track-left-out: track `leader` is left out: `state/position/40` is NaN; expected a finite number within ±1e8
        one-point-lanes: 1 lane has a single point
    1 scene, 4 tracks, 963 map points; warnings: 1 one-point-lanes, 1 track-left-out
    ");
    let run = sage(&["inspect", text(&bad), "--strict"]);
    assert!(!run.status.success());
    assert_snapshot!(redacted(stderr(&run)), @"error: `[folder]/scenes/bad.pkl`: field `tracks/leader/state/position/40` is NaN; expected a finite number within ±1e8");
    std::fs::write(scenes.join("no-scene.pkl"), b"\x80\x04N.").unwrap();
    let out = folder.path().join("drivers");
    let arguments = ["bench", "drivers", text(&scenes), "--ego", "idm", "--unattacked", "--out", text(&out)];
    let run = sage(&arguments);
    assert_eq!(run.status.code(), Some(BAD_SCENES), "{}", stderr(&run));
    assert_snapshot!(redacted(stderr(&run)), @r"
    warning: `[folder]/scenes/bad.pkl`: track-left-out: track `leader` is left out: `state/position/40` is NaN; expected a finite number within ±1e8
    error: `[folder]/scenes/no-scene.pkl`: field `(root)` is None; expected a dict
    read 1 scene ([time])
    1 method on 1 scene ([time])
    | driver | time a step | 99 % of steps |
    | ------ | ----------: | ------------: |
    | idm    | [time]
    table.md, estimates.csv, rows.csv, study.json are in `[folder]/drivers`
    1 scene failed; the results are of the others
    ");
    let table = std::fs::read_to_string(out.join("table.md")).unwrap();
    assert_snapshot!("table_with_a_file_that_is_no_scene", redacted(&table));
}

#[test]
fn contradictions_are_said_where_they_matter_and_positions_can_be_trusted() {
    let folder = tempfile::tempdir().unwrap();
    let scene = made(folder.path(), "still", |scene| {
        scene.tracks.iter_mut().for_each(|track| track.velocity.fill([0.0; 2]));
    });
    let mut said = Vec::new();
    for (k, more) in [&[][..], &["--trust", "positions"]].into_iter().enumerate() {
        let out = folder.path().join(k.to_string());
        let arguments = ["generate", text(&scene), "--format", "native", "--out", text(&out)];
        let run = sage(&[&arguments[..], more, &WEIGHTS].concat());
        assert!(run.status.success(), "{}", stderr(&run));
        said.push((format!("generate {}", more.join(" ")), stderr(&run).to_owned()));
        let written = Recording::read(&out.join("still-lambda1.00.safetensors")).unwrap().scene;
        let ego = written.ego();
        let is_moving = (0..91).any(|frame| ego.velocity[frame] != [0.0; 2]);
        assert_eq!(is_moving, !more.is_empty());
    }
    assert_snapshot!("positions_that_contradict_velocities", messages(said));
}
