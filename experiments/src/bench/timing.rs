//! Data and results of time measurements.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use sage_core::{files, scene::Scene, statistics::quantile};
use sage_data::{MAX_SCENE_FILE, Recording, folder, womd};
use serde::Serialize;

/// Number of candidates that are scored together.
pub const CANDIDATES: usize = 32;

/// One measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Timing {
    /// Name of the measurement, with its unit of work.
    pub name: Cow<'static, str>,
    /// Number of repetitions, or of scenes for a median over scenes.
    pub n: usize,
    /// Median, milliseconds.
    pub median_ms: f64,
    /// Minimum, milliseconds.
    pub min_ms: f64,
    /// 90 % quantile, milliseconds.
    pub p90_ms: f64,
    /// Target, milliseconds, if there is one.
    pub target_ms: Option<f64>,
}

/// Scenes to measure on.
pub struct Data {
    files: Vec<PathBuf>,
    /// Content of a single file, because a pipe can be read only once.
    content: Option<Vec<u8>>,
}

impl Data {
    /// A file, a pipe, or the scenes of a folder.
    ///
    /// *Errors*: the path cannot be read or listed.
    pub fn of(path: &Path) -> Result<Self> {
        if path.is_dir() || womd::is_shard(path) {
            return Ok(Self { files: folder::scene_files(path)?, content: None });
        }
        let bytes = files::read_argument(path, MAX_SCENE_FILE);
        Ok(Self::one(path.to_owned(), bytes.with_context(|| format!("cannot read `{}`", path.display()))?))
    }

    /// One scene by its bytes.
    pub fn one(path: PathBuf, bytes: Vec<u8>) -> Self {
        Self { files: vec![path], content: Some(bytes) }
    }

    /// Names of the files.
    pub(super) fn files(&self) -> &[PathBuf] {
        &self.files
    }

    pub(super) fn bytes(&self, path: &Path) -> Result<Vec<u8>> {
        match &self.content {
            Some(bytes) => Ok(bytes.clone()),
            None => Ok(sage_data::read_bytes(path)?),
        }
    }

    /// One of the scenes.
    pub(super) fn scene(&self, path: &Path) -> Result<Scene> {
        Ok(Recording::from_bytes(path, self.bytes(path)?)?.scene)
    }
}

/// Times of repeated runs, milliseconds. The result of a run is dropped after the time is taken.
pub(super) fn measure<T>(repeat: usize, mut run: impl FnMut() -> (std::time::Duration, T)) -> Vec<f64> {
    // This run warms up caches.
    run();
    (0..repeat.max(1)).map(|_| run().0.as_secs_f64() * 1e3).collect()
}

pub(super) fn timing(name: impl Into<Cow<'static, str>>, times: Vec<f64>, target_ms: Option<f64>) -> Timing {
    let at = |share| quantile(&times, share).unwrap_or(f64::NAN);
    Timing {
        name: name.into(),
        n: times.len(),
        median_ms: at(0.5),
        min_ms: at(0.0),
        p90_ms: at(0.9),
        target_ms,
    }
}
