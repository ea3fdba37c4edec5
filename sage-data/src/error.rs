//! What can go wrong between a file and a scene.

use std::path::PathBuf;

use crate::pickle::PickleError;

/// An error of `sage-data`. Each names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system would not read it.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The operating system would not write it.
    #[error("cannot write `{}`", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// It is larger than any scene.
    #[error("`{}` holds more than {limit} bytes; no scene file does", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Largest size that is read.
        limit: u64,
    },
    /// It is not a pickle of plain values.
    #[error("`{}` at byte {}: {}", path.display(), problem.offset, problem.kind)]
    Pickle {
        /// The file.
        path: PathBuf,
        /// What the interpreter met.
        problem: PickleError,
    },
    /// A value is not what a scene holds there.
    #[error("`{}`: field `{field}` is {found}; expected {expected}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Keys from the root, separated by slashes.
        field: String,
        /// The value, or what kind of value it is.
        found: String,
        /// What belongs there.
        expected: String,
    },
    /// A folder without a scene.
    #[error("no scene in `{}`; expected files that end in .pkl or .safetensors", path.display())]
    NoScenes {
        /// The folder.
        path: PathBuf,
    },
}
