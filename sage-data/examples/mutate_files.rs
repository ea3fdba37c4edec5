//! Reads any number of broken and hostile scene files of each format and counts the results.
//!
//! ```sh
//! cargo run --release -p sage-data --example mutate_files -- 100000 [SCENE.pkl …]
//! ```
//! Ends with an error at the first panic, at the first accepted hostile file, or when the whole program
//! needs more than 256 MiB.

#![allow(clippy::print_stderr)] // A command-line program.

use std::{alloc::System, collections::BTreeMap, process::ExitCode};

#[path = "../tests/mutants/mod.rs"]
mod mutants;

#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, 256 << 20);

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let Some(count) = arguments.next().and_then(|n| n.parse::<u64>().ok()) else {
        eprintln!("usage: mutate_files COUNT [SCENE.pkl …]");
        return ExitCode::from(2);
    };
    let bases: Vec<Vec<u8>> = match arguments.map(std::fs::read).collect() {
        Ok(bases) => bases,
        Err(error) => {
            eprintln!("error: cannot read a scene: {error}");
            return ExitCode::FAILURE;
        }
    };
    let formats = if bases.is_empty() { mutants::formats::all() } else { mutants::formats::of(&bases) };
    eprintln!("{:<8} {:<16} {:>9} {:>9}", "format", "mutation", "refused", "scenes");
    let mut slowest: f64 = 0.0;
    for format in formats {
        let mut rows: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
        for number in 0..count {
            let mutant = format.mutant(number);
            let (is_scene, seconds) = format.read(&mutant);
            slowest = slowest.max(seconds);
            rows.entry(mutant.kind).or_default()[usize::from(is_scene)] += 1;
        }
        for (kind, [refused, scenes]) in &rows {
            eprintln!("{:<8} {kind:<16} {refused:>9} {scenes:>9}", format.name);
        }
    }
    let peak = ALLOCATOR.max_allocated() as f64 / f64::from(1 << 20);
    eprintln!("{count} files of each format, slowest {:.1} ms, at most {peak:.0} MiB in use", slowest * 1e3);
    ExitCode::SUCCESS
}
