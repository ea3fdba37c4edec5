//! Runs that are killed at any moment, and what the same command makes of the folder afterwards.
//!
//! Used by the tests (three kills a command) and by `cargo run --release -p experiments --example
//! kill_anywhere` (as many as wanted).

#![allow(dead_code)] // The test and the example use a part each.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use sage_backbones::Parameters;
use sage_core::seed::Rng;
use serde_json::Value;

/// Commands that leave files behind.
pub const COMMANDS: [&str; 16] = [
    "pretrain",
    "finetune",
    "generate",
    "simulate",
    "search",
    "convert",
    "convert-shards",
    "convert-scenarios",
    "open-loop",
    "drivers",
    "closed-loop",
    "calibrate",
    "train-ego",
    "train-ego-ppo",
    "train-seal",
    "train-goose",
];

/// Studies that share the runner of those above: a slow set, on request.
#[allow(dead_code)] // Only the example kills them.
pub const STUDIES: &[&str] = &[
    "front",
    "pareto",
    "dial",
    "mixtures",
    "latest-start",
    "prediction",
    "experts",
    "ablation",
    "connectivity",
    "threshold",
    "transfer",
];

/// A command with its inputs, which writes into a folder of its own each time.
pub struct Case {
    program: PathBuf,
    /// Where inputs and outputs lie.
    root: PathBuf,
    arguments: Vec<String>,
    /// Whether the command needs `--force` to begin anew.
    needs_force: bool,
}

