//! Broken and hostile shards: every error names record and offset, and no shard takes much memory.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod real;

use std::{
    alloc::System,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    time::{Duration, Instant},
};

use sage_data::{
    Error, ReadOptions, Recording,
    stream::{Inputs, Item, map_in_order},
    womd::ShardReader,
};
use serde_json::Value;

/// An allocation beyond the limit fails, which ends the test.
#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, 256 << 20);

/// Limit of the memory that one shard takes, bytes.
const MEMORY: usize = 64 << 20;

fn synthetic() -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/womd_synthetic.tfrecord")).unwrap()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// The scenes before the first error, and the error.
fn read(bytes: &[u8]) -> (Vec<Recording>, Option<String>) {
    let mut scenes = Vec::new();
    let read = || -> Result<(), Error> {
        let mut shard = ShardReader::from_bytes(Path::new("some.tfrecord"), bytes.to_vec())?;
        while let Some(record) = shard.next_record() {
            let record = record?;
            scenes.push(record.read(&ReadOptions::default())?);
        }
        Ok(())
    };
    let mut read = read;
    let error = read().err().map(|error| error.to_string());
    (scenes, error)
}

/// Ends of the records of a file.
fn ends(bytes: &[u8]) -> Vec<usize> {
    let (mut ends, mut at) = (Vec::new(), 0);
    while at < bytes.len() {
        at += 16 + u64::from_le_bytes(*bytes[at..].first_chunk().unwrap()) as usize;
        ends.push(at);
    }
    ends
}

#[test]
fn a_cut_shard_gives_its_whole_records_and_an_error() {
    let shard = synthetic();
    let ends = ends(&shard);
    for cut in 0..shard.len() {
        // Near the ends of records every cut, elsewhere some.
        if cut % 97 != 0 && !ends.iter().any(|end| end.abs_diff(cut) < 20) {
            continue;
        }
        let (scenes, error) = read(&shard[..cut]);
        assert_eq!(scenes.len(), ends.iter().filter(|end| **end <= cut).count(), "cut at {cut}");
        match error {
            None => assert!(ends.contains(&cut), "cut at {cut}"),
            Some(error) if cut == 0 => assert!(error.contains("empty"), "{error}"),
            Some(error) => assert!(error.contains("truncated"), "cut at {cut}: {error}"),
        }
    }
}

#[test]
fn a_cut_gzip_file_is_an_error() {
    let whole = gzip(&synthetic());
    assert_eq!(read(&whole).0.len(), 2);
    for cut in 2..whole.len() {
        let (scenes, error) = read(&whole[..cut]);
        let error = error.unwrap_or_else(|| panic!("cut at {cut}: {} scenes and no error", scenes.len()));
        assert!(error.contains("truncated"), "cut at {cut}: {error}");
    }
    // Two members one after another are one file.
    let [first, second] =
        [&synthetic()[..ends(&synthetic())[0]], &synthetic()[ends(&synthetic())[0]..]].map(gzip);
    assert_eq!(read(&[&first[..], &second].concat()).0.len(), 2);
    let (scenes, error) = read(&[&first[..], b"no member"].concat());
    assert!(scenes.len() == 1 && error.is_some_and(|error| error.contains("gzip")));
}

#[test]
fn every_flipped_bit_is_an_error() {
    let shard = synthetic();
    let first = ends(&shard)[0];
    for bit in 0..8 * first {
        let mut bad = shard[..first].to_vec();
        bad[bit / 8] ^= 1 << (bit % 8);
        let (scenes, error) = read(&bad);
        assert!(scenes.is_empty() && error.is_some(), "bit {bit}");
    }
}

/// What a hostile file must do, by its name in `expected.json`.
fn assert_expected(name: &str, file: &Path, expected: &Value) -> (Duration, usize) {
    let before = ALLOCATOR.allocated();
    let clock = Instant::now();
    let mut scenes = 0;
    let outcome = map_in_order(
        Inputs::under(&[file.to_owned()]).unwrap().items(),
        Item::size,
        |item| item.read(&ReadOptions::default()).map(|_| ()),
        |scene| {
            scene?;
            scenes += 1;
            Ok::<(), Error>(())
        },
    );
    let (seconds, memory) = (clock.elapsed(), ALLOCATOR.max_allocated().saturating_sub(before));
    match (&outcome, expected["error"].as_str()) {
        (Ok(()), None) => assert_eq!(scenes, expected["scenes"], "{name}"),
        (Err(error), Some(word)) => {
            let error = error.to_string();
            assert!(error.contains(word), "{name}: `{word}` is not in: {error}");
            let place = error.contains("record 0 at byte")
                || error.contains("record 1 at byte")
                || error.contains("#0` at byte");
            assert!(place && error.contains(&format!("{name}.tfrecord")), "{name}: {error}");
            if let Some(before) = expected["before"].as_u64() {
                assert_eq!(scenes, before, "{name}: scenes before the error");
            }
        }
        (outcome, word) => panic!("{name}: {outcome:?}, expected {word:?}"),
    }
    (seconds, memory)
}

/// The variants of the reference's script, which needs Python.
#[test]
fn hostile_shards_are_refused_or_scenes() {
    let Some(script) = real::reference("formats/make_hostile.py") else { return };
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/womd_synthetic.tfrecord");
    let made = Command::new("python3").args([&script, &source]).arg(folder.path()).status();
    if !made.is_ok_and(|status| status.success()) {
        eprintln!("left out: python3 cannot run {}", script.display());
        return;
    }
    let expected = std::fs::read_to_string(folder.path().join("expected.json")).unwrap();
    let expected: Value = serde_json::from_str(&expected).unwrap();
    let (mut slowest, mut largest) = (Duration::ZERO, 0);
    for (name, expected) in expected.as_object().unwrap() {
        let file: PathBuf = folder.path().join(format!("{name}.tfrecord"));
        if name == "gz_cut"
            && std::fs::read(&file).unwrap() == std::fs::read(folder.path().join("gz.tfrecord")).unwrap()
        {
            // The script cuts beyond the end; `a_cut_gzip_file_is_an_error` cuts before it.
            continue;
        }
        let (seconds, memory) = assert_expected(name, &file, expected);
        if std::env::var_os("SAGE_VERBOSE").is_some() {
            println!("{name}: {:.1} ms, {} kB at most so far", 1e3 * seconds.as_secs_f64(), memory >> 10);
        }
        (slowest, largest) = (slowest.max(seconds), largest.max(memory));
    }
    assert!(largest < MEMORY, "{} MB", largest >> 20);
    println!("slowest {slowest:?}, at most {} MB", largest >> 20);
}
