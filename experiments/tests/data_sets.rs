//! What `sage generate` leaves: a data set that MetaDrive and ScenarioNet open, resumable and in shards.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test; notes go to stderr.

mod hostile;
mod program;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use insta::assert_snapshot;
use program::*;
use sage_data::{
    Recording,
    pickle::{Document, Id, Node},
};
use serde_json::Value;

/// Procedural scenes as pickles below a folder.
fn scenes(folder: &Path, count: usize) -> PathBuf {
    let scenes = folder.join("scenes");
    let count = count.to_string();
    stdout(&sage(&["scenes", "--count", &count, "--format", "pickle", "--out", text(&scenes)]));
    scenes
}

fn generate(scenes: &Path, out: &Path, more: &[&str]) -> Output {
    let arguments = ["generate", text(scenes), "--lambda", "0,1", "--out", text(out)];
    sage(&[&arguments[..], &WEIGHTS, more].concat())
}

/// Files without the record of the run, which holds times.
fn files(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = hostile::snapshot(out);
    files.remove("run.json");
    files
}

fn record(out: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(out.join("run.json")).unwrap()).unwrap()
}

fn document(path: &Path) -> Document {
    Document::parse(std::fs::read(path).unwrap()).unwrap()
}

/// Keys of a dict, in its order.
fn keys(document: &Document, dict: Id) -> Vec<String> {
    let entries = document.entries(dict).unwrap();
    entries.iter().map(|(key, _)| document.text(*key).unwrap().to_owned()).collect()
}

#[test]
fn the_folder_is_a_data_set_with_summary_and_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = scenes(folder.path(), 3);
    std::fs::copy(example(), scenes.join("10.pkl")).unwrap();
    std::fs::copy(example(), scenes.join("9.pkl")).unwrap();
    let out = folder.path().join("out");
    stdout(&generate(&scenes, &out, &[]));
    let [summary, mapping] =
        ["summary", "mapping"].map(|name| document(&out.join(format!("dataset_{name}.pkl"))));
    let names = keys(&summary, summary.root());
    assert_eq!(names.len(), 10);
    assert_eq!(names, keys(&mapping, mapping.root()));
    let place = |part: &str| names.iter().position(|name| name.contains(part)).unwrap();
    assert!(
        place("_9-lambda0.00") < place("_9-lambda1.00") && place("_9-lambda1.00") < place("_10-lambda0.00")
    );
    for (key, value) in mapping.entries(mapping.root()).unwrap() {
        let name = mapping.text(*key).unwrap();
        assert!(name.starts_with("sd_") && out.join(name).is_file(), "{name}");
        assert_eq!(mapping.text(*value), Some(""));
    }
    for (name, entry) in names.iter().zip(summary.entries(summary.root()).unwrap()) {
        check_summary(&document(&out.join(name)), &summary, entry.1);
    }
    // The folder goes in again, each scene once.
    let again = sage(&["inspect", text(&out), "--json"]);
    assert_eq!(rows(&again).len(), 10);
    metadrive_opens(&out, 10);
}

#[test]
fn a_converted_shard_is_a_data_set_with_summary_and_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    stdout(&sage(&[
        "convert",
        text(&scenes(folder.path(), 3)),
        "--to",
        "womd",
        "--out",
        text(&at("shards")),
    ]));
    let invented =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../sage-data/tests/data/womd_synthetic.tfrecord");
    let shards = at("shards");
    stdout(&sage(&["convert", text(&shards), text(&invented), "--to", "pickle", "--out", text(&at("set"))]));
    let summary = document(&at("set/dataset_summary.pkl"));
    let names = keys(&summary, summary.root());
    assert_eq!(names.len(), 5);
    for (name, entry) in names.iter().zip(summary.entries(summary.root()).unwrap()) {
        check_summary(&document(&at("set").join(name)), &summary, entry.1);
    }
    metadrive_opens(&at("set"), 5);
}

