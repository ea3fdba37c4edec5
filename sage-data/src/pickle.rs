//! Python pickles as data.
//!
//! [`Document::parse`] interprets the opcodes of protocols 2 to 5 into a graph of plain values:
//! numbers, text, bytes, lists, tuples, sets, dicts and numpy arrays. The few globals that scene
//! files use are listed by name ([`Global`]). Any other global is an error that names it, so nothing is
//! ever imported or called. The size of the file bounds work and memory.

mod additions;
mod build;
mod dict_writer;
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
mod text_arrays;
mod walk;
mod writer;

pub use document::{Array, Document, Id, Node, Span};
pub use global::Global;
pub use numpy::{Dtype, ElementKind};
pub use same::same;

pub(crate) use dict_writer::DictWriter;
pub(crate) use document::dtype_values;
pub(crate) use walk::{Walk, walk};

/// Largest nesting depth of containers; scenes have depth nine.
pub const MAX_DEPTH: usize = 64;
/// Largest number of values in one file; the largest scenes have 60 000. The limit of smaller files is half
/// a value per byte, but at least 16 384.
pub const MAX_NODES: usize = 2 << 20;
/// Limit of values for the smallest files.
const LEAST_NODES: usize = 1 << 14;
/// Largest number of open marks; picklers nest marks as deep as containers.
const MAX_MARKS: usize = 1024;

/// The error of a refused pickle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at byte {offset}: {kind}")]
pub struct PickleError {
    /// Offset of the invalid opcode.
    pub offset: usize,
    /// The problem.
    pub kind: PickleProblem,
}

/// Problems of a pickle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PickleProblem {
    /// An empty file.
    #[error("the file is empty")]
    EmptyFile,
    /// A file that does not start like a pickle.
    #[error("not a pickle: the first byte is {first:#04x}, expected 0x80 (PROTO)")]
    NotAPickle {
        /// First byte of the file.
        first: u8,
    },
    /// A pickle of protocol 0 or 1, or a file that begins like one.
    #[error(
        "a pickle of protocol 0 or 1, which is not read; nothing in it was run. Python runs what a pickle names, so only if you trust the file, save it again: python3 -c 'import pickle, sys; pickle.dump(pickle.load(open(sys.argv[1], \"rb\")), open(sys.argv[2], \"wb\"), protocol=4)' OLD.pkl NEW.pkl"
    )]
    OldProtocol,
    /// A protocol above 5.
    #[error("pickle protocol {0}; expected 2 to 5")]
    Protocol(u8),
    /// An opcode that plain values do not need.
    #[error("opcode {name} ({code:#04x}) is not allowed in a scene file")]
    Opcode {
        /// Its byte.
        code: u8,
        /// Its name, if it is a known opcode.
        name: &'static str,
    },
    /// A global outside the allow-list.
    #[error("global `{0}` is not allowed in a scene file; nothing was imported or run")]
    Global(String),
    /// The file ends inside a value.
    #[error("the file ends inside a value: {needed} more bytes needed, {left} left")]
    Truncated {
        /// Declared length of the value, bytes.
        needed: u64,
        /// Bytes available.
        left: usize,
    },
    /// An opcode that extends beyond the end of its frame, or a frame inside a frame.
    #[error("a value crosses the end of its frame, or a frame lies in another")]
    Frame,
    /// The stack does not contain the values that the opcode needs.
    #[error("opcode {0} finds nothing to work on")]
    Stack(&'static str),
    /// An opcode met a value of the wrong kind.
    #[error("{what} is {found}; expected {expected}")]
    Kind {
        /// The value that was tested.
        what: &'static str,
        /// The kind found.
        found: &'static str,
        /// The kind needed.
        expected: &'static str,
    },
    /// A memo entry that was never stored, or whose index exceeds the file's size.
    #[error("memo entry {0} does not exist")]
    Memo(u64),
    /// Text that is not UTF-8.
    #[error("text is not UTF-8")]
    Text,
    /// A string of Python 2 that Python 3 cannot read.
    #[error("a string of Python 2 is not ASCII")]
    NotAscii,
    /// A dict or set with two equal keys, which no pickler writes.
    #[error("a dict or set holds the key {0} twice")]
    DuplicateKey(String),
    /// An array whose shape, type and bytes do not match.
    #[error("array of shape {shape:?} and type {dtype} needs {needed} bytes; it has {found}")]
    ArraySize {
        /// Shape.
        shape: Vec<u64>,
        /// Type.
        dtype: String,
        /// Bytes that the shape needs.
        needed: u64,
        /// Bytes available.
        found: usize,
    },
    /// A numpy type that scenes do not use.
    #[error("numpy type `{0}` is not supported; expected b1, i1 to i8, u1 to u8, f2, f4 or f8")]
    Dtype(String),
    /// More values, or copies of values, than a file of its size may have.
    #[error("more than {0} values, or bytes copied from values")]
    TooMuch(usize),
    /// A container that contains itself.
    #[error("a container holds itself")]
    Cycle,
    /// Containers nested deeper than [`MAX_DEPTH`].
    #[error("containers are nested deeper than {MAX_DEPTH}")]
    Depth,
    /// No value at STOP.
    #[error("the file ends without a value")]
    Empty,
}
