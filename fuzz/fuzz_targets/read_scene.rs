//! Any bytes as a scene file: an error, or a scene that can be scored, written and read again.
#![no_main]

#[path = "../../sage-data/tests/mutants/mod.rs"]
mod mutants;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutants::consume("some.pkl".as_ref(), bytes);
});
