//! Odd scenes through every command: no command panics, no scene ends the others, and no two rows contradict each other.
//!
//! Each way in which public files are odd is a parameter of `sage-data/tests/odd_scenes`. Every value is tried alone, and
//! random combinations as long as a minute allows; SAGE_SLOW=1 takes ten.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

#[path = "../../sage-data/tests/odd_scenes/mod.rs"]
mod odd_scenes;
mod program;

use std::{
    collections::BTreeMap,
    process::Output,
    time::{Duration, Instant},
};

use odd_scenes::{OddScene, PARAMETERS};
use program::*;
use sage_core::seed::Rng;
use serde_json::Value;

/// Scenes of a folder, which the commands go through.
const BATCH: usize = 24;
/// Parameters of a random scene that are odd.
const ODDNESS: f64 = 0.25;

/// The commands, without inputs and output folder.
const COMMANDS: &[&str] = &[
    "generate --lambda 0,1 --feasibility drivable",
    "generate --lambda 1",
    "generate --method random",
    "generate --method rule",
    "generate --method log",
    "generate --method cat",
    "generate --method king",
    "simulate --ego replay,idm,r157 --method sage --lambda 1",
    "simulate --ego replay,idm,expert,pdm",
    "simulate --ego replay --method rule",
    "search --ego idm --budget 4",
    "convert --to native",
    "convert --to openscenario",
    "convert --to gpudrive",
];

/// The scenes of a folder by name, and the options with which all are read.
struct Batch {
    folder: tempfile::TempDir,
    scenes: Vec<(String, OddScene)>,
    options: Vec<String>,
}

impl Batch {
    /// Scenes that are read with the same options share a folder.
    fn all(scenes: &[OddScene]) -> Vec<Self> {
        let mut by_options: BTreeMap<Vec<String>, Vec<OddScene>> = BTreeMap::new();
        for scene in scenes {
            let mut options = Vec::new();
            options.extend(scene.now().map(|now| format!("--now={now}")));
            options.extend(scene.rate().map(|rate| format!("--rate={rate}")));
            by_options.entry(options).or_default().push(scene.clone());
        }
        let batch = |(options, scenes): (Vec<String>, Vec<OddScene>)| {
            let folder = tempfile::tempdir().unwrap();
            let name = |k: usize| format!("odd{k:03}");
            for (k, scene) in scenes.iter().enumerate() {
                let file = folder.path().join("in").join(format!("{}.{}", name(k), scene.ending()));
                std::fs::create_dir_all(file.parent().unwrap()).unwrap();
                std::fs::write(file, scene.bytes()).unwrap();
            }
            let scenes = scenes.into_iter().enumerate().map(|(k, scene)| (name(k), scene)).collect();
            Self { folder, scenes, options }
        };
        by_options.into_iter().map(batch).collect()
    }

    fn run(&self, number: usize, command: &str) -> (Output, Vec<Value>) {
        let (input, out) = (self.folder.path().join("in"), self.folder.path().join(format!("out{number}")));
        let mut words: Vec<&str> = command.split(' ').collect();
        words.insert(1, text(&input));
        words.extend(self.options.iter().map(String::as_str));
        words.extend(["--out", text(&out)]);
        let writes_rows = !command.starts_with("convert");
        if writes_rows {
            let needs_weights = !command.starts_with("simulate") || command.contains("--method");
            words.extend(WEIGHTS.iter().filter(|_| needs_weights));
            words.push("--json");
        }
        if command.starts_with("generate") {
            words.push("--no-pages");
        }
        let output = sage(&words);
        let said = stderr(&output);
        let what = || {
            let scenes = self.scenes.iter().map(|(name, scene)| format!("{name}: {}", scene.describe()));
            format!("{command} {:?}: {said}\n{}", self.options, scenes.collect::<Vec<_>>().join("\n"))
        };
        let code = output.status.code();
        assert!(matches!(code, Some(0 | BAD_SCENES)), "{code:?} {}", what());
        assert!(!said.contains("defect") && !said.contains("panicked"), "{}", what());
        // No scene is lost without a word.
        let lines = std::str::from_utf8(&output.stdout).unwrap().lines();
        let rows: Vec<Value> =
            lines.filter(|_| writes_rows).map(|line| serde_json::from_str(line).unwrap()).collect();
        for (name, scene) in &self.scenes {
            let is_named = said.contains(&**name) || rows.iter().any(|row| of(row, name));
            assert!(
                is_named || !writes_rows,
                "{name} ({}) has no row and no error: {}",
                scene.describe(),
                what()
            );
        }
        (output, rows)
    }

