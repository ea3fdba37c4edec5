//! Shards of many records: memory does not grow with their number.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test; notes go to stderr.

mod real;

use std::{
    alloc::System,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
};

use sage_data::{
    Error, ReadOptions,
    stream::{Inputs, Item, map_in_order},
};

#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, 150 << 20);

/// Records of the short shard; the long one has ten times as many.
const RECORDS: usize = 200;

/// Reads a pipe with this many scenes, repeated from a shard. Returns the largest memory of the program so far.
fn read(pipe: &Path, shard: &[u8], records: usize) -> usize {
    let (to, shard) = (pipe.to_owned(), shard.to_vec());
    let ends: Vec<usize> = ends(&shard);
    let writer = std::thread::spawn(move || {
        let mut pipe = std::fs::OpenOptions::new().write(true).open(to).unwrap();
        for _ in 0..records / ends.len() {
            pipe.write_all(&shard).unwrap();
        }
    });
    let mut scenes = 0;
    map_in_order(
        Inputs::under(&[PathBuf::from(pipe)]).unwrap().items(),
        Item::size,
        |item| item.read(&ReadOptions::default()).map(|recording| recording.scene.frames),
        |frames| {
            assert!(frames? > 0);
            scenes += 1;
            Ok::<(), Error>(())
        },
    )
    .unwrap();
    writer.join().unwrap();
    assert_eq!(scenes, records);
    ALLOCATOR.max_allocated()
}

/// Ends of the records of a shard.
fn ends(shard: &[u8]) -> Vec<usize> {
    let (mut ends, mut at) = (Vec::new(), 0);
    while let Some(length) = shard[at..].first_chunk() {
        at += 16 + u64::from_le_bytes(*length) as usize;
        ends.push(at);
    }
    ends
}

#[test]
fn memory_does_not_grow_with_the_number_of_records() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("shard");
    if !Command::new("mkfifo").arg(&pipe).status().is_ok_and(|status| status.success()) {
        eprintln!("left out: no mkfifo");
        return;
    }
    // Recorded scenes of 1 MB each, or the invented ones.
    let invented = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/womd_synthetic.tfrecord");
    let shard = real::reference("formats/womd_real.tfrecord").unwrap_or(invented);
    let shard = std::fs::read(shard).unwrap();
    // The pool of threads comes first.
    read(&pipe, &shard, 4);
    let few = read(&pipe, &shard, RECORDS);
    let many = read(&pipe, &shard, 10 * RECORDS);
    println!("{} MB for {RECORDS} records, {} MB for ten times as many", few >> 20, many >> 20);
    assert!(many as f64 <= 1.1 * few as f64, "{few} bytes, then {many}");
}
