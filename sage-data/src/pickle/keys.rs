//! Keys of dicts and sets: no two keys of one container may be equal.
//!
//! Of equal keys Python stores the first key and the last value. No pickler writes such a container, so it
//! is refused. Values that Python might consider equal count as equal here: `1`, `1.0`, `True` and a numpy
//! scalar of 1 are one key. A value that cannot be a key is refused at its use as a key.

use std::collections::{HashMap, HashSet};

use super::{
    Document, ElementKind, Global, Id, Node, PickleProblem as Problem,
    machine::{Machine, kind},
};

/// Up to this number of keys, one bit per key out of [`BITS`] distinguishes them. If two keys share a bit,
/// or there are more keys, their signatures are sorted.
const FEW: usize = 64;
/// Number of bits, of which each key sets one.
const BITS: usize = 1024;

impl Machine {
    /// Whether Python accepts a value as a key. A tuple is accepted if all its items are. The traversal
    /// uses a list instead of the call stack and visits each tuple once, because tuples are immutable.
    fn is_hashable(&mut self, id: Id) -> bool {
        let mut open = vec![id];
        let mut visited = HashSet::new();
        while let Some(id) = open.pop() {
            match &self.nodes[id.0 as usize] {
                Node::Tuple(items) => {
                    if self.hashable_tuples.insert(id) {
                        visited.insert(id);
                        open.extend(items);
                    }
                }
                node if node.is_hashable() => {}
                _ => {
                    self.hashable_tuples.retain(|id| !visited.contains(id));
                    return false;
                }
            }
        }
        true
    }

    /// Refuses keys that Python cannot hash.
    pub(super) fn check_hashable(&mut self, keys: &[Id]) -> Result<(), Problem> {
        // Nearly all keys are text.
        let is_plain = |id: &Id| matches!(self.nodes[id.0 as usize], Node::Str(_));
        if keys.iter().all(is_plain) {
            return Ok(());
        }
        match keys.iter().find(|id| !self.is_hashable(**id)) {
            Some(id) => Err(kind("a key", &self.nodes[id.0 as usize], "a value that can be a key")),
            None => Ok(()),
        }
    }
}

