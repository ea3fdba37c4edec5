//! Random damage to files of any format, and files that are made to be slow or large, in any number from a seed.
//!
//! Used by the tests of hostile files, by `cargo run --release -p sage-data --example mutate_files` and `cargo run --release
//! -p experiments --example hostile_limits` (any number) and, one input at a time, by the fuzz targets.

#![allow(dead_code)] // Each program uses a part of it.

pub mod damage;
pub mod formats;
pub mod programs;
pub mod tables;
pub mod use_of_scenes;

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    time::Instant,
};

use sage_core::seed::Rng;
use sage_data::Error;

pub use formats::Format;
pub use use_of_scenes::consume;

/// A file, and how it came to be.
pub struct Mutant {
    pub bytes: Vec<u8>,
    pub kind: &'static str,
    /// Words that its error must hold.
    pub refused_with: Option<String>,
}

impl Format {
    /// The file of a number: damaged as a whole, damaged behind its checksums and lengths, or made.
    pub fn mutant(&self, number: u64) -> Mutant {
        let mut rng = Rng::new(number, self.name, "mutation");
        if let Some(made) = self.made.filter(|_| rng.below(4) == 0) {
            return made(self, &mut rng);
        }
        let mut bytes = self.bases[rng.below(self.bases.len())].clone();
        let kind = match (self.inside)(&bytes).filter(|_| rng.below(2) == 0) {
            Some(inside) => {
                let mut part = bytes[inside.clone()].to_vec();
                let kind = damage::any(&mut part, &mut rng);
                bytes = (self.around)(&bytes, inside, part);
                kind
            }
            None => damage::any(&mut bytes, &mut rng),
        };
        Mutant { bytes, kind, refused_with: None }
    }

    /// Reads a mutant and uses the scene. Returns whether it is one, and the time that it took in seconds.
    ///
    /// Panics if reading does, or if a file is read that must be refused.
    pub fn read(&self, mutant: &Mutant) -> (bool, f64) {
        let start = Instant::now();
        let consumed = catch_unwind(AssertUnwindSafe(|| self.consume(&mutant.bytes)));
        let seconds = start.elapsed().as_secs_f64();
        let result = consumed.unwrap_or_else(|_| panic!("{}: reading panics: {}", self.name, mutant.kind));
        if let Some(words) = &mutant.refused_with {
            let error = result.as_ref().expect_err(words).to_string();
            assert!(words.split(';').all(|word| error.contains(word)), "{words}: {error}");
        }
        (result.is_ok(), seconds)
    }

    /// Reads bytes as a file of the format, and uses the scene.
    ///
    /// *Errors*: they are no scene.
    pub fn consume(&self, bytes: &[u8]) -> Result<(), Error> {
        consume(Path::new(self.path), bytes)
    }
}
