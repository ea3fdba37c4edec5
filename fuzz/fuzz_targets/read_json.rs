//! Any bytes as JSON of GPUDrive: an error, or a scene that every format keeps.
#![no_main]

#[path = "../../sage-data/tests/mutation/mod.rs"]
#[allow(dead_code)]
mod mutation;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutation::consume(bytes);
});
