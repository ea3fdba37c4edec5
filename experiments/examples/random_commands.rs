//! Runs random command lines of the commands that testers use, with options that exist and values that are good, bad or odd.
//!
//! ```sh
//! cargo build --release && cargo run --release -p experiments --example random_commands -- 2000 [SEED]
//! ```
//! Each must end within its time with an exit status that the program promises, say something, and write rows that do not
//! contradict themselves. Ends with an error after the last line if any did not.

#![allow(clippy::print_stderr)] // A program of its own, read by a person.

use std::{
    path::{Path, PathBuf},
    process::{Command, ExitCode, Output, Stdio},
    time::{Duration, Instant},
};

use clap::CommandFactory;
use sage_core::seed::Rng;
use serde_json::Value;

/// The commands, each with the inputs that it may take.
const COMMANDS: [(&str, &[&str]); 8] = [
    ("generate", &["scenes", "scenes/four-way-1-3.pkl", "mixed", "missing.pkl", "odd.json"]),
    ("simulate", &["scenes", "scenes/curve-1-1.pkl", "mixed"]),
    ("search", &["scenes/four-way-1-3.pkl", "scenes/merge-1-2.pkl"]),
    ("explain", &["scenes/four-way-1-3.pkl", "attacks/four-way-1-3-lambda1.00.json", "odd.json"]),
    ("convert", &["scenes", "mixed", "scenes/curve-1-1.pkl", "odd.json"]),
    ("suite", &["failures", "attacks"]),
    ("test", &["suite", "failures"]),
    ("report", &["failures", "suite"]),
];
/// Options whose effect is slow or outside of the folder.
const LEFT_OUT: [&str; 6] = ["help", "help_all", "version", "threads", "ego_timeout", "weights"];
/// Values for options that take any text, good ones first.
const VALUES: [&str; 24] = [
    "1",
    "0.5",
    "0,0.5",
    "0:1:0.5",
    "2",
    "idm",
    "expert",
    "replay",
    "sage",
    "rule",
    "linear",
    "natural",
    "drivable",
    "{}",
    "attack,believable",
    "1/2",
    "procedural",
    "attacks/four-way-1-3-lambda1.00.json",
    "-1",
    "nan",
    "",
    "\u{202e}x",
    "{\"candidates\": 8}",
    "99999999999999999999",
];
/// Exit statuses that the program promises: done, does not hold, wrong use, bad scenes, try again.
const PROMISED: [i32; 5] = [0, 1, 2, 65, 74];
/// Longest time of a line.
const LIMIT: Duration = Duration::from_secs(120);

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let Some(count) = arguments.next().and_then(|n| n.parse::<u64>().ok()) else {
        eprintln!("usage: random_commands COUNT [SEED]");
        return ExitCode::from(2);
    };
    let seed = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(1);
    let own = std::env::current_exe().unwrap_or_default();
    let program = own.ancestors().nth(2).unwrap_or(&own).join("sage");
    let Some(folder) = tempfile::tempdir().ok().filter(|folder| prepare(&program, folder.path())) else {
        eprintln!("the inputs cannot be made with `{}`: build it first", program.display());
        return ExitCode::FAILURE;
    };
    let (mut wrong, mut ends) = (0, [0u64; PROMISED.len()]);
    for number in 0..count {
        let words = line(&mut Rng::new(seed, &number.to_string(), "command line"));
        let out = folder.path().join("out");
        let _ = std::fs::remove_dir_all(&out);
        match run(&program, folder.path(), &words).and_then(|output| checked(&output, &out)) {
            Ok(place) => ends[place] += 1,
            Err(problem) => {
                wrong += 1;
                eprintln!("line {number}: sage {}: {problem}", words.join(" ").escape_debug());
            }
        }
    }
    let ends: Vec<String> =
        PROMISED.iter().zip(ends).map(|(status, count)| format!("{status}: {count}")).collect();
    eprintln!("{count} lines, {wrong} wrong; exit statuses {}", ends.join(", "));
    if wrong == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Makes the inputs: scenes, a folder with damaged ones among them, attacks, failures and a suite.
fn prepare(program: &Path, root: &Path) -> bool {
    let make = |words: &str| {
        let words: Vec<String> = words.split(' ').map(str::to_owned).collect();
        run(program, root, &words).is_ok_and(|output| output.status.success())
    };
    let is_made = make("scenes --count 4 --format pickle --out scenes")
        && make("generate scenes --lambda 1 --no-pages --out attacks")
        && make("search scenes --ego idm --budget 8 --out failures")
        && make("suite failures --out suite");
    let mixed = root.join("mixed");
    let copy = |name: &str| std::fs::copy(root.join("scenes").join(name), mixed.join(name)).map(drop);
    let damaged = [
        ("empty.pkl", &b""[..]),
        ("x.tfrecord", b""),
        ("cut.pkl", b"\x80\x04}"),
        ("text.safetensors", b"text"),
    ];
    let write = |(name, bytes): &(&str, &[u8])| std::fs::write(mixed.join(name), bytes);
    is_made
        && std::fs::create_dir(&mixed).is_ok()
        && copy("curve-1-1.pkl").is_ok()
        && damaged.iter().all(|file| write(file).is_ok())
        && std::fs::write(root.join("odd.json"), "{\"objects\": [], \"roads\": 1}").is_ok()
}

