//! What is timed, and how.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use sage_core::{files, scene::Scene, statistics::quantile};
use sage_data::{MAX_FILE, Recording, folder};
use serde::Serialize;

/// Candidates scored together, as everywhere.
pub const CANDIDATES: usize = 32;
/// One measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Timing {
    /// What was done, the unit of work in the name.
    pub name: &'static str,
    /// Number of repetitions, or of scenes for a median over scenes.
    pub n: usize,
    /// Median, milliseconds.
    pub median_ms: f64,
    /// Least, milliseconds.
    pub min_ms: f64,
    /// 90 % quantile, milliseconds.
    pub p90_ms: f64,
    /// What is aimed at, milliseconds, if something is.
    pub target_ms: Option<f64>,
}

/// Scenes to measure on.
pub struct Data {
    files: Vec<PathBuf>,
    /// The bytes of a single file: a pipe can be read once.
    held: Option<Vec<u8>>,
}

impl Data {
    /// A file, a pipe, or the scenes of a folder.
    ///
    /// *Errors*: it cannot be read or listed.
    pub fn of(path: &Path) -> Result<Self> {
        if path.is_dir() {
            return Ok(Self { files: folder::scene_files(path)?, held: None });
        }
        let bytes = files::read_argument(path, MAX_FILE);
        Ok(Self::one(path.to_owned(), bytes.with_context(|| format!("cannot read `{}`", path.display()))?))
    }

    /// One scene by its bytes.
    pub fn one(path: PathBuf, bytes: Vec<u8>) -> Self {
        Self { files: vec![path], held: Some(bytes) }
    }

    /// Names of the files.
    pub(super) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    pub(super) fn bytes(&self, path: &Path) -> Result<Vec<u8>> {
        match &self.held {
            Some(bytes) => Ok(bytes.clone()),
            None => files::read(path, MAX_FILE).with_context(|| format!("cannot read `{}`", path.display())),
        }
    }

    /// One of the scenes.
    pub(super) fn scene(&self, path: &Path) -> Result<Scene> {
        Ok(Recording::from_bytes(path, self.bytes(path)?)?.scene)
    }
}

/// Times of repeated runs, milliseconds; what a run makes is dropped after its clock has stopped.
pub(super) fn measure<T>(repeat: usize, mut run: impl FnMut() -> (std::time::Duration, T)) -> Vec<f64> {
    // One run to warm up caches.
    run();
    (0..repeat.max(1)).map(|_| run().0.as_secs_f64() * 1e3).collect()
}

pub(super) fn timing(name: &'static str, times: Vec<f64>, target_ms: Option<f64>) -> Timing {
    let at = |share| quantile(&times, share).unwrap_or(f64::NAN);
    Timing { name, n: times.len(), median_ms: at(0.5), min_ms: at(0.0), p90_ms: at(0.9), target_ms }
}