/// Canonical form of a key, for comparison.
#[derive(PartialEq, Eq, Hash)]
enum Key<'d> {
    None,
    Int(i64),
    /// Bits of a number that is no 64-bit integer; −0 is the integer 0, and NaN is like any NaN.
    Float(u64),
    Str(&'d [u8]),
    Bytes(&'d [u8]),
    /// Classes of the items, by [`Classes`]; sorted for a frozenset.
    Tuple(Vec<u32>),
    FrozenSet(Vec<u32>),
    Dtype(char, u8, bool),
    Global(Global),
}

/// Class of each value: equal keys have equal classes.
struct Classes(Vec<u32>);

/// Signature of a text: equal texts have equal signatures, and texts of less than eight bytes have unique
/// ones. It does not read all of a long text, which many dicts may share.
fn signature(text: &[u8]) -> u64 {
    let word = |bytes: &[u8]| {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(word)
    };
    let mixed = match text.len() {
        n @ 0..8 => word(text) | (n as u64) << 56,
        n => word(&text[..8]) ^ word(&text[n - 8..]).rotate_left(29) ^ (n as u64) << 50,
    };
    mixed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

impl Document {
    /// Refuses two keys that Python considers equal, in any of the given dicts and sets.
    pub(super) fn check_keys(&self, keyed: &[Id]) -> Result<(), Problem> {
        let mut classes = None;
        let mut signatures = Vec::new();
        for id in keyed {
            match self.node(*id) {
                Node::Dict(v) | Node::DefaultDict { entries: v, .. } => {
                    self.check_distinct(v.iter().map(|(key, _)| *key), &mut signatures, &mut classes)?;
                }
                Node::Set(v) | Node::FrozenSet(v) => {
                    self.check_distinct(v.iter().copied(), &mut signatures, &mut classes)?;
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn check_distinct(
        &self,
        keys: impl ExactSizeIterator<Item = Id> + Clone,
        signatures: &mut Vec<u64>,
        classes: &mut Option<Classes>,
    ) -> Result<(), Problem> {
        let mut taken = [0u64; BITS / 64];
        let mut may_be_equal = keys.len() > FEW;
        signatures.clear();
        for id in keys.clone() {
            let Node::Str(span) = self.node(id) else { return self.check_values(keys, classes) };
            let signature = signature(self.bytes(*span));
            signatures.push(signature);
            let bit = signature as usize >> 48 & (BITS - 1);
            may_be_equal |= taken[bit / 64] >> (bit % 64) & 1 == 1;
            taken[bit / 64] |= 1 << (bit % 64);
        }
        if may_be_equal {
            signatures.sort_unstable();
            if signatures.windows(2).any(|pair| pair[0] == pair[1]) {
                return self.check_values(keys, classes);
            }
        }
        Ok(())
    }

    /// The same check for keys of any kind.
    fn check_values(
        &self,
        mut keys: impl ExactSizeIterator<Item = Id>,
        classes: &mut Option<Classes>,
    ) -> Result<(), Problem> {
        let Classes(classes) = classes.get_or_insert_with(|| self.classes());
        let mut visited = HashSet::with_capacity(keys.len());
        match keys.find(|id| !visited.insert(classes[id.0 as usize])) {
            Some(id) => Err(Problem::DuplicateKey(self.describe(id))),
            None => Ok(()),
        }
    }

    /// Classes of all values. A tuple or frozenset comes after its items, so one pass suffices.
    fn classes(&self) -> Classes {
        let mut known: HashMap<Key, u32> = HashMap::new();
        let mut classes: Vec<u32> = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let of_items = |items: &[Id]| items.iter().map(|id| classes[id.0 as usize]).collect::<Vec<_>>();
            let key = match node {
                Node::Tuple(items) => Some(Key::Tuple(of_items(items))),
                Node::FrozenSet(items) => {
                    let mut items = of_items(items);
                    items.sort_unstable();
                    Some(Key::FrozenSet(items))
                }
                node => self.plain_key(node),
            };
            let next = known.len() as u32;
            // A value that cannot be a key gets a class that is never read.
            classes.push(key.map_or(u32::MAX, |key| *known.entry(key).or_insert(next)));
        }
        Classes(classes)
    }

    fn plain_key(&self, node: &Node) -> Option<Key<'_>> {
        Some(match node {
            Node::None => Key::None,
            Node::Bool(x) => Key::Int(i64::from(*x)),
            Node::Int(x) => Key::Int(*x),
            Node::BigInt(span) => number(big(self.bytes(*span))),
            Node::Float(x) => number(*x),
            Node::Scalar(dtype, span) => {
                let bytes = self.bytes(*span);
                let is_integer = matches!(dtype.kind, ElementKind::Int | ElementKind::Uint);
                let whole = is_integer.then(|| dtype.integer(bytes)).flatten();
                whole.map_or_else(|| number(dtype.read(bytes).next().unwrap_or(f64::NAN)), Key::Int)
            }
            Node::Str(span) => Key::Str(self.bytes(*span)),
            Node::Bytes(span) => Key::Bytes(self.bytes(*span)),
            Node::Dtype(dtype) => Key::Dtype(dtype.letter(), dtype.size, dtype.big_endian && dtype.size > 1),
            Node::Global(global) => Key::Global(*global),
            _ => return None,
        })
    }
}

/// Canonical form of a number. Numbers from 2⁶³ on are not 64-bit integers.
fn number(x: f64) -> Key<'static> {
    const END: f64 = 9_223_372_036_854_775_808.0;
    if x.fract() == 0.0 && (-END..END).contains(&x) {
        Key::Int(x as i64)
    } else if x.is_nan() {
        Key::Float(f64::NAN.to_bits())
    } else {
        Key::Float(x.to_bits())
    }
}

/// A large int, rounded; two that round to the same number count as equal.
fn big(bytes: &[u8]) -> f64 {
    let negative = bytes.last().is_some_and(|b| b & 0x80 != 0);
    let digit = |b: &u8| f64::from(if negative { !*b } else { *b });
    let magnitude = bytes.iter().rev().fold(0.0, |sum, b| sum * 256.0 + digit(b));
    if negative { -magnitude - 1.0 } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pickle::PickleError;

    fn parse(body: &[u8]) -> Result<Document, PickleError> {
        Document::parse([b"\x80\x04", body, b"."].concat())
    }

    #[test]
    fn equal_keys_are_refused_in_every_spelling() {
        let float = |x: f64| [b"G".as_slice(), &x.to_be_bytes()].concat();
        let one = float(1.0);
        let long_one = [b"\x8a\x09\x01".as_slice(), &[0; 8]].concat();
        let pair = |item: &[u8]| [item, b"\x85"].concat();
        let set = |item: &[u8]| [b"(", item, b"\x91"].concat();
        for (a, b) in [
            (b"\x8c\x01a".as_slice(), b"U\x01a".as_slice()),
            (b"K\x01", b"\x88"),
            (b"K\x01", &one),
            (b"M\x01\x00", &long_one),
            (b"K\x00", &float(-0.0)),
            (&pair(b"K\x01"), &pair(&one)),
            (&set(b"N"), &set(b"N")),
        ] {
            let dict = parse(&[b"}(", a, b"N", b, b"Nu"].concat());
            let set = parse(&[b"\x8f(", a, b, b"\x90"].concat());
            for error in [dict.unwrap_err(), set.unwrap_err()] {
                assert!(matches!(error.kind, Problem::DuplicateKey(_)), "{error}");
            }
        }
        assert!(parse(b"}(\x8c\x01aNC\x01aNK\x01NK\x02N\x8c\x00NN\x85NNNu").is_ok(), "these are distinct");
    }

    #[test]
    fn many_keys_are_distinguished_by_their_text() {
        let mut body = b"}(".to_vec();
        for k in 0..50u8 {
            body.extend([0x8c, 1, k, b'N']);
            body.extend([b"\x8c\x0da long text ".as_slice(), &[k, b'N']].concat());
        }
        assert!(parse(&[&body[..], b"u"].concat()).is_ok());
        for twice in [b"\x8c\x01\x07Nu".as_slice(), b"\x8c\x0da long text \x07Nu"] {
            assert!(parse(&[&body[..], twice].concat()).is_err());
        }
    }

    #[test]
    fn long_keys_that_differ_in_their_middle_are_distinct() {
        let key = |middle: u8| [b"\x8c\x14AAAAAAAA".as_slice(), &[middle; 4], b"BBBBBBBB"].concat();
        let [a, b] = [key(b'x'), key(b'y')];
        assert_eq!(signature(&a[2..]), signature(&b[2..]));
        assert!(parse(&[b"}(", &a[..], b"N", &b, b"Nu"].concat()).is_ok());
        assert!(parse(&[b"}(", &a[..], b"N", &b, b"N", &a, b"Nu"].concat()).is_err());
    }

    #[test]
    fn a_tuple_that_contains_a_list_cannot_be_a_key() {
        assert!(parse(b"}]\x85Ns").is_err());
        assert!(parse(b"}]\x85\x85Ns").is_err());
        assert!(parse(b"}N\x85\x85Ns").is_ok());
    }
}
