//! Python pickles as data.
//!
//! [`Document::parse`] interprets the opcodes of protocols 2 to 5 into a graph of plain values:
//! numbers, text, bytes, lists, tuples, sets, dicts and numpy arrays. The few globals that scene
//! files use are known by name ([`Global`]); any other is an error that names it, so nothing is
//! ever imported or called. Work and memory are bounded by the size of the file.

mod document;
mod global;
mod input;
mod keys;
mod machine;
mod nesting;
mod numpy;
mod objects;
mod opcode;
mod same;
mod writer;

pub use document::{Array, Document, Id, Node, Span};
pub use global::Global;
pub use numpy::{Dtype, ElementKind};
pub use same::same;

/// Containers nested deeper than this are refused; scenes nest nine deep.
pub const MAX_DEPTH: usize = 64;
/// Most values in one file; the largest scenes hold 60 000. Smaller files may hold fewer: half a
/// value a byte, though any may hold 16 384.
pub const MAX_NODES: usize = 2 << 20;
/// Values that even the smallest file may hold.
const LEAST_NODES: usize = 1 << 14;
/// Most marks open at once; picklers nest them as deep as containers.
const MAX_MARKS: usize = 1024;

/// Why a pickle is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at byte {offset}: {kind}")]
pub struct PickleError {
    /// Offset of the opcode at fault.
    pub offset: usize,
    /// What is wrong.
    pub kind: PickleProblem,
}

/// What can be wrong with a pickle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PickleProblem {
    /// There is nothing in the file.
    #[error("the file is empty")]
    EmptyFile,
    /// The file does not begin like a pickle.
    #[error("not a pickle: the first byte is {first:#04x}, expected 0x80 (PROTO)")]
    NotAPickle {
        /// First byte of the file.
        first: u8,
    },
    /// A protocol outside 2 to 5.
    #[error("pickle protocol {0}; expected 2 to 5")]
    Protocol(u8),
    /// An opcode that plain values do not need.
    #[error("opcode {name} ({code:#04x}) is not allowed in a scene file")]
    Opcode {
        /// Its byte.
        code: u8,
        /// Its name, if it is an opcode at all.
        name: &'static str,
    },
    /// A global outside the allow-list.
    #[error("global `{0}` is not allowed in a scene file; nothing was imported or run")]
    Global(String),
    /// The file ends inside a value.
    #[error("the file ends inside a value: {needed} more bytes needed, {left} left")]
    Truncated {
        /// Bytes that the value says it has.
        needed: u64,
        /// Bytes that are there.
        left: usize,
    },
    /// An opcode that goes on after the end of its frame, or a frame inside a frame.
    #[error("a value crosses the end of its frame, or a frame lies in another")]
    Frame,
    /// The stack does not hold what the opcode needs.
    #[error("opcode {0} finds nothing to work on")]
    Stack(&'static str),
    /// An opcode met a value of the wrong kind.
    #[error("{what} is {found}; expected {expected}")]
    Kind {
        /// What was looked at.
        what: &'static str,
        /// The kind found.
        found: &'static str,
        /// The kind needed.
        expected: &'static str,
    },
    /// A memo entry that was never stored, or one beyond the file's size.
    #[error("memo entry {0} does not exist")]
    Memo(u64),
    /// Text that is not UTF-8.
    #[error("text is not UTF-8")]
    Text,
    /// A string of Python 2 that Python 3 does not read.
    #[error("a string of Python 2 is not ASCII")]
    NotAscii,
    /// A dict or set with two equal keys, which no pickler writes.
    #[error("a dict or set holds the key {0} twice")]
    DuplicateKey(String),
    /// An array whose shape, type and bytes do not fit.
    #[error("array of shape {shape:?} and type {dtype} needs {needed} bytes; it has {found}")]
    ArraySize {
        /// Shape.
        shape: Vec<u64>,
        /// Type.
        dtype: String,
        /// Bytes that the shape needs.
        needed: u64,
        /// Bytes that are there.
        found: usize,
    },
    /// A numpy type that scenes do not use.
    #[error("numpy type `{0}` is not supported; expected b1, i1 to i8, u1 to u8, f2, f4 or f8")]
    Dtype(String),
    /// More values, or copies of values, than a file of its size has.
    #[error("more than {0} values, or bytes copied from values")]
    TooMuch(usize),
    /// A container that holds itself.
    #[error("a container holds itself")]
    Cycle,
    /// Containers nested deeper than [`MAX_DEPTH`].
    #[error("containers are nested deeper than {MAX_DEPTH}")]
    Depth,
    /// No value at the end.
    #[error("the file ends without a value")]
    Empty,
}
