//! Runs `sage` on any number of mutated and crafted files, and checks that it ends cleanly and within limits.
//!
//! ```sh
//! cargo build --release && cargo run --release -p experiments --example hostile_limits -- 10000
//! cargo run --release -p experiments --example hostile_limits -- 100 --seed 7 --kind native --keep failed/
//! ```
//! A run ends cleanly if its exit code is 0, 1, 2 or 65, its message is short, and nothing outside the output folder
//! changed. For a file below 1 MB it takes at most 1 GB of memory, and `inspect`, `draw`, `generate` and `simulate` take
//! at most 5 s of processor time on one thread. The program ends with an error at the first run that does not, and
//! keeps its file. With `--limit-mb 1` every run fails.

#![allow(clippy::print_stderr)] // A program of its own, read by a person.
#![allow(clippy::unwrap_used, clippy::panic)] // What it makes for itself must work; it runs on no other input.

mod cases;
mod child;
#[path = "../../../sage-data/tests/mutants/mod.rs"]
mod mutants;
#[path = "../../tests/recipe/mod.rs"]
mod recipe;
mod scenes;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    process::ExitCode,
};

use cases::{Cases, kinds};
use child::{Limits, Used};

/// What the command line asks for.
struct Options {
    count: u64,
    seed: u64,
    kinds: Vec<&'static str>,
    keep: PathBuf,
    limits: Limits,
}

fn main() -> ExitCode {
    let Some(options) = options() else {
        eprintln!(
            "usage: hostile_limits COUNT [--seed S] [--kind NAME]… [--keep DIR] [--limit-mb N] [--limit-s N]\nkinds: {}",
            kinds().join(", ")
        );
        return ExitCode::from(2);
    };
    let own = std::env::current_exe().unwrap_or_default();
    let program = own.ancestors().nth(2).unwrap_or(&own).join("sage");
    if !program.is_file() {
        eprintln!("`{}` is not there: build it first", program.display());
        return ExitCode::FAILURE;
    }
    let folder = tempfile::tempdir().unwrap();
    let cases = Cases::new(&program, folder.path());
    let mut rows: BTreeMap<&str, Row> = BTreeMap::new();
    for number in 0..options.count {
        let kind = options.kinds[(number % options.kinds.len() as u64) as usize];
        match cases.run(kind, options.seed, number / options.kinds.len() as u64, &options.limits) {
            Ok(runs) => runs.iter().for_each(|used| rows.entry(kind).or_default().add(used)),
            Err(problem) => {
                let kept = keep(&cases.folder(), &options.keep);
                eprintln!(
                    "error: {kind}, seed {}, number {number}: {problem}\nthe files are in `{}`",
                    options.seed,
                    kept.display()
                );
                return ExitCode::FAILURE;
            }
        }
        if (number + 1).is_multiple_of(1000) {
            eprintln!("{} of {} files", number + 1, options.count);
        }
    }
    eprintln!(
        "{:<12} {:>7} {:>8} {:>8} {:>10} {:>9}",
        "kind", "runs", "refused", "accepted", "slowest s", "most MB"
    );
    for (kind, row) in &rows {
        eprintln!(
            "{kind:<12} {:>7} {:>8} {:>8} {:>10.2} {:>9.0}",
            row.runs,
            row.refused,
            row.runs - row.refused,
            row.slowest,
            row.most
        );
    }
    ExitCode::SUCCESS
}

/// Sums of a kind of files.
#[derive(Default)]
struct Row {
    runs: u64,
    refused: u64,
    slowest: f64,
    most: f64,
}

impl Row {
    fn add(&mut self, used: &Used) {
        self.runs += 1;
        self.refused += u64::from(used.code != 0);
        self.slowest = self.slowest.max(used.seconds);
        self.most = self.most.max(used.megabytes);
    }
}

fn options() -> Option<Options> {
    let mut arguments = std::env::args().skip(1);
    let mut options = Options {
        count: arguments.next()?.parse().ok()?,
        seed: 0,
        kinds: Vec::new(),
        keep: PathBuf::from("hostile-case"),
        limits: Limits::default(),
    };
    while let Some(flag) = arguments.next() {
        let value = arguments.next()?;
        match &flag[..] {
            "--seed" => options.seed = value.parse().ok()?,
            "--kind" => options.kinds.push(kinds().into_iter().find(|kind| *kind == value)?),
            "--keep" => options.keep = value.into(),
            "--limit-mb" => options.limits.megabytes = value.parse().ok()?,
            "--limit-s" => options.limits.seconds = value.parse().ok()?,
            _ => return None,
        }
    }
    if options.kinds.is_empty() {
        options.kinds = kinds();
    }
    Some(options)
}

/// Copies the files of a case. Returns where they are.
fn keep(from: &Path, to: &Path) -> PathBuf {
    let _ = std::fs::remove_dir_all(to);
    cases::copy(from, to);
    to.to_owned()
}