/// A command line.
fn line(rng: &mut Rng) -> Vec<String> {
    let pick = |rng: &mut Rng, count: usize| rng.below(count);
    let (name, inputs) = COMMANDS[pick(rng, COMMANDS.len())];
    let mut words = vec![name.to_owned(), inputs[pick(rng, inputs.len())].to_owned()];
    let cli = experiments::Cli::command();
    let Some(command) = cli.find_subcommand(name) else { return words };
    let options: Vec<&clap::Arg> = command
        .get_arguments()
        .filter(|arg| arg.get_long().is_some() && !LEFT_OUT.contains(&arg.get_id().as_str()))
        .collect();
    // Most lines have what they need, so that more than the reading of options is tried.
    if ["simulate", "search", "test"].contains(&name) {
        words.extend(["--ego".to_owned(), ["idm", "replay", "constant"][pick(rng, 3)].to_owned()]);
    }
    if name == "search" {
        words.extend(["--budget", "4"].map(str::to_owned));
    }
    if name == "convert" {
        words.extend([
            "--to".to_owned(),
            ["native", "pickle", "womd", "gpudrive", "openscenario"][pick(rng, 5)].to_owned(),
        ]);
    }
    for _ in 0..pick(rng, 5) {
        let option = options[pick(rng, options.len())];
        let long = option.get_long().unwrap_or_default();
        if words.contains(&format!("--{long}")) || long == "out" {
            continue;
        }
        words.push(format!("--{long}"));
        let takes_value = option.get_action().takes_values();
        let possible = option.get_possible_values();
        if takes_value && !possible.is_empty() {
            words.push(possible[pick(rng, possible.len())].get_name().to_owned());
        } else if takes_value {
            words.push(VALUES[pick(rng, VALUES.len())].to_owned());
        }
    }
    if !["explain", "test"].contains(&name) {
        words.extend(["--out", "out"].map(str::to_owned));
    }
    words
}

/// Runs a command line.
///
/// *Errors*: it cannot be run, or does not end.
fn run(program: &Path, root: &Path, words: &[String]) -> Result<Output, String> {
    let files = ["stdout", "stderr"].map(|name| root.join(name));
    let create =
        |path: &PathBuf| std::fs::File::create(path).map(Stdio::from).map_err(|error| error.to_string());
    let mut child = Command::new(program)
        .args(words)
        .current_dir(root)
        .env_remove("SAGE_WEIGHTS")
        .stdin(Stdio::null())
        .stdout(create(&files[0])?)
        .stderr(create(&files[1])?)
        .spawn()
        .map_err(|error| error.to_string())?;
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(|error| error.to_string())? {
            break status;
        }
        if start.elapsed() > LIMIT {
            let _ = child.kill().and_then(|()| child.wait());
            return Err(format!("no end within {} s", LIMIT.as_secs()));
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let [stdout, stderr] = files.map(|path| std::fs::read(path).unwrap_or_default());
    Ok(Output { status, stdout, stderr })
}

/// The place of the exit status among [`PROMISED`].
///
/// *Errors*: what is wrong with the end, with what it says, or with the rows in the output folder.
fn checked(output: &Output, out: &Path) -> Result<usize, String> {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let place = PROMISED.iter().position(|status| output.status.code() == Some(*status));
    let place = place.ok_or_else(|| format!("it ends with {:?}: {said}", output.status))?;
    if said.contains("panicked") {
        return Err(format!("a panic: {said}"));
    }
    let is_silent = said.trim().is_empty() && output.stdout.trim_ascii().is_empty();
    if is_silent {
        return Err(format!("it ends with {:?} and says nothing", output.status.code()));
    }
    if output.status.success() && said.contains("error:") {
        return Err(format!("it succeeds with an error: {said}"));
    }
    for entry in std::fs::read_dir(out).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.extension().is_some_and(|ending| ending == "json") {
            let row: Option<Value> =
                std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
            let row = row.ok_or_else(|| format!("`{}` is no JSON", path.display()))?;
            contradiction(&row).map_err(|problem| format!("`{}`: {problem}", path.display()))?;
        }
    }
    Ok(place)
}

/// *Errors*: what a row says that cannot be true together.
fn contradiction(row: &Value) -> Result<(), String> {
    let scores = &row["scores"];
    if row["outcome"] == "attack" && (scores["collision_step"].is_null() || row["feasible"] != true) {
        return Err("an attack without a contact, or not feasible".to_owned());
    }
    if scores["believable"] == true && (scores["collision_step"].is_null() || scores["feasible"] != true) {
        return Err("believable without a contact, or not feasible".to_owned());
    }
    let chain = ["drives", "attacks", "believable", "at_fault"].map(|key| row[key].as_u64());
    let counts: Vec<u64> = chain.into_iter().flatten().collect();
    if counts.len() == chain.len() && !counts.is_sorted_by(|a, b| a >= b) {
        return Err(format!("drives, attacks, believable and at fault are {counts:?}"));
    }
    Ok(())
}
