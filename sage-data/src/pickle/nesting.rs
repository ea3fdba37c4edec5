//! Guarantees of a finished document: no cycles, limited nesting, no unfinished values.

use std::slice::Iter;

use super::{Document, Id, MAX_DEPTH, Node, PickleProblem as Problem};

/// State of a value during the traversal.
#[derive(Clone, Copy)]
enum Visit {
    New,
    /// On the path from the root to the current value.
    Open,
    /// Completed; with the number of container levels, itself included, at most [`MAX_DEPTH`].
    Done(u8),
}

/// A container on the path.
struct Step<'d> {
    id: Id,
    children: Children<'d>,
    /// Levels of the deepest child so far.
    below: usize,
}

/// Remaining children of a container; keys and values of a dict alternate.
enum Children<'d> {
    Items(Iter<'d, Id>),
    Entries(Iter<'d, (Id, Id)>, Option<Id>),
}

impl Children<'_> {
    #[inline]
    fn next(&mut self) -> Option<Id> {
        match self {
            Self::Items(items) => items.next().copied(),
            Self::Entries(entries, value) => value.take().or_else(|| {
                let (key, next) = *entries.next()?;
                *value = Some(next);
                Some(key)
            }),
        }
    }
}

impl Document {
    /// Refuses cycles, deep nesting and unfinished values among all values reachable from the root; returns
    /// the dicts and sets. Shared values are traversed once, and the path is a list instead of the call
    /// stack.
    pub(super) fn check_nesting(&self) -> Result<Vec<Id>, Problem> {
        let mut keyed = Vec::new();
        let mut states = vec![Visit::New; self.nodes.len()];
        let mut path: Vec<Step> = Vec::with_capacity(MAX_DEPTH);
        let mut next = Some(self.root);
        loop {
            if let Some(id) = next {
                match states[id.0 as usize] {
                    Visit::Open => return Err(Problem::Cycle),
                    Visit::Done(levels) => {
                        let levels = usize::from(levels);
                        if path.len() + levels > MAX_DEPTH {
                            return Err(Problem::Depth);
                        }
                        if let Some(parent) = path.last_mut() {
                            parent.below = parent.below.max(levels);
                        }
                    }
                    Visit::New => {
                        if let Some(children) = self.children(id)? {
                            if path.len() == MAX_DEPTH {
                                return Err(Problem::Depth);
                            }
                            states[id.0 as usize] = Visit::Open;
                            if !matches!(self.node(id), Node::List(_) | Node::Tuple(_)) {
                                keyed.push(id);
                            }
                            path.push(Step { id, children, below: 0 });
                        }
                    }
                }
            }
            let Some(step) = path.last_mut() else { return Ok(keyed) };
            next = step.children.next();
            if next.is_none() {
                let levels = step.below + 1;
                states[step.id.0 as usize] = Visit::Done(levels as u8);
                path.pop();
                if let Some(parent) = path.last_mut() {
                    parent.below = parent.below.max(levels);
                }
            }
        }
    }

    /// Children of a value; `None` if it is not a container.
    fn children(&self, id: Id) -> Result<Option<Children<'_>>, Problem> {
        let unfinished = |found, expected| Err(Problem::Kind { what: "a value", found, expected });
        match self.node(id) {
            Node::List(v) | Node::Tuple(v) | Node::Set(v) | Node::FrozenSet(v) => {
                Ok(Some(Children::Items(v.iter())))
            }
            Node::Dict(v) | Node::DefaultDict { entries: v, .. } => {
                Ok(Some(Children::Entries(v.iter(), None)))
            }
            Node::Unbuilt => unfinished("an array without state", "a finished array"),
            Node::UnbuiltDtype(_) => unfinished("a numpy type without state", "a finished type"),
            Node::Global(_) => unfinished("a function or class", "plain data"),
            _ => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nested one-tuples.
    fn nested(levels: usize) -> Result<Document, super::super::PickleError> {
        let mut bytes = vec![0x80, 4, b'N'];
        bytes.extend(std::iter::repeat_n(0x85, levels));
        bytes.push(b'.');
        Document::parse(bytes)
    }

    #[test]
    fn nesting_is_allowed_to_the_limit_and_not_beyond() {
        assert!(nested(MAX_DEPTH).is_ok());
        assert_eq!(nested(MAX_DEPTH + 1).err().map(|e| e.kind), Some(Problem::Depth));
    }

    #[test]
    fn a_shared_value_counts_at_its_deepest_position() {
        // [v, [[…[v]…]]] with v 40 deep: allowed alone, too deep inside 30 more levels.
        let build = |inner: usize| {
            let mut bytes = vec![0x80, 4, b'(', b'N'];
            bytes.extend(std::iter::repeat_n(0x85, 40));
            bytes.extend([0x94, b'h', 0]);
            bytes.extend(std::iter::repeat_n(0x85, inner));
            bytes.extend(b"t.");
            Document::parse(bytes)
        };
        assert!(build(MAX_DEPTH - 41).is_ok());
        assert_eq!(build(MAX_DEPTH - 40).err().map(|e| e.kind), Some(Problem::Depth));
    }
}
