//! The pages of `docs/reference` are what the program says. `SAGE_UPDATE=1` writes them anew.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{fmt::Write, fs, path::Path, process::Command};

use clap::CommandFactory;
use program::{sage, stdout};
use sage_data::Format;
use serde_json::{Map, Value};

const UPDATE: &str = "SAGE_UPDATE=1 cargo test --release -p experiments --test reference_pages";

/// Compares a page with what it should be, or writes it.
fn check(page: &str, title: &str, about: &str, body: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/reference").join(page);
    let text = format!("# {title}\n\n{about}\n\n<!-- Made by `{UPDATE}`. -->\n\n{}\n", body.trim_end());
    if std::env::var_os("SAGE_UPDATE").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, text).unwrap();
        return;
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    let differs = found.lines().zip(text.lines()).find(|(found, expected)| found != expected);
    assert!(
        found == text,
        "docs/reference/{page} is out of date; run `{UPDATE}`; first difference: {differs:?}"
    );
}

/// A help text, 100 columns wide.
fn help(words: &[&str]) -> Option<String> {
    let run = Command::new(env!("CARGO_BIN_EXE_sage")).args(words).env("COLUMNS", "100").output().unwrap();
    run.status.success().then(|| stdout(&run).to_owned())
}

/// Sections of a command and of the commands under it.
fn sections(words: &[&str], command: &clap::Command, out: &mut String) {
    let has_own = command.get_arguments().any(|arg| arg.get_id() != "help");
    if !words.is_empty() && (has_own || !command.has_subcommands()) {
        // A command of which `--help` shows all has no other option.
        let [all, short] = ["--help-all", "--help"].map(|option| help(&[words, &[option]].concat()));
        let help = all.or(short).unwrap();
        let _ = write!(out, "## sage {}\n\n```text\n{}\n```\n\n", words.join(" "), help.trim_end());
    }
    for sub in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
        sections(&[words, &[sub.get_name()]].concat(), sub, out);
    }
}

#[test]
fn commands() {
    let mut body = format!("```text\n{}\n```\n\n", help(&["--help"]).unwrap().trim_end());
    sections(&[], &experiments::Cli::command(), &mut body);
    let about = "Every command with all of its options. `--help` shows those that most people need, `--help-all` all.";
    check("commands.md", "Commands", about, &body);
}

/// A text within a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

/// Options with their defaults.
fn options(options: &Map<String, Value>) -> String {
    let one = |(name, value): (&String, &Value)| format!("`{name}` = `{value}`");
    options.iter().map(one).collect::<Vec<_>>().join("; ")
}

#[test]
fn parts() {
    let output = sage(&["list", "--json"]);
    let mut body = String::new();
    let mut kind = String::new();
    for row in stdout(&output).lines().map(|line| serde_json::from_str::<Value>(line).unwrap()) {
        let text = |key: &str| row[key].as_str().unwrap_or_default();
        if text("kind") != kind {
            kind = text("kind").to_owned();
            let _ = write!(
                body,
                "\n## {kind}\n\n| name | what | options and defaults | source |\n| --- | --- | --- | --- |\n"
            );
        }
        let options = row["options"].as_object().map(options).unwrap_or_default();
        let [name, summary, options, source] =
            [text("name"), text("summary"), &options, text("source")].map(cell);
        let _ = writeln!(body, "| `{name}` | {summary} | {options} | {source} |");
    }
    let about = "All registered parts, as `sage list` shows them. Options are given in braces: `--method 'sage{\"candidates\": 64}'`. \
        Parts of your own are listed beside them ([extending](../extending.md)).";
    check("parts.md", "Parts", about, body.trim_start());
}

#[test]
fn formats() {
    let mut body = "| name | endings | read | written | what |\n| --- | --- | --- | --- | --- |\n".to_owned();
    let yes = |is: bool| if is { "yes" } else { "no" };
    for format in Format::ALL {
        let (name, ending) = (format.name(), format.ending());
        let _ = writeln!(
            body,
            "| `{name}` | `.{ending}` | {} | {} | {} |",
            yes(format.is_read()),
            yes(format.is_written()),
            cell(format.about())
        );
    }
    let about = "Formats of scene files. The content alone decides what a file is, whatever its ending. What each holds is on the page of \
        [formats](../formats.md); what a single scene has (edges, lights, speed limits, heights, sizes), `sage inspect` says.";
    check("formats.md", "Formats", about, &body);
}

