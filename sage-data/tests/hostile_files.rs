//! 2 000 broken and hostile pickles: the result is an error or a scene, never a panic, a hang or high
//! memory use.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod mutation;

use std::{alloc::System, path::Path};

use insta::assert_snapshot;
use mutation::{HOSTILE, Mutator, Outcome};
use sage_data::{Recording, pickle::Document};

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
            // Protocols 0 and 1 begin without PROTO.
            for start in [&b"\x80\x04"[..], b"", b"(dp0\n"] {
                let bytes = [start, code.as_bytes()].concat();
                let error = mutation::consume(&bytes).expect_err(global).to_string();
                assert!(start.len() != 2 || error.contains("is not allowed"), "{global}: {error}");
            }
        }
    }
}

#[test]
fn every_hostile_opcode_is_refused() {
    // INST and OBJ make objects, PERSID and BINPERSID ask the caller for one, EXT1 to EXT4 name a registered global.
    for code in [
        &b"(ios\nsystem\n."[..],
        b"(S'echo'\nios\nsystem\n.",
        b"(cos\nsystem\nS'echo'\no.",
        b"(c__builtin__\ntuple\no.",
        b"Pid\n.",
        b"NQ.",
        b"\x82\x01.",
        b"\x83\x01\x00.",
        b"\x84\x01\x00\x00\x00.",
        b"c__builtin__\ntuple\n(tR.",
        b"c__builtin__\ntuple\n(t\x81.",
        b"cnumpy\nndarray\n(t\x81.",
        b"ccopy_reg\n_reconstructor\n(cnumpy\nndarray\nc__builtin__\ntuple\n(ttR.",
        b"ccopy_reg\n_reconstructor\n(cmetadrive.utils.math\nVector\nc__builtin__\nint\n(ttR.",
        b"cmetadrive.utils.math\nVector\n((lt\x81.",
        b"cmetadrive.utils.math\nVector\n((t(tt\x81.",
        b"cmetadrive.utils.math\nVector\n((ttR(db.",
        b"cmetadrive.utils.math\nVector\n.",
    ] {
        for start in [&b""[..], b"\x80\x02", b"N0"] {
            let bytes = [start, code].concat();
            mutation::consume(&bytes).expect_err(&code.escape_ascii().to_string());
        }
    }
}

#[test]
fn long_lines_and_deep_pickles_cost_little() {
    let repeated =
        |head: &[u8], part: &[u8], n: usize, tail: &[u8]| [b"\x80\x02", head, &part.repeat(n), tail].concat();
    let million = 1_000_000;
    let mut said = Vec::new();
    for bytes in [
        repeated(b"c", b"a", million, b"\nb\n."),
        repeated(b"", b"(", million, b"."),
        repeated(b"", b"]", 200, &[&b"a".repeat(199)[..], b"."].concat()),
        repeated(b"N", b"\x85", 200, b"."),
    ] {
        let start = std::time::Instant::now();
        let refused = mutation::consume(&bytes).unwrap_err().to_string();
        // A file that is only text is refused as such.
        let error = Document::parse(bytes.clone()).map_or_else(|error| error.to_string(), |_| refused);
        let shown = bytes[..bytes.len().min(20)].escape_ascii();
        assert!(start.elapsed().as_secs_f64() < 2.0, "{shown} takes {:?}", start.elapsed());
        said.push(format!("\"{shown}\", {} bytes -> {error}", bytes.len()));
    }
    assert_snapshot!("long_lines_and_deep_pickles", said.join("\n"));
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
fn json_mutants_are_refused_or_scenes() {
    let mutator = Mutator::new(mutation::scenes());
    let (mut scenes, mut refused) = (0, 0);
    for number in 0..1_000 {
        match mutation::read(&mutator.make_json(number)).0 {
            Outcome::Scene => scenes += 1,
            Outcome::Refused => refused += 1,
        }
    }
    assert!(scenes > 100 && refused > 400, "{scenes} scenes, {refused} refused");
}

#[test]
fn searches_and_copies_of_shared_values_are_limited() {
    for number in 0.. {
        let mutant = mutation::crafted::repeated(number);
        let Some((bytes, is_scene)) = mutant else { break };
        let outcome = mutation::consume(&bytes).map_err(|error| error.to_string());
        match outcome {
            Ok(()) => assert!(is_scene, "case {number} was accepted"),
            Err(error) => assert!(!is_scene && error.contains("repeats too often"), "case {number}: {error}"),
        }
    }
}
