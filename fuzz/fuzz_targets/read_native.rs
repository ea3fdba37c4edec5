//! As `read_scene`, from a corpus of native files, which bytes alone would not find.
#![no_main]

#[path = "../../sage-data/tests/mutants/mod.rs"]
mod mutants;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutants::consume("some.safetensors".as_ref(), bytes);
});
