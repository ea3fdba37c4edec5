//! Whether a change moves a value: runs many commands with two programs and compares all that they write.
//!
//! ```sh
//! cargo build --release && cp target/release/sage target/before     # of the first commit
//! cargo run --release -p experiments --example safety_net -- target/net target/before target/release/sage [--quick] [--without=FIELD,...] [DATA]
//! ```
//!
//! Each command runs in a folder of its own, `target/net/<program>/<case>`; what the first program wrote is kept and used again.
//! Values are compared, not bytes: numbers and texts of JSON and CSV, tensors of safetensors files, and other files as a whole.
//! Times, hashes of runs and what names the program are left out. `--quick` takes two minutes. With DATA, a folder of recorded scenes, it
//! is attacked and driven too. `--without=FIELD,...` leaves out fields of JSON that a change takes away. The exit status is 1 if a value differs.

// A program for maintainers: what goes wrong ends it with a message.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)]

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use serde_json::Value;

/// Fields that differ from run to run, or name the program.
const VOLATILE: [&str; 11] = [
    "step_ms",
    "seconds",
    "core_seconds",
    "per_attack",
    "program",
    "version",
    "run_hash",
    // Files of a run hold its hash.
    "blake3",
    "full_command",
    // It names the folder of the run.
    "inputs",
    "threads",
];
/// What every case may read: made once by each program.
const SCENES: &str = "../scenes/out";

/// A command: the name of its folder, its words, and whether the quick part has it.
struct Case {
    name: String,
    words: Vec<String>,
    is_quick: bool,
}

fn case(name: &str, words: &str, is_quick: bool) -> Case {
    // Options in JSON hold no spaces.
    Case { name: name.to_owned(), words: words.split(' ').map(str::to_owned).collect(), is_quick }
}

/// All commands, in their order; later ones may read what earlier ones wrote.
fn cases(data: Option<&str>) -> Vec<Case> {
    let mut all = vec![case("scenes", "scenes --seed 1 --count 42 --out out", true)];
    let mut sets = vec![("demo", SCENES)];
    sets.extend(data.map(|data| ("data", data)));
    for (set, scenes) in sets {
        let is_demo = set == "demo";
        for method in ["sage", "king", "adv-traj-opt", "cat", "rule", "seal", "goose"] {
            let words = format!("generate {scenes} --method {method} --aggression 0:1:0.25 --json --out out");
            let is_quick = is_demo && ["sage", "cat"].contains(&method);
            all.push(case(&format!("{set}-generate-{method}"), &words, is_quick));
        }
        let egos = "replay,idm,r157,pdm,expert,td3";
        let words = format!("simulate {scenes} --ego {egos} --method sage --lambda 1 --json --out out");
        all.push(case(&format!("{set}-simulate"), &words, is_demo));
        for ego in ["idm", "pdm"] {
            let words = format!("search {scenes} --ego {ego} --budget 64 --out out");
            all.push(case(&format!("{set}-search-{ego}"), &words, is_demo && ego == "idm"));
        }
        let suite = format!("suite ../{set}-search-idm/out ../{set}-search-pdm/out --out out");
        all.push(case(&format!("{set}-suite"), &suite, false));
        for ego in ["idm", "expert"] {
            all.push(case(
                &format!("{set}-test-{ego}"),
                &format!("test ../{set}-suite/out --ego {ego} --json"),
                false,
            ));
        }
        all.push(case(
            &format!("{set}-report"),
            &format!("report ../{set}-search-idm/out --out out"),
            is_demo,
        ));
        all.push(case(&format!("{set}-inspect"), &format!("inspect {scenes} --json"), is_demo));
    }
    let row = "../demo-generate-sage/out/four-way-1-3-aggression1.00.json";
    all.push(case("predict", &format!("predict {SCENES}/four-way-1-3.safetensors --json"), false));
    all.push(case("explain", &format!("explain {row} --json"), true));
    for format in ["native", "pickle", "gpudrive", "womd", "openscenario"] {
        all.push(case(
            &format!("convert-{format}"),
            &format!("convert {SCENES} --to {format} --out out"),
            false,
        ));
    }
    for study in STUDIES {
        all.push(case(&format!("bench-{study}"), &format!("bench {study} --procedural 12 --out out"), false));
    }
    for (name, words) in TRAININGS {
        all.push(case(name, words, false));
    }
    all
}

