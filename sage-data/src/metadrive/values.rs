//! MetaDrive values that are built from a scene of another format, with shared texts and numbers.

use std::collections::HashMap;

use crate::pickle::{Array, Document, Dtype, ElementKind, Id, Node, Span};

const F32: Dtype = Dtype { kind: ElementKind::Float, size: 4, big_endian: false };
const F64: Dtype = Dtype { kind: ElementKind::Float, size: 8, big_endian: false };
const BOOL: Dtype = Dtype { kind: ElementKind::Bool, size: 1, big_endian: false };

/// Integers as texts. Most are indices of points, which need no hashing.
struct Decimals {
    small: Vec<Option<Id>>,
    others: HashMap<i64, Option<Id>>,
}

impl Decimals {
    fn new() -> Self {
        Self { small: vec![None; 1024], others: HashMap::new() }
    }
}

/// Keys and words of enums. Their addresses in the program need no hashing of texts.
struct Words([Option<(&'static str, Id)>; SLOTS]);

/// Places for words, of which there are about a hundred.
const SLOTS: usize = 512;

impl Words {
    fn get(&mut self, word: &'static str, document: &mut Document) -> Id {
        let mut slot =
            word.as_ptr().addr().wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (usize::BITS - SLOTS.ilog2());
        // Ends at the latest after a round: then the word is not kept.
        for _ in 0..SLOTS {
            match self.0[slot] {
                Some((known, id)) if std::ptr::eq(known, word) => return id,
                Some(_) => slot = (slot + 1) % SLOTS,
                None => {
                    // The program may hold a text at two addresses, and the result must not depend on that.
                    let known = self.0.iter().flatten().find(|(known, _)| *known == word);
                    let id = known.map_or_else(|| document.new_text(word), |(_, id)| *id);
                    self.0[slot] = Some((word, id));
                    return id;
                }
            }
        }
        document.new_text(word)
    }
}

/// The dicts of a scene.
pub(crate) struct SceneValues {
    pub(crate) tracks: Id,
    pub(crate) lights: Id,
    pub(crate) features: Id,
    pub(crate) metadata: Id,
}

/// Builds a document. Equal texts and integers are one value.
pub(crate) struct Values {
    pub(crate) document: Document,
    words: Words,
    integers: HashMap<i64, Id>,
    decimals: Decimals,
    none: Id,
    no: Id,
    yes: Id,
}

impl Values {
    /// No values yet, with room for some bytes of texts and arrays.
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        let mut document = Document::empty();
        document.reserve_bytes(bytes);
        let [none, no, yes] =
            [Node::None, Node::Bool(false), Node::Bool(true)].map(|node| document.push(node));
        let (words, integers, decimals) = (Words([None; SLOTS]), HashMap::new(), Decimals::new());
        Self { document, words, integers, decimals, none, no, yes }
    }

    pub(crate) fn none(&self) -> Id {
        self.none
    }

    pub(crate) fn bool(&self, value: bool) -> Id {
        if value { self.yes } else { self.no }
    }

    /// A key or a word of an enum.
    pub(crate) fn word(&mut self, word: &'static str) -> Id {
        self.words.get(word, &mut self.document)
    }

    pub(crate) fn text(&mut self, text: &str) -> Id {
        self.document.new_text(text)
    }

    pub(crate) fn int(&mut self, value: i64) -> Id {
        *self.integers.entry(value).or_insert_with(|| self.document.push(Node::Int(value)))
    }

    /// An integer as a str.
    pub(crate) fn decimal(&mut self, value: i64) -> Id {
        let known = match usize::try_from(value).ok().and_then(|value| self.decimals.small.get_mut(value)) {
            Some(known) => known,
            None => self.decimals.others.entry(value).or_insert(None),
        };
        *known.get_or_insert_with(|| self.document.new_text(&value.to_string()))
    }

    pub(crate) fn float(&mut self, value: f64) -> Id {
        self.document.push(Node::Float(value))
    }

    pub(crate) fn list(&mut self, items: Vec<Id>) -> Id {
        self.document.push(Node::List(items))
    }

    pub(crate) fn dict<const N: usize>(&mut self, entries: [(&'static str, Id); N]) -> Id {
        let entries = entries.map(|(key, value)| (self.word(key), value)).to_vec();
        self.entries(entries)
    }

    pub(crate) fn entries(&mut self, entries: Vec<(Id, Id)>) -> Id {
        self.document.push(Node::Dict(entries))
    }

    /// An array of 32-bit floats.
    pub(crate) fn floats(&mut self, shape: &[usize], numbers: &[f32]) -> Id {
        let data = self.document.push_floats(numbers);
        self.array(F32, shape, data)
    }

    /// Makes a scene the root of the document.
    pub(crate) fn set_scene(&mut self, id: &str, version: &'static str, frames: usize, scene: SceneValues) {
        let (id, version, length) = (self.text(id), self.word(version), self.int(frames as i64));
        let root = self.dict([
            ("id", id),
            ("version", version),
            ("length", length),
            ("tracks", scene.tracks),
            ("dynamic_map_states", scene.lights),
            ("map_features", scene.features),
            ("metadata", scene.metadata),
        ]);
        self.document.set_root(root);
    }

    /// An array of 64-bit floats.
    pub(crate) fn doubles(&mut self, shape: &[usize], numbers: &[f64]) -> Id {
        let data = self.document.push_doubles(numbers);
        self.array(F64, shape, data)
    }

    /// An array of bools, one byte each.
    pub(crate) fn bools(&mut self, bytes: &[u8]) -> Id {
        let data = self.document.push_bytes(bytes);
        self.array(BOOL, &[bytes.len()], data)
    }

    fn array(&mut self, dtype: Dtype, shape: &[usize], data: Span) -> Id {
        let shape = shape.iter().map(|n| *n as u32).collect();
        self.document.push(Node::Array(Box::new(Array {
            dtype,
            shape,
            fortran: false,
            from_buffer: false,
            data,
        })))
    }
}
