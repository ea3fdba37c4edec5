//! Adds new values to a document.

use super::{Document, Id, Node, Span};

impl Document {
    /// A new str.
    pub(crate) fn new_text(&mut self, text: &str) -> Id {
        let span = self.push_bytes(text.as_bytes());
        self.push(Node::Str(span))
    }

    /// Adds 64-bit floats, little-endian.
    pub(crate) fn push_doubles(&mut self, numbers: &[f64]) -> Span {
        let start = self.bytes.len() as u32;
        self.bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        Span { start, len: 8 * numbers.len() as u32 }
    }

    /// Bytes that the values take, about: as a file of them would.
    #[cfg(feature = "argoverse2")]
    pub(crate) fn values_size(&self) -> usize {
        self.bytes.len()
    }

    /// A new int.
    pub(crate) fn new_int(&mut self, value: usize) -> Id {
        self.push(Node::Int(value as i64))
    }

    /// A new dict with the given keys.
    pub(crate) fn new_dict<K: AsRef<str>>(&mut self, entries: impl IntoIterator<Item = (K, Id)>) -> Id {
        let entries = entries.into_iter().map(|(key, value)| (self.new_text(key.as_ref()), value)).collect();
        self.push(Node::Dict(entries))
    }

    /// A shallow copy of a value, so that a change does not affect other references. Its items stay shared.
    pub(crate) fn shallow_copy(&mut self, id: Id) -> Id {
        let node = self.node(id).clone();
        self.push(node)
    }
}