    /// The odd scene of a row.
    fn describe(&self, row: &Value) -> String {
        let found = self.scenes.iter().find(|(name, _)| of(row, name));
        format!("{} {:?}: {row}", found.map_or(String::new(), |(_, scene)| scene.describe()), self.options)
            .chars()
            .take(3000)
            .collect()
    }

    /// Explains some of the scenes, which takes one at a time.
    fn explain(&self) {
        for (name, scene) in self.scenes.iter().take(2) {
            let file = self.folder.path().join("in").join(format!("{name}.{}", scene.ending()));
            let options: Vec<&str> = self.options.iter().map(String::as_str).collect();
            let output = sage(&[&["explain", text(&file), "--json"], &options[..], &WEIGHTS].concat());
            let said = stderr(&output);
            assert!(matches!(output.status.code(), Some(0 | 1 | BAD_SCENES)), "{}: {said}", scene.describe());
            assert!(!said.contains("defect") && !said.contains("panicked"), "{}: {said}", scene.describe());
        }
    }

    /// Checks what holds for the rows of a command.
    fn check(&self, command: &str, rows: &[Value]) {
        for row in rows {
            let what = || format!("{command}: {}", self.describe(row));
            if command.starts_with("generate") {
                check_attack(row, &what);
            } else if command.starts_with("simulate") {
                check_drive(row, &what);
            }
        }
    }

    /// A plan is driven as it is scored: the recording in the ego's place meets it at the same step.
    fn compare(&self, attacks: &[Value], drives: &[Value]) {
        for attack in attacks {
            let same = |drive: &&Value| {
                drive["scene"] == attack["scene"] && drive["ego"] == "replay" && !drive["attack"].is_null()
            };
            let Some(drive) = drives.iter().find(same) else { continue };
            if drive["attack"]["trajectory"] != attack["trajectory"] {
                continue;
            }
            let what = || format!("{}\n{}", self.describe(attack), self.describe(drive));
            let scored = attack["scores"]["collision_step"].as_i64();
            let adversary = &drive["adversary"];
            let met = drive["contacts"].as_array().unwrap();
            let first = met
                .iter()
                .find(|contact| contact["with"] == *adversary)
                .map(|contact| contact["step"].as_i64().unwrap());
            // A contact before the attack, or while both already touch, is none of the attack's.
            if met.iter().any(|contact| contact["step"].as_i64().unwrap() <= 0) {
                continue;
            }
            match (scored, first) {
                (Some(scored), Some(driven)) => {
                    assert!((scored - driven).abs() <= 1, "{scored} {driven} {}", what())
                }
                (None, Some(driven)) => panic!("driven into at {driven}, and scored as a miss: {}", what()),
                (Some(scored), None) => panic!("scored as a hit at {scored}, and never met: {}", what()),
                (None, None) => {}
            }
        }
    }
}

fn of(row: &Value, name: &str) -> bool {
    row["scene"].as_str().is_some_and(|scene| scene == name || scene.starts_with(&format!("{name}-now")))
}

