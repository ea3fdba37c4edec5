//! Errors of reading and writing scenes.

use std::path::PathBuf;

use sage_core::defect::Defect;

use crate::{
    pickle::PickleError,
    womd::{FrameProblem, MessageError},
};

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
    /// A file of a format that is recognised but not read.
    #[error("`{}` is {found}; {remedy}", path.display())]
    OtherFormat {
        /// The file.
        path: PathBuf,
        /// What it is.
        found: &'static str,
        /// What to do.
        remedy: &'static str,
    },
    /// A file that is no JSON, or whose values are of other types.
    #[error("`{}`: {}{problem}", path.display(), if field.is_empty() { String::new() } else { format!("field `{field}`: ") })]
    Json {
        /// The file.
        path: PathBuf,
        /// Keys from the root, joined by slashes.
        field: String,
        /// What is wrong, and where.
        problem: String,
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
    /// A shard whose records cannot be read.
    #[error("`{}`, record {record} at byte {offset}: {problem}", path.display())]
    Shard {
        /// The shard.
        path: PathBuf,
        /// Number of the record, from 0.
        record: usize,
        /// Offset of the record in the file, after decompression, bytes.
        offset: u64,
        /// What is wrong.
        problem: FrameProblem,
    },
    /// A record of a shard that is no scene.
    #[error("`{}` {problem}", path.display())]
    Message {
        /// The shard and the number of the record, such as `SHARD#3`.
        path: PathBuf,
        /// What is wrong, and where.
        problem: MessageError,
    },
    /// A defect of this program that a scene brings about.
    #[error("`{}`", path.display())]
    Defect {
        /// The file.
        path: PathBuf,
        /// The defect.
        #[source]
        source: Defect,
    },
    /// A folder without a scene.
    #[error(
        "no scene in `{}`; expected files that end in .pkl or .safetensors, whose names hold `tfrecord`, JSON of GPUDrive, or scenarios of Argoverse 2",
        path.display()
    )]
    NoScenes {
        /// The folder.
        path: PathBuf,
    },
}
