//! Broken and hostile pickles in any number, from a seed.
//!
//! Used by the test (2 000 of them), by `cargo run --release -p sage-data --example mutate_files` (any
//! number) and, one input at a time, by the fuzz target.

pub mod crafted;
mod globals;
mod json;
mod native;
mod records;
mod slices;

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::Arc,
    time::Instant,
};

use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Convention, Scorer},
    scene::{Scene, SceneIndex},
    seed::Rng,
};
use sage_data::{Error, Recording, Source, checks::Summary};

use crafted::{amplified, deep, memo_loop};
pub use globals::HOSTILE;
pub use json::scenes;
pub use records::{consume_message, messages};

/// Generator of seeded inputs.
pub struct Mutator {
    bases: Vec<Vec<u8>>,
}

/// An input, the kind of mutation, and the hostile global if it must be refused.
pub struct Mutant {
    pub bytes: Vec<u8>,
    pub kind: &'static str,
    pub hostile: Option<&'static str>,
}

impl Mutator {
    /// Mutates these files.
    pub fn new(bases: Vec<Vec<u8>>) -> Self {
        assert!(!bases.is_empty());
        Self { bases }
    }

    /// The input of a number.
    pub fn make(&self, number: u64) -> Mutant {
        let mut rng = Rng::new(number, "pickle", "mutation");
        let mut bytes = self.bases[rng.below(self.bases.len())].clone();
        let mut hostile = None;
        let kind = match rng.below(12) {
            0 | 1 => {
                for _ in 0..1 + rng.below(8) {
                    let at = rng.below(bytes.len());
                    bytes[at] ^= 1 << rng.below(8);
                }
                "bits flipped"
            }
            2 | 3 => {
                for _ in 0..1 + rng.below(6) {
                    let at = rng.below(bytes.len());
                    bytes[at] = rng.bits() as u8;
                }
                "bytes replaced"
            }
            4 => {
                bytes.truncate(rng.below(bytes.len()));
                "cut"
            }
            5 => {
                inflate(&mut bytes, &mut rng);
                "length inflated"
            }
            6 => {
                let from = rng.below(bytes.len());
                let to = (from + rng.below(200)).min(bytes.len());
                let slice = bytes[from..to].to_vec();
                let at = rng.below(bytes.len());
                match rng.below(2) {
                    0 => drop(bytes.drain(from..to)),
                    _ => bytes.splice(at..at, slice).for_each(drop),
                }
                "slice moved"
            }
            7 if rng.below(2) == 0 => {
                replace_digits(&mut bytes, &mut rng);
                "digits replaced"
            }
            7 => {
                let global = HOSTILE[rng.below(HOSTILE.len())];
                call(&mut bytes, global, &mut rng);
                hostile = Some(global);
                "hostile global"
            }
            8 => {
                bytes = deep(&mut rng);
                "deep nesting"
            }
            9 => {
                bytes = memo_loop(&mut rng);
                "memo loop"
            }
            10 => {
                bytes = amplified(&mut rng);
                "amplified"
            }
            _ => {
                replace_values(&mut bytes, &mut rng);
                "values replaced"
            }
        };
        Mutant { bytes, kind, hostile }
    }
}

/// Result of reading an input.
pub enum Outcome {
    Scene,
    Refused,
}

/// Reads an input and uses the result. Panics if reading panics, if a hostile input is accepted, or if an
/// accepted scene cannot be written and read again.
pub fn read(mutant: &Mutant) -> (Outcome, f64) {
    read_by(consume, mutant)
}

/// The same for a message.
pub fn read_message(mutant: &Mutant) -> (Outcome, f64) {
    read_by(consume_message, mutant)
}

fn read_by(consume: fn(&[u8]) -> Result<(), Error>, mutant: &Mutant) -> (Outcome, f64) {
    let start = Instant::now();
    let outcome = catch_unwind(AssertUnwindSafe(|| consume(&mutant.bytes)));
    let seconds = start.elapsed().as_secs_f64();
    let result = outcome.unwrap_or_else(|_| panic!("reading panics: {}", mutant.kind));
    if let Some(global) = mutant.hostile {
        let module = global.split(' ').next().unwrap_or_default();
        match result {
            Err(Error::Pickle { problem, .. }) => {
                let text = problem.to_string();
                assert!(text.contains("is not allowed") && text.contains(module), "{global}: {text}");
            }
            Err(other) => panic!("{global}: {other}"),
            Ok(()) => panic!("{global} was accepted"),
        }
        return (Outcome::Refused, seconds);
    }
    (if result.is_ok() { Outcome::Scene } else { Outcome::Refused }, seconds)
}