/// Compares the summaries in a file with its tracks, and with its entry in the data set's summary.
fn check_summary(file: &Document, summary: &Document, entry: Id) {
    let metadata = file.get(file.root(), "metadata").unwrap();
    let of_file = |key: &str| file.get(metadata, key).unwrap();
    let tracks = file.get(file.root(), "tracks").unwrap();
    assert_eq!(keys(file, of_file("object_summary")), keys(file, tracks));
    let number = |key: &str| file.number(file.get(of_file("number_summary"), key).unwrap()).unwrap();
    assert_eq!(number("num_objects") as usize, file.entries(tracks).unwrap().len());
    for group in ["tracks", "dynamic_map_states"] {
        for (key, object) in file.entries(file.get(file.root(), group).unwrap()).unwrap() {
            let own = file.get(*object, "metadata").unwrap();
            assert_eq!(file.text(file.get(own, "object_id").unwrap()), file.text(*key), "{group}");
            assert!(file.get(own, "type").is_some(), "{group}");
        }
    }
    let scene = Recording::from_bytes(Path::new("made"), file.to_pickle()).unwrap().scene;
    let mut moving = 0;
    for track in &scene.tracks {
        let frames: Vec<usize> = (0..scene.frames).filter(|f| track.is_valid(*f)).collect();
        let step = |pair: &[usize]| sage_core::geometry::distance(track.point(pair[0]), track.point(pair[1]));
        let distance: f64 = frames.windows(2).map(step).sum();
        let told = file.get(of_file("object_summary"), &track.id).unwrap();
        let told = |key: &str| file.number(file.get(told, key).unwrap()).unwrap();
        assert!((told("moving_distance") - distance).abs() < 1e-6, "{}", track.id);
        assert_eq!(
            (told("valid_length") as usize, told("track_length") as usize),
            (frames.len(), scene.frames)
        );
        moving += usize::from(distance > 1.0);
    }
    assert_eq!(number("num_moving_objects") as usize, moving);
    // The entry is the metadata in plain values.
    assert_eq!(keys(summary, entry), keys(file, metadata));
    assert!(is_plain(summary, entry), "an array or a set in the summary");
    let objects = |document: &Document, dict: Id| {
        format!("{:?}", keys(document, document.get(dict, "object_summary").unwrap()))
    };
    assert_eq!(objects(summary, entry), objects(file, metadata));
}

fn is_plain(document: &Document, id: Id) -> bool {
    match document.node(id) {
        Node::Array(_) | Node::Scalar(..) | Node::Set(_) | Node::FrozenSet(_) => false,
        Node::List(items) | Node::Tuple(items) => items.iter().all(|item| is_plain(document, *item)),
        Node::Dict(entries) => entries.iter().all(|(_, value)| is_plain(document, *value)),
        _ => true,
    }
}

/// MetaDrive's own loader and checks, where they are installed.
fn metadrive_opens(out: &Path, scenes: usize) {
    const LOAD: &str = "
import os, sys
from metadrive.scenario.scenario_description import ScenarioDescription as SD
from metadrive.scenario.utils import read_dataset_summary, read_scenario_data
summary, files, mapping = read_dataset_summary(sys.argv[1])
for name in files:
    scene = read_scenario_data(os.path.join(sys.argv[1], mapping[name], name))
    SD.sanity_check(scene)
    ours = scene['metadata']['number_summary']
    theirs = SD.update_summaries(scene)['metadata']['number_summary']
    assert {k: v for k, v in ours.items() if k != 'map_height_diff'} == {k: v for k, v in theirs.items() if k != 'map_height_diff'}, (ours, theirs)
print(len(files))
";
    let python = std::env::var_os("SAGE_METADRIVE_PYTHON").unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", "import metadrive"]).output();
    if !has.is_ok_and(|run| run.status.success()) {
        return eprintln!("left out: MetaDrive's loader (SAGE_METADRIVE_PYTHON names a Python that has it)");
    }
    let run = Command::new(&python).args(["-c", LOAD, text(out)]).output().unwrap();
    let last = stdout(&run).lines().last().unwrap().to_owned();
    assert_eq!(last, scenes.to_string(), "{}", stderr(&run));
}

#[test]
fn the_attacked_scenes_of_a_suite_are_a_data_set_that_metadrive_opens() {
    let folder = tempfile::tempdir().unwrap();
    let (found, suite) = (folder.path().join("found"), folder.path().join("suite"));
    let search = ["search", &example(), "--ego", "idm", "--budget", "8", "--out", text(&found)];
    stdout(&sage(&[&search[..], &WEIGHTS].concat()));
    stdout(&sage(&["suite", text(&found), "--keep", "all", "--format", "pickle", "--out", text(&suite)]));
    let bytes = std::fs::read(suite.join("suite.json")).unwrap();
    let tests = serde_json::from_slice::<Value>(&bytes).unwrap()["tests"].as_array().unwrap().len();
    assert!(tests > 1);
    metadrive_opens(&suite, tests);
}