/// Studies that run in a minute.
const STUDIES: [&str; 9] =
    ["open-loop", "drivers", "front", "pareto", "dial", "latest-start", "search", "threshold", "transfer"];

/// One short training of each kind.
const TRAININGS: [(&str, &str); 7] = [
    ("pretrain", "pretrain --procedural 24 --epochs 1 --out out"),
    ("finetune", "finetune --procedural 24 --prior procedural --out out"),
    ("calibrate", "calibrate --procedural 24 --weights procedural --out out.json"),
    (
        "train-td3",
        r#"train-ego --procedural 12 --method sage --updates 400 --evaluations 1 --config {"td3":{"hidden":[16,16],"batch":32,"random_steps":200}} --seeds 0..1 --out out"#,
    ),
    (
        "train-ppo",
        "train-ego --learner ppo --procedural 12 --method none --steps 8192 --evaluations 1 --seeds 0..1 --out out",
    ),
    ("train-seal", "train-adversary seal --procedural 12 --out out"),
    ("train-goose", "train-adversary goose --procedural 12 --out out"),
];

fn main() -> ExitCode {
    let mut words: Vec<String> = std::env::args().skip(1).collect();
    let is_quick = words.iter().any(|word| word == "--quick");
    let without = words.iter().find_map(|word| word.strip_prefix("--without=")).map(str::to_owned);
    let left_out: Vec<&str> =
        VOLATILE.into_iter().chain(without.iter().flat_map(|all| all.split(','))).collect();
    words.retain(|word| !word.starts_with("--"));
    let [net, before, after, data @ ..] = &words[..] else {
        eprintln!("usage: safety_net FOLDER BEFORE AFTER [--quick] [--without=FIELD,...] [DATA]");
        return ExitCode::from(2);
    };
    let absolute = |path: &String| fs::canonicalize(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    let data = data.first().map(|data| absolute(data).display().to_string());
    let mut all = cases(data.as_deref());
    all.retain(|case| case.is_quick || !is_quick);
    let folders = ["before", "after"].map(|name| PathBuf::from(net).join(name));
    if folders[1].exists() {
        fs::remove_dir_all(&folders[1]).unwrap();
    }
    let (mut values, mut differences) = (0, Vec::new());
    for case in &all {
        for (program, folder) in [before, after].map(absolute).iter().zip(&folders) {
            run(program, &folder.join(&case.name), case);
        }
        let [expected, found] =
            folders.each_ref().map(|folder| values_of(&folder.join(&case.name), &left_out));
        let differing = differing(&expected, &found);
        println!("{}: {} values, {} differ", case.name, expected.len(), differing.len());
        values += expected.len();
        differences.extend(differing.into_iter().map(|place| format!("{}/{place}", case.name)));
    }
    for difference in differences.iter().take(40) {
        println!("  {difference}");
    }
    println!("{values} values of {} commands, {} differ", all.len(), differences.len());
    if differences.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Runs a case, unless it was run before. Its output and exit status are values too.
fn run(program: &Path, folder: &Path, case: &Case) {
    let (status, words) = (folder.join("status.txt"), case.words.join(" "));
    if fs::read_to_string(&status).is_ok_and(|known| known.starts_with(&format!("{words}\n"))) {
        return;
    }
    if folder.exists() {
        fs::remove_dir_all(folder).unwrap();
    }
    fs::create_dir_all(folder).unwrap();
    let output = Command::new(program).args(&case.words).current_dir(folder).output().unwrap();
    // A driver may fail its test; another command that fails compares nothing.
    assert!(
        output.status.success() || words.starts_with("test "),
        "{words}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    fs::write(folder.join("stdout.jsonl"), &output.stdout).unwrap();
    fs::write(folder.join("stderr.log"), &output.stderr).unwrap();
    fs::write(&status, format!("{words}\n{:?}", output.status.code())).unwrap();
}

/// Values of all files of a folder by their places.
fn values_of(folder: &Path, left_out: &[&str]) -> BTreeMap<String, String> {
    let mut values = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
            continue;
        }
        let name = path.strip_prefix(folder).unwrap().display().to_string();
        let bytes = fs::read(&path).unwrap();
        let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        match &*ending {
            // Progress holds times.
            "log" => {}
            "json" | "jsonl" => of_json(&name, &bytes, left_out, &mut values),
            "csv" => of_csv(&name, &String::from_utf8_lossy(&bytes), &mut values),
            "safetensors" | "scene" => of_tensors(&name, &bytes, &mut values),
            // Pages and notes say how long a run took.
            _ => drop(values.insert(name, blake3::hash(&bytes).to_hex().to_string())),
        }
    }
    values
}

fn of_json(name: &str, bytes: &[u8], left_out: &[&str], values: &mut BTreeMap<String, String>) {
    for (k, value) in serde_json::Deserializer::from_slice(bytes).into_iter::<Value>().enumerate() {
        match value {
            Ok(value) => leaves(&format!("{name}:{k}"), &value, left_out, values),
            // Printed lines that are no JSON: tables.
            Err(_) => drop(values.insert(name.to_owned(), without_times(&String::from_utf8_lossy(bytes)))),
        }
    }
}

fn leaves(place: &str, value: &Value, left_out: &[&str], values: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields.iter().filter(|(key, _)| !left_out.contains(&&***key)) {
                leaves(&format!("{place}.{key}"), value, left_out, values);
            }
        }
        Value::Array(items) => {
            for (k, item) in items.iter().enumerate() {
                leaves(&format!("{place}[{k}]"), item, left_out, values);
            }
        }
        leaf => drop(values.insert(place.to_owned(), leaf.to_string())),
    }
}