/// Reads, summarises and writes a scene, if it is one.
pub fn consume(bytes: &[u8]) -> Result<(), Error> {
    let path = Path::new("mutant.pkl");
    let recording = Recording::from_bytes(path, bytes.to_vec())?;
    let summary = Summary::of("mutant", &recording.scene);
    assert_eq!(summary.map_points, recording.scene.map.points.len());
    score(&recording.scene);
    let again = |bytes: Vec<u8>| Recording::from_bytes(path, bytes).map(|r| r.scene == recording.scene);
    // A damaged native file can disagree with its own source; then writing returns an error.
    match recording.source {
        Source::Pickle(_) => {
            assert!(again(recording.to_pickle()?)?, "the scene differs after writing and reading");
            assert!(again(recording.to_native()?)?, "the scene differs as a native file");
        }
        Source::GpuDrive(_) => {
            // Notes on the JSON are not written.
            let plain = |scene: Scene| Scene { notes: Vec::new(), ..scene };
            for bytes in [recording.to_pickle()?, recording.to_native()?] {
                let read = Recording::from_bytes(path, bytes)?.scene;
                assert!(
                    plain(read) == plain(recording.scene.clone()),
                    "the scene differs after writing and reading"
                );
            }
            Recording::from_bytes(path, recording.to_gpudrive()?.json).expect("what is written is read");
        }
        _ => {
            if let Ok(bytes) = recording.to_native() {
                assert!(again(bytes)?, "the scene differs after writing and reading");
                Recording::from_bytes(path, recording.to_pickle()?)?;
            }
        }
    }
    Ok(())
}

/// Scores the logged future, if there is one; rewards must be finite for any scene.
fn score(scene: &Scene) {
    let Ok(adversary) = scene.adversary() else { return };
    if scene.frames <= NOW + HORIZON {
        return;
    }
    let points = (NOW + 1..=NOW + HORIZON).map(|f| adversary.point(f)).collect();
    // Frames that are not valid may lie anywhere.
    let Ok(log) = Trajectory::new("log", points) else {
        let is_whole = adversary.count_valid(NOW + 1..NOW + HORIZON + 1) == HORIZON;
        assert!(!is_whole, "the reader bounds coordinates and steps");
        return;
    };
    let index = SceneIndex::new(scene.map.clone());
    for convention in [Convention::Paper, Convention::Release] {
        let options = ContextOptions { convention, ..ContextOptions::default() };
        let ctx = Context::new(&Arc::new(scene.clone()), &index, &options)
            .expect("it has an adversary and all frames");
        let s = Scorer::new(&ctx).scores(&ctx.candidate(log.clone()));
        for value in [s.adversarial_reward, s.kinematic_penalty, s.behavior_penalty] {
            assert!(value.is_finite(), "{convention:?}: {s:?}");
        }
    }
}

/// Replaces digits, quotes and ends of lines of protocol 0, which other mutations seldom meet.
fn replace_digits(bytes: &mut [u8], rng: &mut Rng) {
    let places: Vec<usize> = (0..bytes.len())
        .filter(|k| matches!(bytes[*k], b'0'..=b'9' | b'\n' | b'\'' | b'\\' | b'.'))
        .collect();
    for _ in 0..1 + rng.below(4) {
        if !places.is_empty() {
            bytes[places[rng.below(places.len())]] = b"0123456789\n-.eLnaix'\"\\"[rng.below(22)];
        }
    }
}

/// Overwrites a length after one of the opcodes that have one.
fn inflate(bytes: &mut [u8], rng: &mut Rng) {
    let counted: Vec<usize> = (0..bytes.len().saturating_sub(9))
        .filter(|&k| {
            matches!(
                bytes[k],
                b'X' | b'B' | b'T' | 0x8b | 0x8c | 0x8d | 0x8e | 0x95 | 0x96 | b'C' | b'U' | b'J' | b'M'
            )
        })
        .collect();
    if counted.is_empty() {
        return;
    }
    let at = counted[rng.below(counted.len())];
    let value = [u64::MAX, i64::MAX as u64, u64::from(u32::MAX), 1 << 31, 1 << 20, rng.bits()][rng.below(6)]
        .to_le_bytes();
    let n = if matches!(bytes[at], 0x8d | 0x8e | 0x95 | 0x96) {
        8
    } else if matches!(bytes[at], 0x8c | b'C' | b'U') {
        1
    } else {
        4
    };
    bytes[at + 1..=at + n].copy_from_slice(&value[..n]);
}

/// Inserts a call of a global before everything else, as GLOBAL or STACK_GLOBAL.
fn call(bytes: &mut Vec<u8>, global: &str, rng: &mut Rng) {
    let (module, name) = global.split_once(' ').unwrap_or((global, ""));
    let mut code = Vec::new();
    if rng.below(2) == 0 {
        code.extend(format!("c{module}\n{name}\n").bytes());
    } else {
        for word in [module, name] {
            code.extend([0x8c, word.len() as u8]);
            code.extend(word.bytes());
        }
        code.push(0x93);
    }
    code.extend(b"\x8c\x07echo hi\x85R0");
    // Just after PROTO, which protocols 0 and 1 lack.
    let start = if bytes[0] == 0x80 { 2 } else { 0 };
    if start == 0 {
        // STACK_GLOBAL needs a start that Python accepts, and so does our reader.
        code.splice(0..0, *b"N0");
    }
    bytes.splice(start..start, code);
}

/// Replaces floats in arrays by values that no scene has.
fn replace_values(bytes: &mut [u8], rng: &mut Rng) {
    for _ in 0..1 + rng.below(20) {
        let at = rng.below(bytes.len().saturating_sub(8).max(1));
        let value = [f32::NAN, f32::INFINITY, f32::MAX, -1e30, 0.0, 1e-40][rng.below(6)].to_le_bytes();
        let end = (at + 4).min(bytes.len());
        bytes[at..end].copy_from_slice(&value[..end - at]);
    }
}