/// Drives every scene of a data set in MetaDrive, and writes what it exports of the drives.
const DRIVE: &str = "
import os, pickle, sys
from metadrive.engine.base_engine import BaseEngine
BaseEngine.try_pull_asset = staticmethod(lambda: None)  # pictures of cars, which need a network
from metadrive.envs.scenario_env import ScenarioEnv
from metadrive.policy.replay_policy import ReplayEgoCarPolicy
folder, out = sys.argv[1:3]
count = len(pickle.load(open(os.path.join(folder, 'dataset_summary.pkl'), 'rb')))
env = ScenarioEnv(dict(data_directory=folder, num_scenarios=count, agent_policy=ReplayEgoCarPolicy, log_level=50))
drives, _ = env.export_scenarios(lambda o: [0, 0], scenario_index=list(range(count)), return_done_info=True)
for k, drive in drives.items():
    pickle.dump(drive, open(os.path.join(out, f'drive-{k}.pkl'), 'wb'))
print(len(drives))
";

#[test]
fn metadrive_drives_attacked_scenes_and_its_exports_are_attacked_again() {
    let python = std::env::var_os("SAGE_METADRIVE_PYTHON").unwrap_or_else(|| "python3".into());
    let has = Command::new(&python).args(["-c", "import metadrive"]).output();
    if !has.is_ok_and(|run| run.status.success()) {
        return eprintln!("left out: drives in MetaDrive (SAGE_METADRIVE_PYTHON names a Python that has it)");
    }
    let folder = tempfile::tempdir().unwrap();
    let (attacked, exported) = (folder.path().join("attacked"), folder.path().join("exported"));
    generate(&scenes(folder.path(), 2), &attacked, &["--format", "pickle"]);
    std::fs::create_dir(&exported).unwrap();
    let run = Command::new(&python).args(["-c", DRIVE, text(&attacked), text(&exported)]).output().unwrap();
    let last = stdout(&run).lines().last().unwrap_or_default().to_owned();
    let count: usize = last.parse().unwrap_or_else(|_| panic!("{last}: {}", stderr(&run)));
    assert!(count > 0);
    // MetaDrive ends a drive on arrival, so the exports are shorter than the scenes.
    let again = generate(&exported, &folder.path().join("again"), &["--json"]);
    assert_eq!(rows(&again).len() % count, 0);
    assert!(!rows(&again).is_empty() && stderr(&again).contains("short-recording"), "{}", stderr(&again));
    let back = folder.path().join("back");
    stdout(&sage(&["convert", text(&exported), "--to", "pickle", "--out", text(&back)]));
    assert_eq!(files(&back).keys().filter(|name| name.ends_with(".pkl")).count(), count);
}

#[test]
fn a_finished_scene_stays_finished_and_its_rows_are_printed_again() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = scenes(folder.path(), 4);
    let out = folder.path().join("out");
    let first = generate(&scenes, &out, &["--json"]);
    let whole = files(&out);
    assert_eq!(record(&out)["results"], serde_json::json!({"scenes": 4, "done": 4}));
    assert!(record(&out)["seconds"].is_number() && rows(&first).iter().all(|row| row["seconds"].is_number()));
    let again = generate(&scenes, &out, &["--json"]);
    let plain = |output: &Output| {
        let rows = rows(output).into_iter().map(|mut row| {
            row["seconds"] = Value::Null;
            row
        });
        rows.collect::<Vec<_>>()
    };
    assert_eq!(plain(&again), plain(&first));
    assert!(rows(&again).iter().all(|row| row["seconds"].is_null()), "no time is invented");
    // Whatever is missing is made again, and nothing else is touched.
    let time = |name: &str| std::fs::metadata(out.join(name)).unwrap().modified().unwrap();
    let pickle_of = |scene: &str| pickle(&out, &format!("{scene}-lambda0.00"));
    let untouched = pickle_of("curve-1-1").file_name().unwrap().to_str().unwrap().to_owned();
    let before = time(&untouched);
    for lost in
        [out.join("straight-1-0-lambda1.00.json"), pickle_of("straight-1-0"), out.join("dataset_summary.pkl")]
    {
        std::fs::remove_file(lost).unwrap();
    }
    std::fs::write(out.join("curve-1-1.svg.tmp"), "not ours").unwrap();
    stdout(&generate(&scenes, &out, &[]));
    std::fs::remove_file(out.join("curve-1-1.svg.tmp")).unwrap();
    assert!(files(&out) == whole && time(&untouched) == before);
}

