//! As `read_scene`, from a corpus of native files, which bytes alone would not find.
#![no_main]

#[path = "../../sage-data/tests/mutation/mod.rs"]
#[allow(dead_code)]
mod mutation;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutation::consume(bytes);
});