impl Case {
    /// Makes the inputs of a command below a folder.
    pub fn new(program: &Path, name: &str, root: &Path) -> Self {
        let prepare = |arguments: &[&str]| {
            let status = command(program, root).args(arguments).stderr(Stdio::null()).status();
            assert!(status.expect("the program starts").success(), "{arguments:?}");
        };
        prepare(&["scenes", "--count", "4", "--format", "pickle", "--out", "scenes"]);
        std::fs::write(root.join("quick.json"), r#"{"epochs": 2, "candidates": 16}"#)
            .expect("a file is written");
        let small = r#"{"hidden": 16, "rounds": 1}"#;
        let (arguments, needs_force): (&[&str], bool) = match name {
            "pretrain" => {
                (&["pretrain", "scenes", "--dev", "scenes", "--epochs", "2", "--network", small], false)
            }
            "finetune" => (&["finetune", "scenes", "--roles", "0", "--config", "quick.json"], false),
            "generate" => (&["generate", "scenes", "--weights", "procedural", "--lambda", "0,1"], false),
            "simulate" => {
                let attack = ["--method", "sage", "--lambda", "0,1", "--weights", "procedural"];
                (&[&["simulate", "scenes", "--ego", "replay,idm"][..], &attack].concat(), false)
            }
            "search" => {
                let size = ["--budget", "8", "--weights", "procedural"];
                (&[&["search", "scenes", "--ego", "idm"][..], &size].concat(), false)
            }
            "convert" => (&["convert", "scenes", "--to", "native"], false),
            "convert-shards" => (&["convert", "scenes", "--to", "womd", "--scenes-per-file", "2"], false),
            "convert-scenarios" => (&["convert", "scenes", "--to", "openscenario"], false),
            "open-loop" => {
                let methods = ["--method", "sage,rule,log", "--lambda", "1", "--ego", "replay,idm"];
                (&[&["bench", "open-loop", "scenes"][..], &methods].concat(), false)
            }
            "drivers" => {
                let drivers = ["--ego", "replay,idm", "--method", "sage,rule", "--weights", "procedural"];
                (&[&["bench", "drivers", "scenes"][..], &drivers].concat(), false)
            }
            "closed-loop" => {
                let policies = ["--ego", "idm,expert", "--untrained", "2", "--weights", "procedural"];
                (&[&["bench", "closed-loop", "scenes"][..], &policies].concat(), false)
            }
            "train-ego" => {
                let small =
                    r#"{"td3": {"hidden": [16, 16], "batch": 32, "buffer": 700, "random_steps": 300}}"#;
                let size = ["--procedural", "6", "--updates", "900"];
                let run =
                    ["--config", small, "--evaluations", "3", "--checkpoint-every", "100", "--seeds", "0..2"];
                let attacks = ["train-ego", "--method", "sage", "--weights", "procedural"];
                (&[&attacks[..], &size, &run].concat(), false)
            }
            "train-ego-ppo" => {
                let small = r#"{"ppo": {"hidden": [16, 16], "environments": 8, "horizon": 10, "minibatch": 40, "taught": 0.7}}"#;
                let size = ["--procedural", "6", "--learner", "ppo", "--steps", "12000", "--mirrored", "0.5"];
                let size = [&size[..], &["--teacher", "expert"]].concat();
                let run =
                    ["--config", small, "--evaluations", "3", "--checkpoint-every", "800", "--seeds", "0..2"];
                let attacks = ["train-ego", "--method", "sage", "--search", "2", "--weights", "procedural"];
                (&[&attacks[..], &size, &run].concat(), false)
            }
            "train-seal" => {
                let small = r#"{"hidden": 8, "criticality": {"epochs": 3}, "skills": {"epochs": 2}, "prior": {"epochs": 4}}"#;
                let size = ["--procedural", "8", "--dev", "scenes"];
                (&[&["train-adversary", "seal", "--options", small][..], &size].concat(), false)
            }
            "train-goose" => {
                let small = r#"{"decisions": 1100, "random": 20, "batch": 8, "roles": 1}"#;
                let size = ["--procedural", "8", "--dev", "scenes"];
                (&[&["train-adversary", "goose", "--options", small][..], &size].concat(), false)
            }
            "ablation" => {
                (&["bench", "ablation", "scenes", "--weights", "procedural", "--mix", "adversarial=1"], false)
            }
            "pareto" => {
                // Without the time of generation, which differs from run to run.
                let metrics = "metrics={trajectory: [attack, R_adv, believable, P_real], policy: [attack, R_adv, believable, P_real]}";
                (&["bench", "pareto", "scenes", "--weights", "procedural", "--set", metrics], false)
            }
            study if STUDIES.contains(&study) => {
                (&["bench", study, "scenes", "--weights", "procedural"], false)
            }
            "calibrate" => (&["calibrate", "scenes", "--selection", "paper-selection"], true),
            other => panic!("no case for `{other}`"),
        };
        let arguments = arguments.iter().map(|a| (*a).to_owned()).collect();
        Self { program: program.to_owned(), root: root.to_owned(), arguments, needs_force }
    }

    /// The command with an output folder, which is there already; `calibrate` writes a file into it.
    fn run(&self, out: &str, again: bool) -> Command {
        std::fs::create_dir_all(self.root.join(out)).expect("a folder is made");
        let mut run = command(&self.program, &self.root);
        let target =
            if self.arguments[0] == "calibrate" { format!("{out}/dial.json") } else { out.to_owned() };
        run.args(&self.arguments).args(["--out", &target]);
        if again && self.needs_force {
            run.arg("--force");
        }
        run
    }

    /// An uninterrupted run: its files, times aside, and how long it took.
    pub fn whole(&self) -> (BTreeMap<String, Vec<u8>>, Duration) {
        let clock = Instant::now();
        let output = self.run("whole", false).output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        (self.files("whole"), clock.elapsed())
    }

    /// Kills a run after some time and runs the command again.
    ///
    /// *Errors*: what differs from `expected`, or what the second run says.
    pub fn kill_and_run_again(
        &self,
        number: u64,
        whole: Duration,
        expected: &BTreeMap<String, Vec<u8>>,
    ) -> Result<(), String> {
        let out = format!("killed-{number}");
        let share = Rng::new(number, &self.arguments[0], "kill").uniform(0.0, 1.05);
        let mut child = self.run(&out, false).stderr(Stdio::null()).spawn().map_err(|e| e.to_string())?;
        std::thread::sleep(whole.mul_f64(share));
        child.kill().and_then(|()| child.wait()).map_err(|e| e.to_string())?;
        let told =
            |problem: String| format!("killed after {share:.3} of a whole run (number {number}): {problem}");
        // What has its final name is whole.
        for (name, bytes) in self.files(&out) {
            let is_passing = |ending: &str| name.ends_with(ending) || name.contains(".sage-");
            if [
                ".state",
                "run.json",
                "last.safetensors",
                "prior.safetensors",
                "curve.csv",
                "curve.svg",
                "checkpoint.safetensors",
                ".rows",
            ]
            .iter()
            .any(|ending| is_passing(ending))
            {
                continue;
            }
            if expected.get(&name) != Some(&bytes) {
                return Err(told(format!("`{name}` is there, and not whole")));
            }
        }
        let output = self.run(&out, true).output().map_err(|e| e.to_string())?;
        if !output.status.success() {
            return Err(told(String::from_utf8_lossy(&output.stderr).into_owned()));
        }
        let found = self.files(&out);
        let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        if names(&found) != names(expected) {
            return Err(told(format!("files are {:?}; expected {:?}", names(&found), names(expected))));
        }
        if let Some((name, _)) = found.iter().find(|(name, bytes)| expected.get(*name) != Some(bytes)) {
            return Err(told(format!("`{name}` differs from that of an uninterrupted run")));
        }
        std::fs::remove_dir_all(self.root.join(out)).map_err(|e| e.to_string())
    }

    /// All files of an output folder, hidden ones too, without what tells the time.
    fn files(&self, out: &str) -> BTreeMap<String, Vec<u8>> {
        let root = self.root.join(out);
        let mut files = BTreeMap::new();
        let mut open = vec![root.clone()];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(folder).expect("a folder is listed") {
                let path = entry.expect("a folder is listed").path();
                if path.is_dir() {
                    open.push(path);
                } else {
                    let name = path.strip_prefix(&root).expect("it lies below").display().to_string();
                    files.insert(name, timeless(&path));
                }
            }
        }
        files
    }
}

