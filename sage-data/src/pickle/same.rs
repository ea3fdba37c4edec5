//! Equality of documents, value by value.

use std::collections::HashSet;

use super::{Document, Id, Node};

/// Whether two values are equal: kinds, order of entries, types, shapes and bits. Sharing of values does
/// not count.
pub fn same(a: &Document, a_root: Id, b: &Document, b_root: Id) -> bool {
    let mut compared: HashSet<(Id, Id)> = HashSet::new();
    let mut open = vec![(a_root, b_root)];
    while let Some((x, y)) = open.pop() {
        let lists = |p: &[Id], q: &[Id], open: &mut Vec<(Id, Id)>| {
            open.extend(p.iter().copied().zip(q.iter().copied()));
            p.len() == q.len()
        };
        let pairs = |p: &[(Id, Id)], q: &[(Id, Id)], open: &mut Vec<(Id, Id)>| {
            open.extend(p.iter().zip(q).flat_map(|(p, q)| [(p.0, q.0), (p.1, q.1)]));
            p.len() == q.len()
        };
        let equal = match (a.node(x), b.node(y)) {
            (Node::None, Node::None) => true,
            (Node::Bool(p), Node::Bool(q)) => p == q,
            (Node::Int(p), Node::Int(q)) => p == q,
            (Node::Float(p), Node::Float(q)) => p.to_bits() == q.to_bits(),
            (Node::BigInt(p), Node::BigInt(q))
            | (Node::Str(p), Node::Str(q))
            | (Node::Bytes(p), Node::Bytes(q))
            | (Node::ByteArray(p), Node::ByteArray(q)) => a.bytes(*p) == b.bytes(*q),
            (Node::Scalar(p, s), Node::Scalar(q, t)) => p == q && a.bytes(*s) == b.bytes(*t),
            (Node::Dtype(p), Node::Dtype(q)) => p == q,
            (Node::Array(p), Node::Array(q)) => {
                p.dtype == q.dtype
                    && p.shape == q.shape
                    && p.fortran == q.fortran
                    && a.bytes(p.data) == b.bytes(q.data)
            }
            // Many values can share one container; each pair is compared once.
            _ if !compared.insert((x, y)) => true,
            (Node::List(p), Node::List(q))
            | (Node::Tuple(p), Node::Tuple(q))
            | (Node::Set(p), Node::Set(q))
            | (Node::FrozenSet(p), Node::FrozenSet(q)) => lists(p, q, &mut open),
            (Node::Dict(p), Node::Dict(q)) => pairs(p, q, &mut open),
            (
                Node::DefaultDict { int_factory: f, entries: p },
                Node::DefaultDict { int_factory: g, entries: q },
            ) => f == g && pairs(p, q, &mut open),
            _ => false,
        };
        if !equal {
            return false;
        }
    }
    true
}
