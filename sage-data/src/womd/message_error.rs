//! Errors of messages, and the fields at which they are found.

use std::fmt;

/// Deepest nesting of groups that are skipped.
pub(super) const MAX_GROUPS: usize = 100;

/// A field of the message: its name and those of the messages around it. Names are borrowed from the stack and
/// copied only for an error.
#[derive(Clone, Copy)]
pub(super) struct Place<'p> {
    parent: Option<&'p Self>,
    name: &'static str,
    index: Option<usize>,
}

impl<'p> Place<'p> {
    /// The outermost message.
    pub(super) const ROOT: Place<'static> = Place { parent: None, name: "", index: None };

    /// A field of this message.
    pub(super) fn field(&'p self, name: &'static str) -> Self {
        Self { parent: Some(self), name, index: None }
    }

    /// An element of a repeated field of this message.
    pub(super) fn item(&'p self, name: &'static str, index: usize) -> Self {
        Self { parent: Some(self), name, index: Some(index) }
    }
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(parent) = self.parent.filter(|parent| parent.parent.is_some()) {
            write!(f, "{parent}/")?;
        }
        f.write_str(self.name)?;
        self.index.map_or(Ok(()), |index| write!(f, "[{index}]"))
    }
}

/// A message that is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("at byte {offset} of the record: {}{problem}", in_field(field))]
pub struct MessageError {
    /// Offset in the record, bytes.
    pub offset: usize,
    /// Names of the field and of the messages around it, joined by slashes; empty for the record itself.
    pub field: String,
    /// What is wrong.
    pub problem: MessageProblem,
}

fn in_field(field: &str) -> String {
    if field.is_empty() { String::new() } else { format!("field `{field}` ") }
}

/// What is wrong with a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MessageProblem {
    /// A record without bytes.
    #[error("the record is empty; expected a Scenario message")]
    Empty,
    /// Another message than a `Scenario`.
    #[error("{0}")]
    Foreign(String),
    /// A value that extends beyond the end of its message.
    #[error("is truncated: {needed} more bytes needed, {left} left in its message")]
    Truncated {
        /// Declared length, bytes.
        needed: u64,
        /// Bytes left in the message.
        left: usize,
    },
    /// A variable-length integer of more than ten bytes, or without an end.
    #[error("has a varint of more than 10 bytes or without an end")]
    Varint,
    /// A field number outside 1 to 2²⁹−1.
    #[error("holds field number {0}; expected 1 to 536870911")]
    FieldNumber(u64),
    /// A wire type that does not exist.
    #[error("holds wire type {0}; expected 0, 1, 2 or 5")]
    UnknownWireType(u8),
    /// A known field of another wire type than the schema's.
    #[error("has the wire type {found}; expected {expected}")]
    WireType {
        /// Name of the wire type found.
        found: &'static str,
        /// Name of the wire type of the schema.
        expected: &'static str,
    },
    /// A group without a start or an end.
    #[error("holds a group without its start or end")]
    Group,
    /// Groups nested too deep.
    #[error("holds groups more than {MAX_GROUPS} deep")]
    Depth,
    /// Packed numbers whose length is not a multiple of their size.
    #[error("has {0} bytes of packed numbers of 8 bytes each")]
    Packed(usize),
    /// Text that is not UTF-8.
    #[error("is not UTF-8")]
    Text,
    /// A value that no scene has there.
    #[error("is {found}; expected {expected}")]
    Value {
        /// The value.
        found: String,
        /// What a scene has there.
        expected: String,
    },
}

impl MessageError {
    /// An error at a field.
    pub(super) fn at(offset: usize, place: &Place, problem: MessageProblem) -> Self {
        Self { offset, field: place.to_string(), problem }
    }

    /// A value that no scene has.
    pub(super) fn value(
        offset: usize,
        place: &Place,
        found: impl fmt::Display,
        expected: impl Into<String>,
    ) -> Self {
        let problem = MessageProblem::Value { found: found.to_string(), expected: expected.into() };
        Self::at(offset, place, problem)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_name_the_messages_around_a_field() {
        let root = Place::ROOT;
        let track = root.item("tracks", 3);
        let state = track.item("states", 20);
        assert_eq!(state.field("center_x").to_string(), "tracks[3]/states[20]/center_x");
    }
}
