//! Any bytes as a native scene file, behind a header that is one more often than chance.
#![no_main]

#[path = "../../sage-data/tests/mutation/mod.rs"]
#[allow(dead_code)]
mod mutation;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut file = (bytes.len().min(1 << 16) as u64 / 2).to_le_bytes().to_vec();
    file.extend(bytes);
    let _ = mutation::consume(if bytes.first() == Some(&b'{') { &file } else { bytes });
});
