//! Any bytes as JSON of GPUDrive: an error, or a scene that every format keeps.
#![no_main]

#[path = "../../sage-data/tests/mutants/mod.rs"]
mod mutants;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutants::consume("some.json".as_ref(), bytes);
});
