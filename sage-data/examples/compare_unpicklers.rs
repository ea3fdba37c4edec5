//! Compares our pickle reader with CPython's on generated programs.
//!
//! ```sh
//! cargo run --release -p sage-data --example compare_unpicklers -- 1000000
//! ```
//! Ends with an error at the first program that both read to different values. CPython executes nothing:
//! globals have stand-ins.

#![allow(clippy::print_stderr)] // A command-line program.

use std::process::ExitCode;

#[path = "../tests/differential/mod.rs"]
mod differential;

fn main() -> ExitCode {
    let Some(count) = std::env::args().nth(1).and_then(|n| n.parse::<u64>().ok()) else {
        eprintln!("usage: compare_unpicklers COUNT");
        return ExitCode::from(2);
    };
    if !differential::has_python() {
        eprintln!("NOTHING WAS COMPARED: there is no python3 with its C unpickler");
        return ExitCode::SUCCESS;
    }
    match differential::compare(count) {
        Ok(found) => {
            let opcodes = found.opcodes.len();
            eprintln!(
                "{} programs: {} accepted and read to the same value, {} refused; {opcodes} of {} opcodes and {} programs with MEMOIZE after a gap among the accepted",
                found.programs,
                found.accepted,
                found.programs - found.accepted,
                differential::OPCODES.len(),
                found.memoizes_after_gap
            );
            ExitCode::SUCCESS
        }
        Err(difference) => {
            eprintln!("error: {difference}");
            ExitCode::FAILURE
        }
    }
}