fn check_attack(row: &Value, what: &dyn Fn() -> String) {
    let scores = &row["scores"];
    // A scene that is left out has a row without scores.
    let Some(horizon) = scores["horizon"].as_i64() else { return };
    let step = scores["collision_step"].as_i64();
    assert!(step.is_none_or(|step| (1..=horizon).contains(&step)), "{}", what());
    assert_eq!(scores["collision"] == true, step.is_some(), "{}", what());
    let violations = row["violations"].as_array().unwrap();
    let steps = violations.iter().map(|violation| violation["step"].as_i64().unwrap());
    assert!(steps.into_iter().all(|step| (1..=horizon).contains(&step)), "{}", what());
    let believable = scores["believable"].as_bool();
    assert!(believable != Some(true) || step.is_some() && scores["feasible"] == true, "{}", what());
    assert!(
        row["trajectory"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|p| p.as_array().unwrap())
            .all(Value::is_number),
        "{}",
        what()
    );
}

fn check_drive(row: &Value, what: &dyn Fn() -> String) {
    let steps = row["steps"].as_i64().unwrap();
    for contact in row["contacts"].as_array().unwrap() {
        assert!(contact["step"].as_i64().unwrap() <= steps - 10 || row["ego"] == "replay", "{}", what());
        assert!(contact["class"] != "appeared" || contact["at_fault"] == false, "{}", what());
    }
    let verdict = &row["attack"]["verdict"];
    let first = row["contacts"].as_array().unwrap().first();
    if verdict["attack"] == true {
        assert!(first.is_some_and(|contact| contact["class"] != "appeared"), "{}", what());
    }
    assert!(row["off_road_measured"] == true || row["off_road"].is_null(), "{}", what());
}

/// Runs all commands on some scenes.
fn through_all_commands(scenes: &[OddScene]) {
    for batch in Batch::all(scenes) {
        let mut attacks = Vec::new();
        for (number, command) in COMMANDS.iter().enumerate() {
            let (_, rows) = batch.run(number, command);
            batch.check(command, &rows);
            match *command {
                "generate --lambda 1" => attacks = rows,
                "simulate --ego replay,idm,r157 --method sage --lambda 1" => batch.compare(&attacks, &rows),
                _ => {}
            }
        }
        batch.explain();
        // What was written is read, in every format.
        for number in (0..COMMANDS.len()).filter(|k| COMMANDS[*k].starts_with("convert --to native")) {
            let written = batch.folder.path().join(format!("out{number}"));
            let has_scenes = std::fs::read_dir(&written).is_ok_and(|mut entries| {
                entries.any(|entry| entry.unwrap().file_name().to_str().unwrap().ends_with("safetensors"))
            });
            if has_scenes {
                let output = sage(&["inspect", text(&written), "--json"]);
                assert!(output.status.success(), "{}", stderr(&output));
            }
        }
    }
}

#[test]
fn every_value_of_every_parameter_passes_every_command() {
    let mut scenes = vec![OddScene::plain()];
    for (name, values) in PARAMETERS {
        scenes.extend(values[1..].iter().map(|value| OddScene::plain().with(name, value)));
    }
    through_all_commands(&scenes);
    eprintln!("{} scenes, each odd in one way, through {} commands", scenes.len(), COMMANDS.len());
}

#[test]
fn random_combinations_pass_every_command() {
    let is_slow = std::env::var("SAGE_SLOW").is_ok_and(|slow| slow == "1");
    let limit = Duration::from_secs(if is_slow { 600 } else { 60 });
    let (start, mut count, mut seed) = (Instant::now(), 0, 0);
    while start.elapsed() < limit {
        let mut rng = Rng::new(seed, "odd scenes", "combinations");
        // Scenes that are read alike share a folder, so that a batch needs few programs.
        let mut scenes: Vec<OddScene> = (0..BATCH).map(|_| OddScene::draw(&mut rng, ODDNESS)).collect();
        let now = ["10", "20", "30", "last"][seed as usize % 4];
        scenes.iter_mut().for_each(|scene| *scene = scene.clone().with("now", now));
        through_all_commands(&scenes);
        (count, seed) = (count + scenes.len(), seed + 1);
    }
    eprintln!("{count} random combinations in {:.0} s", start.elapsed().as_secs_f64());
}
