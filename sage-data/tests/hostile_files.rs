//! 2 000 broken and hostile pickles: the result is an error or a scene, never a panic, a hang or high
//! memory use.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod mutation;

use std::{alloc::System, path::Path};

use mutation::{HOSTILE, Mutator, Outcome};
use sage_data::Recording;

/// An allocation beyond the limit fails, which ends the test.
#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, 256 << 20);

#[test]
fn mutants_are_refused_or_scenes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let files = [
        "tests/data/small_p2_core.pkl",
        "tests/data/small_p4_core.pkl",
        "tests/data/newest_p5.pkl",
        "../examples/crossing.pkl",
    ];
    let mutator = Mutator::new(files.map(|file| std::fs::read(folder.join(file)).unwrap()).into());
    let (mut scenes, mut refused) = (0, 0);
    for number in 0..2_000 {
        match mutation::read(&mutator.make(number)).0 {
            Outcome::Scene => scenes += 1,
            Outcome::Refused => refused += 1,
        }
    }
    // Both results must occur, or the mutations are too one-sided.
    assert!(scenes > 100 && refused > 800, "{scenes} scenes, {refused} refused");
}

#[test]
fn every_hostile_global_is_refused() {
    for global in HOSTILE {
        let (module, name) = global.split_once(' ').unwrap();
        for code in [format!("c{module}\n{name}\n."), format!("c{module}\n{name}\n)R.")] {
            let bytes = [b"\x80\x04", code.as_bytes()].concat();
            let error = mutation::consume(&bytes).expect_err(global).to_string();
            assert!(error.contains("is not allowed"), "{global}: {error}");
        }
    }
}

#[test]
fn native_mutants_are_refused_or_scenes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let native = |file: &str| Recording::read(&folder.join(file)).unwrap().to_native().unwrap();
    let mutator =
        Mutator::new(["tests/data/small_p4_core.pkl", "../examples/crossing.pkl"].map(native).into());
    let (mut scenes, mut refused) = (0, 0);
    for number in 0..2_000 {
        match mutation::read(&mutator.make_native(number)).0 {
            Outcome::Scene => scenes += 1,
            Outcome::Refused => refused += 1,
        }
    }
    assert!(scenes > 100 && refused > 800, "{scenes} scenes, {refused} refused");
}

#[test]
fn message_mutants_are_refused_or_scenes() {
    let shard = include_bytes!("data/womd_synthetic.tfrecord");
    let mutator = Mutator::new(mutation::messages(shard));
    let (mut scenes, mut refused) = (0, 0);
    for number in 0..2_000 {
        match mutation::read_message(&mutator.make_message(number)).0 {
            Outcome::Scene => scenes += 1,
            Outcome::Refused => refused += 1,
        }
    }
    assert!(scenes > 100 && refused > 800, "{scenes} scenes, {refused} refused");
}

#[test]
fn searches_and_copies_of_shared_values_are_limited() {
    for number in 0.. {
        let mutant = mutation::repeated(number);
        let Some((bytes, is_scene)) = mutant else { break };
        let outcome = mutation::consume(&bytes).map_err(|error| error.to_string());
        match outcome {
            Ok(()) => assert!(is_scene, "case {number} was accepted"),
            Err(error) => assert!(!is_scene && error.contains("repeats too often"), "case {number}: {error}"),
        }
    }
}
