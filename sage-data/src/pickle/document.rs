//! A parsed pickle: a graph of plain values over the bytes of the file.

use super::{Dtype, ElementKind, Global};

/// Index of a value in its document.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Id(pub(super) u32);

/// A range of the document's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    pub(super) start: u32,
    pub(super) len: u32,
}

impl Span {
    /// The empty span.
    pub(crate) const EMPTY: Self = Self { start: 0, len: 0 };
}

/// A numpy array; its elements remain bytes until they are read.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Element type.
    pub dtype: Dtype,
    /// Shape; no entry for a zero-dimensional array.
    pub shape: Vec<u32>,
    /// Whether the order of elements is Fortran order: the first index varies fastest.
    pub fortran: bool,
    /// Whether it was created by `_frombuffer`. numpy then preserves a foreign byte order; arrays loaded in
    /// the older form are converted to the native order.
    pub from_buffer: bool,
    /// Elements.
    pub data: Span,
}

/// A plain value.
#[derive(Clone, Debug)]
pub enum Node {
    /// None.
    None,
    /// True or False.
    Bool(bool),
    /// An int that fits 64 bits.
    Int(i64),
    /// A larger int: little-endian two's complement.
    BigInt(Span),
    /// A float.
    Float(f64),
    /// A str; the span is UTF-8.
    Str(Span),
    /// A bytes.
    Bytes(Span),
    /// A bytearray.
    ByteArray(Span),
    /// A list.
    List(Vec<Id>),
    /// A tuple.
    Tuple(Vec<Id>),
    /// A set.
    Set(Vec<Id>),
    /// A frozenset.
    FrozenSet(Vec<Id>),
    /// A dict, in the order of insertion; no two keys are equal.
    Dict(Vec<(Id, Id)>),
    /// A collections.defaultdict; its factory is `int` or none.
    DefaultDict {
        /// Whether the factory is `int`.
        int_factory: bool,
        /// Its entries.
        entries: Vec<(Id, Id)>,
    },
    /// A numpy array.
    Array(Box<Array>),
    /// A numpy scalar.
    Scalar(Dtype, Span),
    /// A numpy type.
    Dtype(Dtype),
    /// A known global as a value: the factory of a defaultdict or part of an unfinished object.
    Global(Global),
    /// An array before its state; never present in a finished document.
    Unbuilt,
    /// A numpy type before its state; never present in a finished document.
    UnbuiltDtype(Dtype),
}

impl Node {
    /// Name of its kind, for messages.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::None => "None",
            Self::Bool(_) => "a bool",
            Self::Int(_) | Self::BigInt(_) => "an int",
            Self::Float(_) => "a float",
            Self::Str(_) => "a str",
            Self::Bytes(_) => "bytes",
            Self::ByteArray(_) => "a bytearray",
            Self::List(_) => "a list",
            Self::Tuple(_) => "a tuple",
            Self::Set(_) | Self::FrozenSet(_) => "a set",
            Self::Dict(_) | Self::DefaultDict { .. } => "a dict",
            Self::Array(_) => "an array",
            Self::Scalar(..) => "a numpy scalar",
            Self::Dtype(_) => "a numpy type",
            Self::Global(_) => "a global",
            Self::Unbuilt => "an array without state",
            Self::UnbuiltDtype(_) => "a numpy type without state",
        }
    }

    /// Whether Python accepts it as a key, by its kind only: a tuple is hashable if its items are.
    pub(super) fn is_hashable(&self) -> bool {
        !matches!(
            self,
            Self::List(_)
                | Self::Set(_)
                | Self::Dict(_)
                | Self::DefaultDict { .. }
                | Self::ByteArray(_)
                | Self::Array(_)
                | Self::Unbuilt
                | Self::UnbuiltDtype(_)
        )
    }
}

/// A parsed pickle. Values may be shared but never contain themselves. They are nested at most
/// [`super::MAX_DEPTH`] deep.
///
/// ```
/// use sage_data::pickle::Document;
///
/// // The dict {"lanes": 2}.
/// let document = Document::parse(b"\x80\x02}X\x05\0\0\0lanesK\x02s.".to_vec())?;
/// let lanes = document.get(document.root(), "lanes").ok_or("no such key")?;
/// assert_eq!(document.describe(lanes), "2");
/// // A pickle that would run a command in Python is refused, and nothing is run.
/// let error = Document::parse(b"\x80\x02cos\nsystem\n.".to_vec()).err().map(|error| error.to_string());
/// assert!(error.is_some_and(|error| error.contains("os.system")));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Document {
    pub(super) bytes: Vec<u8>,
    pub(super) nodes: Vec<Node>,
    pub(super) root: Id,
    pub(super) file_size: usize,
}

