//! Adds values to documents, and replaces them.

use super::{Document, Id, Node, Span};

impl Document {
    /// A document whose root is None, for adding values.
    pub(crate) fn empty() -> Self {
        Self { bytes: Vec::new(), nodes: vec![Node::None], root: Id(0), file_size: 0 }
    }

    /// Sets the size of the file from which the values come, bytes; it limits how far they may be repeated.
    pub(crate) fn set_file_size(&mut self, bytes: usize) {
        self.file_size = bytes;
    }

    /// Sets the root value.
    pub(crate) fn set_root(&mut self, root: Id) {
        self.root = root;
    }

    /// Replaces a value. All references to it then refer to the new value.
    pub(crate) fn replace(&mut self, id: Id, node: Node) {
        self.nodes[id.0 as usize] = node;
    }

    /// Adds a value that no other value references yet.
    pub(crate) fn push(&mut self, node: Node) -> Id {
        let id = Id(self.nodes.len() as u32);
        self.nodes.push(node);
        id
    }

    /// Makes room for bytes that will be added.
    pub(crate) fn reserve_bytes(&mut self, bytes: usize) {
        self.bytes.reserve_exact(bytes);
    }

    /// Adds bytes.
    pub(crate) fn push_bytes(&mut self, bytes: &[u8]) -> Span {
        let start = self.bytes.len() as u32;
        self.bytes.extend_from_slice(bytes);
        Span { start, len: bytes.len() as u32 }
    }

    /// Adds 32-bit floats, little-endian.
    pub(crate) fn push_floats(&mut self, numbers: &[f32]) -> Span {
        let start = self.bytes.len();
        self.bytes.resize(start + 4 * numbers.len(), 0);
        for (slot, x) in self.bytes[start..].as_chunks_mut::<4>().0.iter_mut().zip(numbers) {
            *slot = x.to_le_bytes();
        }
        Span { start: start as u32, len: 4 * numbers.len() as u32 }
    }

    /// Sets a str key of a dict.
    pub(crate) fn set(&mut self, dict: Id, key: &str, value: Id) {
        let span = self.push_bytes(key.as_bytes());
        let index = match self.entries(dict) {
            Some(entries) => entries.iter().rposition(|(k, _)| self.text(*k) == Some(key)),
            None => return,
        };
        let key = self.push(Node::Str(span));
        if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut self.nodes[dict.0 as usize] {
            match index {
                Some(index) => entries[index].1 = value,
                None => entries.push((key, value)),
            }
        }
    }
}
