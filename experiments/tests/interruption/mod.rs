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

/// Names and arguments of the commands, and of the studies behind them, which are killed on request.
const TABLE: &str = include_str!("commands.table");

/// The names of the commands; with `all`, also those of the studies.
pub fn commands(all: bool) -> Vec<&'static str> {
    let lines = TABLE.lines().take_while(|line| all || !line.starts_with("# --"));
    lines
        .filter_map(|line| line.split_once(" | "))
        .map(|(name, _)| name)
        .filter(|name| !name.starts_with('#'))
        .collect()
}

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
        if ["suite", "report"].contains(&name) {
            prepare(&[
                "search",
                "scenes",
                "--ego",
                "idm",
                "--budget",
                "8",
                "--weights",
                "procedural",
                "--out",
                "failures",
            ]);
        }
        std::fs::write(root.join("quick.json"), r#"{"epochs": 2, "candidates": 16}"#)
            .expect("a file is written");
        let row = TABLE.lines().filter_map(|line| line.split_once(" | ")).find(|(known, _)| *known == name);
        let (_, words) = row.unwrap_or_else(|| panic!("no case for `{name}`"));
        let arguments = words.split(' ').map(str::to_owned).collect();
        Self {
            program: program.to_owned(),
            root: root.to_owned(),
            arguments,
            needs_force: ["calibrate", "scenes", "demo", "suite", "report"].contains(&name),
        }
    }

    /// The command with an output folder, which is there already; `calibrate` writes a file into it.
    fn run(&self, out: &str, again: bool) -> Command {
        std::fs::create_dir_all(self.root.join(out)).expect("a folder is made");
        let mut run = command(&self.program, &self.root);
        let target =
            if self.arguments[0] == "calibrate" { format!("{out}/dial.json") } else { out.to_owned() };
        run.args(&self.arguments).args(["--out", &target]);
        // A run that was killed goes on by itself; one that was finished is not written over.
        let is_unfinished = self.root.join(out).join(".sage-unfinished").exists();
        if again && self.needs_force && !is_unfinished {
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
            let passing = ".state run.json last.safetensors prior.safetensors curve.csv curve.svg checkpoint.safetensors .rows";
            if name.contains(".sage-") || passing.split(' ').any(|ending| name.ends_with(ending)) {
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