/// Constants that limit what is read or made, by the file that has them.
const LIMITS: [(&str, &[&str]); 33] = [
    ("sage-data/src/recording.rs", &["MAX_SCENE_FILE"]),
    ("sage-data/src/folder.rs", &["MAX_LEVELS"]),
    ("sage-data/src/split.rs", &["LIMIT"]),
    ("sage-data/src/gzip.rs", &["MAX_EXPANSION"]),
    ("sage-data/src/pickle.rs", &["MAX_DEPTH", "MAX_NODES", "LEAST_NODES"]),
    ("sage-data/src/womd/tfrecord.rs", &["MAX_RECORD", "MAX_RECORDS", "MOST_EMPTY"]),
    ("sage-data/src/metadrive/decode.rs", &["MAX_FRAMES"]),
    ("sage-data/src/repairs/resample.rs", &["MOST_STATES"]),
    ("sage-data/src/map_limits.rs", &["MAX_LINES", "MOST_POINTS"]),
    ("sage-data/src/dataset.rs", &["MOST_SHARDS"]),
    ("sage-core/src/geometry.rs", &["MAX_COORDINATE"]),
    ("sage-core/src/motion/path_limits.rs", &["MAX_STEP", "MAX_PATH"]),
    ("sage-core/src/objective/spec.rs", &["MOST_TERMS", "MAX_WEIGHT"]),
    ("sage-backbones/src/parameters/file.rs", &["LIMIT", "HEADER_LIMIT"]),
    ("sage-sim/src/actor/policy_file.rs", &["MAX_POLICY_FILE"]),
    ("sage-sim/src/policy/path.rs", &["MAX_DRIVES"]),
    ("sage-learn/src/checkpoint.rs", &["MAX_CHECKPOINT"]),
    ("advsage/src/operating_point.rs", &["MOST_VALUES"]),
    ("sage-run/src/input.rs", &["CONFIG_LIMIT"]),
    ("sage-run/src/scenes.rs", &["MEMORY_LIMIT"]),
    ("experiments/src/candidates.rs", &["LIMIT"]),
    ("experiments/src/commands/merge/recipe.rs", &["LIMIT", "MOST_MODELS"]),
    ("experiments/src/commands/finetune.rs", &["MOST_PREPARED"]),
    ("sage-bench/src/study.rs", &["MOST_PROCEDURAL", "MOST_UNTRAINED", "MOST_DRIVES"]),
    ("experiments/src/cli.rs", &["MOST_COUNT"]),
    ("sage-data/src/argoverse2/edges.rs", &["MOST_PAIRS"]),
    ("sage-data/src/lane_polygon.rs", &["MOST"]),
    ("sage-data/src/lane_links.rs", &["MOST"]),
    ("sage-data/src/opendrive/links.rs", &["MOST_PASSED", "MOST_EXITS"]),
    ("sage-view/src/player/map.rs", &["CHUNK"]),
    ("sage-sim/src/policy/r157.rs", &["MOST_LOOKED"]),
    ("sage-sim/src/route_lights.rs", &["MOST"]),
    ("sage-sim/src/search/pool.rs", &["MOST_PLANS"]),
];
/// Work that is a product of two lists of a file, and what bounds it.
const PRODUCTS: &str = include_str!("products.table");
/// Kinds of warnings about scenes.
const WARNINGS: &str = include_str!("warnings.table");