#[test]
fn shards_at_once_leave_the_folder_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = scenes(folder.path(), 8);
    let at = |name: &str| folder.path().join(name);
    // Each run ends with a table of its own.
    let lines = |output: &Output| stdout(output).lines().filter(|line| line.contains(" lambda")).count();
    let attacks = |output: &Output| lines(output) - stdout(output).matches("| lambda").count();
    let printed = attacks(&generate(&scenes, &at("whole"), &[]));
    let start = |shard: &str| {
        Command::new(env!("CARGO_BIN_EXE_sage"))
            .args([
                "generate",
                text(&scenes),
                "--lambda",
                "0,1",
                "--out",
                text(&at("parts")),
                "--shard",
                shard,
            ])
            .args(WEIGHTS)
            .env_remove("SAGE_WEIGHTS")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let both = ["1/2", "2/2"].map(start).map(|child| child.wait_with_output().unwrap());
    let lines: Vec<usize> = both.iter().map(attacks).collect();
    assert!(lines[0] + lines[1] == printed && lines.iter().all(|n| *n > 0), "{lines:?}");
    stdout(&sage(&["join", text(&at("parts"))]));
    assert!(files(&at("parts")) == files(&at("whole")), "the folder of two shards differs");
    assert_eq!(record(&at("parts"))["run"], record(&at("whole"))["run"]);
    assert_eq!(record(&at("parts"))["results"], record(&at("whole"))["results"]);
    assert!(record(&at("parts"))["seconds"].is_number());
    // One shard after the other, in any order, comes to the same.
    stdout(&generate(&scenes, &at("later"), &["--shard", "2/2"]));
    assert!(failure(&["join", text(&at("later"))]).contains("in shards 1 of 2"), "the other half is missing");
    stdout(&generate(&scenes, &at("later"), &["--shard", "1/2"]));
    stdout(&sage(&["join", text(&at("later"))]));
    assert!(files(&at("later")) == files(&at("whole")));
}

#[test]
fn rows_of_another_run_never_count_as_done() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = scenes(folder.path(), 6);
    let out = folder.path().join("out");
    let seeds = |out: &Path| {
        let names = files(out).into_keys().filter(|name| name.ends_with(".json"));
        let seed = |name: String| {
            let row: Value = serde_json::from_slice(&std::fs::read(out.join(name)).unwrap()).unwrap();
            row["seed"].as_u64().unwrap()
        };
        names.map(seed).collect::<std::collections::BTreeSet<u64>>()
    };
    let join = ["join", text(&out)];
    for shard in ["1/2", "2/2"] {
        stdout(&generate(&scenes, &out, &["--shard", shard]));
    }
    stdout(&sage(&join));
    assert_eq!(seeds(&out), [0].into());
    let both = generate(&scenes, &out, &["--shard", "1/2", "--seed", "1", "--force"]);
    assert_eq!(both.status.code(), Some(2), "a shard cannot begin anew for the others");
    stdout(&generate(&scenes, &out, &["--seed", "1", "--force"]));
    assert_eq!(seeds(&out), [1].into());
    assert_eq!(record(&out)["results"]["done"], 6);
}

#[test]
fn the_tables_of_another_data_set_are_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other");
    std::fs::create_dir_all(other.join("part")).unwrap();
    std::fs::copy(example(), other.join("part/sd_a.pkl")).unwrap();
    hostile::summary(&other, &[("sd_a.pkl", "part")]);
    let before = hostile::snapshot(&other);
    let refused = generate(Path::new(&example()), &other, &["--force"]);
    assert_snapshot!(redacted(stderr(&refused)), @r"
    note: weights `procedural` (network densetnt)
    error: `[folder]/other` is a data set that lists `[folder]/other/part/sd_a.pkl`; name another --out
    ");
    assert!(hostile::snapshot(&other) == before);
}
