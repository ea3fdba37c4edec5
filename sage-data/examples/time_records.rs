//! Times the reading of scenes from records and from pickles, in memory and on one thread.
//!
//! ```sh
//! sage convert scenes/ --to womd --out shards/
//! cargo run --release -p sage-data --example time_records -- shards/scenes.tfrecord-00000-of-00001 scenes/
//! ```
//! Prints the milliseconds per scene of the fastest of ten rounds, and their ratio.

#![allow(clippy::print_stdout)] // A command-line program.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use sage_data::{Error, Recording, folder, read_bytes};

const ROUNDS: usize = 10;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [shard, pickles] = &arguments[..] else { return Err("usage: time_records SHARD FOLDER".into()) };
    let (records, pickles) = (read(shard.as_ref())?, read(pickles.as_ref())?);
    let [mut record, mut pickle] = [f64::INFINITY; 2];
    for _ in 0..ROUNDS {
        record = record.min(milliseconds(&records)?);
        pickle = pickle.min(milliseconds(&pickles)?);
    }
    println!("{} records: {record:.3} ms a scene", records.len());
    println!("{} pickles: {pickle:.3} ms a scene", pickles.len());
    println!("ratio {:.2}", record / pickle);
    Ok(())
}

/// Names and bytes of all scenes under a path.
fn read(path: &Path) -> Result<Vec<(PathBuf, Vec<u8>)>, Error> {
    folder::scene_files(path)?.into_iter().map(|file| Ok((file.clone(), read_bytes(&file)?))).collect()
}

/// Mean time to a checked scene, without that of copying the bytes.
fn milliseconds(scenes: &[(PathBuf, Vec<u8>)]) -> Result<f64, Error> {
    let mut seconds = 0.0;
    for (path, bytes) in scenes {
        let bytes = bytes.clone();
        let clock = Instant::now();
        let recording = Recording::from_bytes(path, bytes)?;
        seconds += clock.elapsed().as_secs_f64();
        drop(recording);
    }
    Ok(1e3 * seconds / scenes.len() as f64)
}