fn of_csv(name: &str, text: &str, values: &mut BTreeMap<String, String>) {
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let times: BTreeSet<usize> = (0..head.len()).filter(|k| head[*k].contains("seconds")).collect();
    // Rows of times have their unit.
    for (k, line) in lines.enumerate().filter(|(_, line)| !line.contains(",ms,")) {
        let kept = line.split(',').enumerate().filter(|(column, _)| !times.contains(column));
        values.insert(format!("{name}:{k}"), kept.map(|(_, cell)| cell).collect::<Vec<_>>().join(","));
    }
}

/// Tensors by name, type and shape; words beside them may name the program.
fn of_tensors(name: &str, bytes: &[u8], values: &mut BTreeMap<String, String>) {
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: BTreeMap<String, Value> = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    for (tensor, about) in header.iter().filter(|(tensor, _)| *tensor != "__metadata__") {
        let [from, to] = [0, 1].map(|k| about["data_offsets"][k].as_u64().unwrap() as usize + 8 + length);
        let hash = blake3::hash(&bytes[from..to]).to_hex().to_string();
        values.insert(format!("{name}:{tensor}"), format!("{} {} {hash}", about["dtype"], about["shape"]));
    }
}

/// A printed text without times, such as `(397 ms)`.
fn without_times(text: &str) -> String {
    let mut kept: Vec<&str> = Vec::new();
    for word in text.split_whitespace() {
        if ["ms)", "s)"].contains(&word) && kept.last().is_some_and(|before| before.starts_with('(')) {
            kept.pop();
        } else {
            kept.push(word);
        }
    }
    kept.join(" ")
}

fn differing(expected: &BTreeMap<String, String>, found: &BTreeMap<String, String>) -> Vec<String> {
    let places: BTreeSet<&String> = expected.keys().chain(found.keys()).collect();
    let shown = |value: Option<&String>| value.map_or("nothing".to_owned(), |v| v.chars().take(60).collect());
    let differs = |place: &&&String| expected.get(**place) != found.get(**place);
    let both =
        |place: &&String| format!("{place}: {} -> {}", shown(expected.get(*place)), shown(found.get(*place)));
    places.iter().filter(differs).map(both).collect()
}