/// The value of a constant and what is said of it.
fn constant(file: &str, name: &str) -> (String, String) {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(file)).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let declaration = format!("const {name}: ");
    let at = lines.iter().position(|line| line.contains(&declaration)).expect(name);
    let value = lines[at].split_once(" = ").unwrap().1.trim_end_matches(';').replace('_', "");
    let value = match value.split_once(" << ") {
        Some((number, bits)) => {
            1u64.checked_shl(bits.parse().unwrap()).unwrap() * number.parse::<u64>().unwrap()
        }
        None => value.parse::<f64>().unwrap() as u64,
    };
    let before = lines[..at].iter().rev().map_while(|line| line.trim_start().strip_prefix("///"));
    let mut said: Vec<&str> = before.map(str::trim).collect();
    said.reverse();
    let said = said.join(" ");
    let in_bytes = said.contains("bytes");
    (grouped(value) + &binary(value).filter(|_| in_bytes).unwrap_or_default(), said)
}

/// A number with its digits in groups.
fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let gap = |k: usize| (k > 0 && (digits.len() - k).is_multiple_of(3)).then_some(' ');
    digits.char_indices().flat_map(|(k, c)| gap(k).into_iter().chain([c])).collect()
}

/// A number of bytes in binary units.
fn binary(value: u64) -> Option<String> {
    let units = [(30, "GiB"), (20, "MiB"), (10, "KiB")];
    let unit = units.iter().find(|(bits, _)| value >= 1 << bits && value.is_multiple_of(1 << bits));
    unit.map(|(bits, unit)| format!(" ({} {unit})", value >> bits))
}

#[test]
fn limits() {
    let mut body = "| what | limit | constant |\n| --- | --- | --- |\n".to_owned();
    for (file, names) in LIMITS {
        for name in names {
            let (value, said) = constant(file, name);
            let _ = writeln!(body, "| {} | {value} | `{name}` in `{file}` |", cell(&said));
        }
    }
    body += "\n## Products\n\nWork on a file that is a product of two of its lists, and what bounds it.\n\n";
    body += "| what | place | bound |\n| --- | --- | --- |\n";
    for line in PRODUCTS.lines().filter(|line| !line.starts_with('#')) {
        let [what, place, bound] = line.split(" | ").collect::<Vec<_>>().try_into().unwrap();
        let (file, name) = place.split_once(' ').unwrap();
        let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(file)).unwrap();
        assert!(text.contains(name), "{line}");
        let _ = writeln!(body, "| {what} | `{name}` in `{file}` | {bound} |");
    }
    let about = "Limits of what is read and made, so that memory and time stay bounded whatever a file holds \
        ([security](../../SECURITY.md)).";
    check("limits.md", "Limits", about, &body);
}

#[test]
fn warnings() {
    let mut body = String::new();
    let (mut group, mut kinds) = ("", Vec::new());
    for line in WARNINGS.lines().filter(|line| !line.starts_with('#')) {
        let [of, kind, text] = line.split(" | ").collect::<Vec<_>>().try_into().unwrap();
        if of != group {
            let _ = write!(body, "\n## {of}\n\n| warning | what it means |\n| --- | --- |\n");
            group = of;
        }
        let _ = writeln!(body, "| `{kind}` | {text} |");
        kinds.push(kind);
    }
    // Every kind that the reader can give is on the page.
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let files = ["sage-data/src/checks.rs", "sage-data/src/contradictions.rs", "sage-data/src/headings.rs"];
    let mut found = 0;
    for file in files.iter().chain(&["sage-core/src/scene/note.rs"]) {
        let text = fs::read_to_string(root.join(file)).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        for begin in ["warn(\"", ".warning(\"", "Warning::new(\"", "=> \""] {
            let names = text.split(begin).skip(1).filter_map(|rest| rest.split('"').next());
            for name in names.filter(|name| name.contains('-') && !name.contains(' ')) {
                assert!(kinds.contains(&name), "{file}: the warning `{name}` is not in warnings.table");
                found += 1;
            }
        }
    }
    assert!(found > 25, "{found} kinds found in the sources");
    let about = "Nothing is repaired silently, and a warning stops no command. `sage inspect` prints all; `score`, `predict`, `generate`, \
        `simulate` and `bench` print and count those that change a result.";
    check("warnings.md", "Warnings about scenes", about, &body);
}