impl Document {
    /// The outermost value.
    pub fn root(&self) -> Id {
        self.root
    }

    /// A value.
    pub fn node(&self, id: Id) -> &Node {
        &self.nodes[id.0 as usize]
    }

    /// All values, in the order of their creation.
    pub(crate) fn ids(&self) -> impl Iterator<Item = Id> + use<> {
        (0..self.nodes.len() as u32).map(Id)
    }

    /// Bytes of a span.
    pub fn bytes(&self, span: Span) -> &[u8] {
        &self.bytes[span.start as usize..(span.start + span.len) as usize]
    }

    /// Size of the file, bytes.
    pub fn file_size(&self) -> usize {
        self.file_size
    }

    /// Text of a str.
    pub fn text(&self, id: Id) -> Option<&str> {
        match self.node(id) {
            Node::Str(span) => std::str::from_utf8(self.bytes(*span)).ok(),
            _ => None,
        }
    }

    /// Bytes of the text of a str.
    pub(crate) fn text_length(&self, id: Id) -> Option<usize> {
        match self.node(id) {
            Node::Str(span) => Some(span.len as usize),
            _ => None,
        }
    }

    /// Entries of a dict or defaultdict.
    pub fn entries(&self, id: Id) -> Option<&[(Id, Id)]> {
        match self.node(id) {
            Node::Dict(entries) | Node::DefaultDict { entries, .. } => Some(entries),
            _ => None,
        }
    }

    /// Items of a list or tuple.
    pub fn items(&self, id: Id) -> Option<&[Id]> {
        match self.node(id) {
            Node::List(items) | Node::Tuple(items) => Some(items),
            _ => None,
        }
    }

    /// Value of a str key in a dict.
    pub fn get(&self, dict: Id, key: &str) -> Option<Id> {
        let is_key = |id: Id| match self.node(id) {
            Node::Str(span) => self.bytes(*span) == key.as_bytes(),
            _ => false,
        };
        self.entries(dict)?.iter().rev().find(|(k, _)| is_key(*k)).map(|(_, value)| *value)
    }

    /// A number of any type, as a float.
    pub fn number(&self, id: Id) -> Option<f64> {
        match self.node(id) {
            Node::Int(x) => Some(*x as f64),
            Node::Float(x) => Some(*x),
            Node::Bool(x) => Some(f64::from(u8::from(*x))),
            Node::Scalar(dtype, span) => dtype.read(self.bytes(*span)).next(),
            Node::Array(array) if array.shape.is_empty() => dtype_values(self, array).next(),
            _ => None,
        }
    }

    /// An integer. A str of digits counts, because ids and indices are written in both forms.
    pub fn integer(&self, id: Id) -> Option<i64> {
        match self.node(id) {
            Node::Int(x) => Some(*x),
            // No 64-bit integer has more digits.
            Node::Str(span) if span.len <= 20 => self.text(id)?.parse().ok(),
            Node::Scalar(dtype, span) if dtype.kind != ElementKind::Float => dtype.integer(self.bytes(*span)),
            _ => None,
        }
    }

    /// An id: a str as it is, an int in decimal.
    pub fn identifier(&self, id: Id) -> Option<String> {
        match self.node(id) {
            Node::Str(_) => self.text(id).map(str::to_owned),
            _ => self.integer(id).map(|x| x.to_string()),
        }
    }

    /// Description of a value for messages: its kind, and the value itself if it is short.
    pub fn describe(&self, id: Id) -> String {
        match self.node(id) {
            Node::Int(x) => x.to_string(),
            Node::Float(x) => format!("{x:?}"),
            Node::Bool(x) => format!("{x}"),
            Node::Str(_) => match self.text(id) {
                Some(text) if text.chars().nth(40).is_none() => format!("`{}`", text.escape_debug()),
                Some(text) => format!("`{}…`", text.chars().take(40).collect::<String>().escape_debug()),
                None => "text that is not UTF-8".to_owned(),
            },
            Node::Array(array) => format!("an array of shape {:?} and type {}", array.shape, array.dtype),
            Node::List(items) | Node::Tuple(items) => {
                format!("{} of {} items", self.node(id).kind(), items.len())
            }
            node => node.kind().to_owned(),
        }
    }
}

/// Elements of an array as floats, in the order of its bytes.
pub(crate) fn dtype_values<'d>(document: &'d Document, array: &Array) -> impl Iterator<Item = f64> + 'd {
    array.dtype.read(document.bytes(array.data))
}
