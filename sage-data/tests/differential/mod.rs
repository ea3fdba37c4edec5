//! Our reader of pickles against CPython's C unpickler, on generated programs.
//!
//! Used by the test (20 000 programs) and by `cargo run --release -p sage-data --example
//! compare_unpicklers` (any number). CPython calls nothing: `recorded_unpickler.py` replaces all globals by
//! stand-ins.

mod canonical;
mod globals;
mod memo;
mod program;

use std::{
    collections::BTreeSet,
    io::{BufWriter, Write},
    path::Path,
    process::{Command, Stdio},
};

use sage_data::pickle::Document;

pub use program::{OPCODES, program};

/// Result of a comparison without a difference.
#[derive(Debug)]
pub struct Agreement {
    /// Number of programs.
    pub programs: u64,
    /// Number of those that our reader accepts and CPython reads to the same value.
    pub accepted: u64,
    /// Opcodes of the accepted programs.
    pub opcodes: BTreeSet<u8>,
    /// Number of accepted programs in which a MEMOIZE follows a gap.
    pub memoizes_after_gap: u64,
}

/// Whether CPython is available for the comparison.
pub fn has_python() -> bool {
    let run = Command::new("python3").args(["-I", "-c", "import _pickle"]).output();
    run.is_ok_and(|run| run.status.success())
}

/// Compares programs 0 to `count`.
///
/// *Errors*: the first program on which the readers disagree.
pub fn compare(count: u64) -> Result<Agreement, String> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/recorded_unpickler.py");
    let mut python = Command::new("python3")
        .arg("-I")
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| format!("python3 does not start: {error}"))?;
    let mut found =
        Agreement { programs: count, accepted: 0, opcodes: BTreeSet::new(), memoizes_after_gap: 0 };
    let mut pipe = BufWriter::new(python.stdin.take().ok_or("python3 has no standard input")?);
    for number in 0..count {
        let program = program(number);
        let Ok(document) = Document::parse(program.bytes.clone()) else { continue };
        let Some(text) = canonical::text(&document) else { continue };
        let mut send =
            |raw: &[u8]| pipe.write_all(&(raw.len() as u32).to_le_bytes()).and_then(|()| pipe.write_all(raw));
        if send(&program.bytes).and_then(|()| send(&text)).is_err() {
            // It ends at the first difference and reports it below.
            break;
        }
        found.accepted += 1;
        found.memoizes_after_gap += u64::from(program.memoizes_after_gap);
        found.opcodes.extend(program.opcodes);
    }
    drop(pipe);
    let output = python.wait_with_output().map_err(|error| error.to_string())?;
    let report = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    if report == found.accepted.to_string() && output.status.success() { Ok(found) } else { Err(report) }
}
