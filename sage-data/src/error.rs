//! Errors of reading and writing scenes.

use std::path::PathBuf;

use crate::pickle::PickleError;

/// An error of `sage-data`. Every variant names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system could not read it.
    #[error("cannot read `{}`", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// The operating system could not write it.
    #[error("cannot write `{}`", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// The file is larger than any scene.
    #[error("`{}` holds more than {limit} bytes; no scene file does", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Largest size that is read.
        limit: u64,
    },
    /// The file is not a pickle of plain values.
    #[error("`{}` at byte {}: {}", path.display(), problem.offset, problem.kind)]
    Pickle {
        /// The file.
        path: PathBuf,
        /// Problem found by the interpreter.
        problem: PickleError,
    },
    /// A value that a scene does not have at this field.
    #[error("`{}`: field `{field}` is {found}; expected {expected}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Keys from the root, joined by slashes.
        field: String,
        /// The value, or what kind of value it is.
        found: String,
        /// Expected value.
        expected: String,
    },
    /// A folder without a scene.
    #[error("no scene in `{}`; expected files that end in .pkl or .safetensors", path.display())]
    NoScenes {
        /// The folder.
        path: PathBuf,
    },
}