fn command(program: &Path, root: &Path) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root).env_remove("SAGE_WEIGHTS").stdout(Stdio::null());
    command
}

/// A file without what tells how long something took.
fn timeless(path: &Path) -> Vec<u8> {
    let bytes = std::fs::read(path).expect("a file is read");
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let text = || String::from_utf8_lossy(&bytes).into_owned();
    if name == "last.safetensors" {
        let Ok((parameters, mut header)) = Parameters::load(path) else { return bytes };
        for note in header.notes.values_mut() {
            *note = json_without_times(note).unwrap_or_else(|| note.clone());
        }
        return parameters.to_bytes(&header).expect("weights are written");
    }
    match name.rsplit('.').next() {
        Some("json") => json_without_times(&text()).map_or(bytes, String::into_bytes),
        Some("csv") => csv_without_times(&text()).into_bytes(),
        // "12.3 ms a scene" is all that a page says of time.
        Some("html") => {
            let words: Vec<String> =
                text().lines().filter(|line| !line.contains(" ms a scene")).map(str::to_owned).collect();
            words.join("\n").into_bytes()
        }
        _ => bytes,
    }
}

fn json_without_times(text: &str) -> Option<String> {
    fn clear(value: &mut Value) {
        match value {
            Value::Object(map) => {
                ["seconds", "core_seconds"].iter().for_each(|key| drop(map.remove(*key)));
                map.values_mut().for_each(clear);
            }
            Value::Array(items) => items.iter_mut().for_each(clear),
            _ => {}
        }
    }
    let mut value = serde_json::from_str(text).ok()?;
    clear(&mut value);
    Some(value.to_string())
}

/// Columns are counted from the end: names of the first ones hold commas.
fn csv_without_times(text: &str) -> String {
    let place = |line: &str| line.rsplit(',').position(|column| column == "seconds");
    let Some(place) = text.lines().next().and_then(place) else { return text.to_owned() };
    let keep = |line: &str| {
        let cells: Vec<&str> =
            line.rsplit(',').enumerate().filter(|(k, _)| *k != place).map(|(_, cell)| cell).collect();
        cells.join(",")
    };
    text.lines().map(keep).collect::<Vec<_>>().join("\n")
}
