//! Any bytes as a scene file: an error, or a scene that can be scored, written and read again.
#![no_main]

#[path = "../../sage-data/tests/mutation/mod.rs"]
#[allow(dead_code)]
mod mutation;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutation::consume(bytes);
});
