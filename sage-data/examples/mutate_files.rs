//! Reads any number of broken and hostile scene files and counts the results.
//!
//! ```sh
//! cargo run --release -p sage-data --example mutate_files -- [--native|--records|--json] 100000 [SCENE.pkl …]
//! ```
//! Ends with an error at the first panic, at the first accepted hostile file, or when the whole program
//! needs more than 256 MiB.

#![allow(clippy::print_stderr)] // A command-line program.

use std::{alloc::System, collections::BTreeMap, process::ExitCode};

#[path = "../tests/mutation/mod.rs"]
#[allow(dead_code)] // The tests use all of it.
mod mutation;

use mutation::{Mutator, Outcome};

#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, 256 << 20);

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    let natively = arguments.next_if_eq("--native").is_some();
    let as_records = arguments.next_if_eq("--records").is_some();
    let as_json = arguments.next_if_eq("--json").is_some();
    let Some(count) = arguments.next().and_then(|n| n.parse::<u64>().ok()) else {
        eprintln!("usage: mutate_files [--native|--records|--json] COUNT [SCENE.pkl …]");
        return ExitCode::from(2);
    };
    let files: Vec<String> = arguments.collect();
    let read: Result<Vec<Vec<u8>>, std::io::Error> = files.iter().map(std::fs::read).collect();
    let mut bases = match read {
        Ok(bases) => bases,
        Err(error) => {
            eprintln!("error: cannot read a scene: {error}");
            return ExitCode::FAILURE;
        }
    };
    bases.push(include_bytes!("../../examples/crossing.pkl").to_vec());
    bases.push(include_bytes!("../tests/data/small_p2_core.pkl").to_vec());
    bases.push(include_bytes!("../tests/data/newest_p5.pkl").to_vec());
    let native: Result<Vec<Vec<u8>>, sage_data::Error> = bases
        .iter()
        .map(|bytes| sage_data::Recording::from_bytes("base".as_ref(), bytes.clone())?.to_native())
        .collect();
    let native = match native {
        Ok(native) => Mutator::new(native),
        Err(error) => {
            eprintln!("error: {error}");
            return ExitCode::FAILURE;
        }
    };
    let pickles = Mutator::new(bases);
    let messages = mutation::messages(include_bytes!("../tests/data/womd_synthetic.tfrecord"));
    let messages = Mutator::new(messages);
    let json = Mutator::new(mutation::scenes());
    let mut rows: BTreeMap<&str, [u64; 2]> = BTreeMap::new();
    let mut slowest: f64 = 0.0;
    for number in 0..count {
        let (mutant, (outcome, seconds)) = if as_records {
            let mutant = messages.make_message(number);
            let outcome = mutation::read_message(&mutant);
            (mutant, outcome)
        } else {
            let mutant = match (natively, as_json) {
                (true, _) => native.make_native(number),
                (_, true) => json.make_json(number),
                _ => pickles.make(number),
            };
            let outcome = mutation::read(&mutant);
            (mutant, outcome)
        };
        slowest = slowest.max(seconds);
        rows.entry(mutant.kind).or_default()[matches!(outcome, Outcome::Scene) as usize] += 1;
    }
    eprintln!("{:<16} {:>9} {:>9}", "mutation", "refused", "scenes");
    for (kind, [refused, scenes]) in &rows {
        eprintln!("{kind:<16} {refused:>9} {scenes:>9}");
    }
    let peak = ALLOCATOR.max_allocated() as f64 / f64::from(1 << 20);
    eprintln!("{count} files, slowest {:.1} ms, at most {peak:.0} MiB in use", slowest * 1e3);
    ExitCode::SUCCESS
}
