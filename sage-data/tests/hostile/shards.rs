//! Shards of records: every error names record and offset, and the records before it are whole.

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::Command,
};

use sage_data::{
    Error, ReadOptions, Recording,
    stream::{Inputs, Item, map_in_order},
    womd::{Record, ShardReader, frame},
};
use serde_json::Value;

use super::{limited, mutants::formats::records, real, turn};

const SHARD: &[u8] = include_bytes!("../data/womd_synthetic.tfrecord");

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// The number of scenes before the first error, and the error.
fn read(bytes: &[u8]) -> (usize, String) {
    read_by(bytes, |record| record.read(&ReadOptions::default()).map(drop))
}

/// The same, with what is done with a record.
fn read_by(bytes: &[u8], work: fn(Record) -> Result<(), Error>) -> (usize, String) {
    let mut scenes = 0;
    let mut read = || -> Result<(), Error> {
        let mut shard = ShardReader::from_bytes(Path::new("some.tfrecord"), bytes.to_vec())?;
        while let Some(record) = shard.next_record() {
            work(record?)?;
            scenes += 1;
        }
        Ok(())
    };
    let error = limited(bytes.len() + (96 << 20), &mut read).err().map(|error| error.to_string());
    (scenes, error.unwrap_or_default())
}

#[test]
fn crafted_shards_are_refused_or_read() {
    let _turn = turn();
    let records = records(SHARD);
    let (first, second) = (&records[0][..], &records[1][..]);
    let message = &first[12..first.len() - 4];
    let wrong = |at: usize| {
        let mut bytes = first.to_vec();
        bytes[at] ^= 1;
        [&bytes[..], second].concat()
    };
    let mut long = frame(b"");
    long.splice(..12, frame_header(65 << 20));
    let group =
        |open: usize| frame(&[&[0x7b; 1].repeat(open)[..], &[0x7c; 1].repeat(open)[..], message].concat());
    // Tracks and features of two bytes each.
    let many = |part: &[u8]| frame(&[&part.repeat(1 << 20)[..], message].concat());
    let table: Vec<(&str, Vec<u8>, usize, &str)> = vec![
        ("whole", SHARD.to_vec(), 2, ""),
        ("compressed", gzip(SHARD), 2, ""),
        ("in two members", [gzip(first), gzip(second)].concat(), 2, ""),
        ("no second member", [&gzip(first), &b"no member"[..]].concat(), 1, "gzip"),
        ("empty", Vec::new(), 0, "empty"),
        ("a wrong length", wrong(0), 0, "checksum of the record's length"),
        ("wrong data", wrong(40), 0, "checksum of the record's data"),
        ("an empty record", [first, &frame(b"")].concat(), 1, "the record is empty"),
        ("a record of 65 MiB", [first, &long].concat(), 1, "no scene has more than"),
        ("groups 30 deep", group(30), 1, ""),
        ("groups 200 deep", group(200), 0, "more than"),
        ("a million tracks", many(&[0x12, 0]), 0, "than a record of its size describes"),
        ("a million features", many(&[0x42, 0]), 0, "than a record of its size describes"),
    ];
    for (name, bytes, scenes, words) in table {
        let (found, error) = read(&bytes);
        assert!(
            found == scenes && error.contains(words) && error.is_empty() == words.is_empty(),
            "{name}: {found} {error}"
        );
    }
    // Records that are skipped.
    let bomb = || gzip(&frame(&vec![0; 8 << 20]).repeat(20));
    for (bytes, words) in [
        (frame(b"").repeat(1000), "100 records one after another are empty"),
        (bomb(), "expands more than 100 times"),
    ] {
        let (_, error) = read_by(&bytes, |_| Ok(()));
        assert!(error.contains(words), "{error}");
    }
}

/// The length of a record and its checksum.
fn frame_header(length: u64) -> Vec<u8> {
    let length = length.to_le_bytes();
    let checksum = frame(&length);
    // The checksum of these eight bytes as data is that of them as a length.
    [&length[..], &checksum[checksum.len() - 4..]].concat()
}

#[test]
fn cut_shards_and_flipped_bits_are_errors() {
    let _turn = turn();
    let first = records(SHARD)[0].len();
    let ends = [first, SHARD.len()];
    for cut in 1..SHARD.len() {
        // Near the ends of records every cut, elsewhere some.
        if cut % 97 != 0 && !ends.iter().any(|end| end.abs_diff(cut) < 20) {
            continue;
        }
        let whole = ends.iter().filter(|end| **end <= cut).count();
        let (scenes, error) = read(&SHARD[..cut]);
        assert!(
            scenes == whole && (ends.contains(&cut) || error.contains("truncated")),
            "cut at {cut}: {error}"
        );
    }
    let compressed = gzip(SHARD);
    for cut in (2..compressed.len()).step_by(3) {
        let (scenes, error) = read(&compressed[..cut]);
        assert!(error.contains("truncated"), "cut at {cut}: {scenes} scenes, {error}");
    }
    for bit in 0..8 * first {
        let mut bad = SHARD[..first].to_vec();
        bad[bit / 8] ^= 1 << (bit % 8);
        let read = Recording::from_bytes(Path::new("some.tfrecord#0"), bad);
        assert!(read.is_err(), "bit {bit}");
    }
}

/// The variants of the reference's script, which needs Python.
#[test]
fn hostile_shards_are_refused_or_scenes() {
    let _turn = turn();
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
    for (name, expected) in expected.as_object().unwrap() {
        let file: PathBuf = folder.path().join(format!("{name}.tfrecord"));
        // The script cuts this one beyond the end.
        if name != "gz_cut" {
            assert_expected(name, &file, expected);
        }
    }
}

/// What a hostile file must do, by its name in `expected.json`.
fn assert_expected(name: &str, file: &Path, expected: &Value) {
    let mut scenes = 0;
    let outcome = limited(64 << 20, || {
        map_in_order(
            Inputs::under(&[file.to_owned()]).unwrap().items(),
            Item::size,
            |item| item.read(&ReadOptions::default()).map(|_| ()),
            |scene| {
                scene?;
                scenes += 1;
                Ok::<(), Error>(())
            },
        )
    });
    match (outcome.map_err(|error| error.to_string()), expected["error"].as_str()) {
        (Ok(()), None) => assert_eq!(scenes, expected["scenes"], "{name}"),
        (Err(error), Some(word)) => {
            let places = ["record 0 at byte", "record 1 at byte", "#0` at byte"];
            let is_placed = places.iter().any(|place| error.contains(place));
            assert!(is_placed && error.contains(word) && error.contains(name), "{name}: `{word}`, {error}");
            let before = expected["before"].as_u64().unwrap_or(scenes);
            assert_eq!(scenes, before, "{name}: scenes before the error");
        }
        (outcome, word) => panic!("{name}: {outcome:?}, expected {word:?}"),
    }
}
