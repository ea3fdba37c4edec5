//! Kills `sage` at random moments, runs the same command again, and compares what is left with an
//! uninterrupted run.
//!
//! ```sh
//! cargo build --release && cargo run --release -p experiments --example kill_anywhere -- 100 [COMMAND …]
//! ```
//! Commands are those of `tests/interruption/commands.table`, by default without the studies at its end. Ends with an error at the first difference.

#![allow(clippy::print_stderr)] // A program of its own, read by a person.

use std::{path::PathBuf, process::ExitCode};

#[path = "../tests/interruption/mod.rs"]
mod interruption;

use interruption::{Case, commands};

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let Some(count) = arguments.next().and_then(|n| n.parse::<u64>().ok()) else {
        eprintln!("usage: kill_anywhere COUNT [COMMAND …]");
        return ExitCode::from(2);
    };
    let chosen: Vec<String> = arguments.collect();
    let own = std::env::current_exe().unwrap_or_default();
    let program: PathBuf = own.ancestors().nth(2).unwrap_or(&own).join("sage");
    if !program.is_file() {
        eprintln!("`{}` is not there: build it first", program.display());
        return ExitCode::FAILURE;
    }
    let known = commands(true);
    if let Some(other) = chosen.iter().find(|name| !known.contains(&name.as_str())) {
        eprintln!("no command `{other}`; known: {}", known.join(", "));
        return ExitCode::from(2);
    }
    let chosen: Vec<&str> =
        if chosen.is_empty() { commands(false) } else { chosen.iter().map(String::as_str).collect() };
    for name in chosen {
        let Ok(folder) = tempfile::tempdir() else {
            eprintln!("no temporary folder can be made");
            return ExitCode::FAILURE;
        };
        let case = Case::new(&program, name, folder.path());
        let (expected, time) = case.whole();
        for number in 0..count {
            if let Err(problem) = case.kill_and_run_again(number, time, &expected) {
                eprintln!("error: {name}: {problem}");
                return ExitCode::FAILURE;
            }
        }
        eprintln!(
            "{name}: {count} kills within {:.1} s, {} files the same each time",
            time.as_secs_f64(),
            expected.len()
        );
    }
    ExitCode::SUCCESS
}
