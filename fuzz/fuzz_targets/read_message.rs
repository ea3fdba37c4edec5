//! Any bytes as a `Scenario` message, without checksums: an error, or a scene that every format keeps.
#![no_main]

#[path = "../../sage-data/tests/mutants/mod.rs"]
mod mutants;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mutants::consume("some.tfrecord#0".as_ref(), &sage_data::womd::frame(bytes));
});
