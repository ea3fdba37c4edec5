//! The wire format of Protocol Buffers: fields of a message, without a schema and without copies.
//!
//! Source: the encoding guide of Protocol Buffers. Groups, which no schema here uses, are skipped.

use std::fmt;

/// Deepest nesting of groups that are skipped.
const MAX_GROUPS: usize = 100;

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

/// Bytes of a message, and where they begin in the record.
#[derive(Clone, Copy)]
pub(super) struct Message<'r> {
    pub(super) bytes: &'r [u8],
    pub(super) offset: usize,
}

/// Value of a field.
#[derive(Clone, Copy)]
pub(super) enum Value<'r> {
    Varint(u64),
    Fixed64([u8; 8]),
    Fixed32([u8; 4]),
    Bytes(&'r [u8]),
}

impl Value<'_> {
    fn wire_type(&self) -> &'static str {
        match self {
            Self::Varint(_) => "varint (0)",
            Self::Fixed64(_) => "64-bit (1)",
            Self::Bytes(_) => "length-delimited (2)",
            Self::Fixed32(_) => "32-bit (5)",
        }
    }
}

/// One field of a message.
#[derive(Clone, Copy)]
pub(super) struct Field<'r> {
    pub(super) number: u32,
    pub(super) value: Value<'r>,
    /// Offset in the record of the value; for bytes, of the first one.
    pub(super) offset: usize,
}

/// Reads the fields of a message in their order.
pub(super) struct Fields<'r> {
    message: Message<'r>,
    at: usize,
}

impl<'r> Message<'r> {
    /// The fields of the message.
    pub(super) fn fields(self) -> Fields<'r> {
        Fields { message: self, at: 0 }
    }
}

impl<'r> Fields<'r> {
    /// The next field; `None` at the end of the message. Groups are skipped.
    ///
    /// *Errors*: bytes that are no field; the error names `place`.
    #[inline]
    pub(super) fn next(&mut self, place: &Place) -> Result<Option<Field<'r>>, MessageError> {
        let mut open_groups = 0;
        loop {
            if self.at == self.message.bytes.len() {
                return if open_groups == 0 {
                    Ok(None)
                } else {
                    Err(self.error(place, MessageProblem::Group))
                };
            }
            let start = self.at;
            let key = self.varint(place)?;
            let number = key >> 3;
            if number == 0 || number >= 1 << 29 {
                return Err(self.error_at(start, place, MessageProblem::FieldNumber(number)));
            }
            let mut offset = self.at;
            let value = match key & 7 {
                0 => Value::Varint(self.varint(place)?),
                1 => Value::Fixed64(*self.array(place)?),
                2 => {
                    let length = self.varint(place)?;
                    offset = self.at;
                    Value::Bytes(self.take(length, place)?)
                }
                5 => Value::Fixed32(*self.array(place)?),
                3 if open_groups == MAX_GROUPS => {
                    return Err(self.error_at(start, place, MessageProblem::Depth));
                }
                3 => {
                    open_groups += 1;
                    continue;
                }
                4 if open_groups == 0 => return Err(self.error_at(start, place, MessageProblem::Group)),
                4 => {
                    open_groups -= 1;
                    continue;
                }
                other => {
                    return Err(self.error_at(start, place, MessageProblem::UnknownWireType(other as u8)));
                }
            };
            if open_groups == 0 {
                let offset = self.message.offset + offset;
                return Ok(Some(Field { number: number as u32, value, offset }));
            }
        }
    }

    /// Offset in the record of the next field.
    pub(super) fn offset(&self) -> usize {
        self.message.offset + self.at
    }

    /// The next `N` bytes, for a faster reading of usual fields; `None` if fewer are left.
    #[inline]
    pub(super) fn peek<const N: usize>(&self) -> Option<&'r [u8; N]> {
        self.message.bytes[self.at..].first_chunk()
    }

    /// Skips bytes that [`Fields::peek`] returned.
    #[inline]
    pub(super) fn advance(&mut self, bytes: usize) {
        self.at += bytes;
    }

    fn error(&self, place: &Place, problem: MessageProblem) -> MessageError {
        self.error_at(self.at, place, problem)
    }

    fn error_at(&self, at: usize, place: &Place, problem: MessageProblem) -> MessageError {
        MessageError::at(self.message.offset + at, place, problem)
    }

    #[inline]
    fn varint(&mut self, place: &Place) -> Result<u64, MessageError> {
        match self.message.bytes[self.at..] {
            [byte, ..] if byte < 0x80 => {
                self.at += 1;
                Ok(u64::from(byte))
            }
            _ => {
                let found = varint(&self.message.bytes[self.at..]);
                let (value, length) = found.ok_or_else(|| self.error(place, MessageProblem::Varint))?;
                self.at += length;
                Ok(value)
            }
        }
    }

    #[inline]
    fn array<const N: usize>(&mut self, place: &Place) -> Result<&'r [u8; N], MessageError> {
        match self.message.bytes[self.at..].first_chunk() {
            Some(array) => {
                self.at += N;
                Ok(array)
            }
            None => Err(self.truncated(N as u64, place)),
        }
    }

    #[inline]
    fn take(&mut self, length: u64, place: &Place) -> Result<&'r [u8], MessageError> {
        let rest = &self.message.bytes[self.at..];
        match usize::try_from(length).ok().and_then(|length| rest.get(..length)) {
            Some(taken) => {
                self.at += taken.len();
                Ok(taken)
            }
            None => Err(self.truncated(length, place)),
        }
    }

    fn truncated(&self, needed: u64, place: &Place) -> MessageError {
        let left = self.message.bytes.len() - self.at;
        self.error(place, MessageProblem::Truncated { needed, left })
    }
}

/// The varint at the start of `bytes` and its length; `None` if it does not end within ten bytes.
fn varint(bytes: &[u8]) -> Option<(u64, usize)> {
    let mut value = 0;
    for (k, byte) in bytes.iter().take(10).enumerate() {
        // Bits beyond the 64th of a tenth byte are lost, as in other parsers.
        value |= u64::from(byte & 0x7f).checked_shl(7 * k as u32).unwrap_or(0);
        if *byte < 0x80 {
            return Some((value, k + 1));
        }
    }
    None
}

impl<'r> Field<'r> {
    fn wrong_type(&self, place: &Place, expected: &'static str) -> MessageError {
        let problem = MessageProblem::WireType { found: self.value.wire_type(), expected };
        MessageError::at(self.offset, place, problem)
    }

    /// A double.
    #[inline]
    pub(super) fn double(&self, place: &Place) -> Result<f64, MessageError> {
        match self.value {
            Value::Fixed64(bytes) => Ok(f64::from_le_bytes(bytes)),
            _ => Err(self.wrong_type(place, "64-bit (1)")),
        }
    }

    /// A float.
    #[inline]
    pub(super) fn float(&self, place: &Place) -> Result<f32, MessageError> {
        match self.value {
            Value::Fixed32(bytes) => Ok(f32::from_le_bytes(bytes)),
            _ => Err(self.wrong_type(place, "32-bit (5)")),
        }
    }

    /// An int64.
    #[inline]
    pub(super) fn int64(&self, place: &Place) -> Result<i64, MessageError> {
        match self.value {
            Value::Varint(value) => Ok(value as i64),
            _ => Err(self.wrong_type(place, "varint (0)")),
        }
    }

    /// An int32.
    ///
    /// *Errors*: another wire type, or a number that does not fit.
    pub(super) fn int32(&self, place: &Place) -> Result<i32, MessageError> {
        let value = self.int64(place)?;
        i32::try_from(value).map_err(|_| MessageError::value(self.offset, place, value, "a 32-bit integer"))
    }

    /// A bool.
    #[inline]
    pub(super) fn bool(&self, place: &Place) -> Result<bool, MessageError> {
        Ok(self.int64(place)? != 0)
    }

    /// The word of an enum value.
    ///
    /// *Errors*: another wire type, or a value without a word.
    pub(super) fn word(
        &self,
        words: &'static [&'static str],
        place: &Place,
    ) -> Result<&'static str, MessageError> {
        let value = self.int64(place)?;
        let word = usize::try_from(value).ok().and_then(|value| words.get(value).copied());
        word.ok_or_else(|| {
            MessageError::value(self.offset, place, value, format!("0 to {}", words.len() - 1))
        })
    }

    /// Bytes, as a message.
    #[inline]
    pub(super) fn message(&self, place: &Place) -> Result<Message<'r>, MessageError> {
        match self.value {
            Value::Bytes(bytes) => Ok(Message { bytes, offset: self.offset }),
            _ => Err(self.wrong_type(place, "length-delimited (2)")),
        }
    }

    /// A text.
    ///
    /// *Errors*: another wire type, or bytes that are not UTF-8.
    pub(super) fn text(&self, place: &Place) -> Result<&'r str, MessageError> {
        let bytes = self.message(place)?.bytes;
        std::str::from_utf8(bytes).map_err(|_| MessageError::at(self.offset, place, MessageProblem::Text))
    }

    /// Passes one or several integers, packed or not, to `take`.
    ///
    /// *Errors*: another wire type, a broken varint, or those of `take`.
    pub(super) fn integers(
        &self,
        place: &Place,
        mut take: impl FnMut(i64) -> Result<(), MessageError>,
    ) -> Result<(), MessageError> {
        let Value::Bytes(bytes) = self.value else { return take(self.int64(place)?) };
        let mut at = 0;
        while at < bytes.len() {
            let (value, length) = varint(&bytes[at..])
                .ok_or_else(|| MessageError::at(self.offset + at, place, MessageProblem::Varint))?;
            take(value as i64)?;
            at += length;
        }
        Ok(())
    }

    /// Passes one or several doubles, packed or not, with their offsets to `take`.
    ///
    /// *Errors*: another wire type, a length that is no multiple of 8, or those of `take`.
    pub(super) fn doubles(
        &self,
        place: &Place,
        mut take: impl FnMut(usize, f64) -> Result<(), MessageError>,
    ) -> Result<(), MessageError> {
        let Value::Bytes(bytes) = self.value else { return take(self.offset, self.double(place)?) };
        let (numbers, rest) = bytes.as_chunks::<8>();
        if !rest.is_empty() {
            return Err(MessageError::at(self.offset, place, MessageProblem::Packed(bytes.len())));
        }
        for (k, bytes) in numbers.iter().enumerate() {
            take(self.offset + 8 * k, f64::from_le_bytes(*bytes))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first(bytes: &[u8]) -> Result<Option<Field<'_>>, MessageError> {
        Message { bytes, offset: 0 }.fields().next(&Place::ROOT)
    }

    #[test]
    fn varints_have_at_most_ten_bytes() {
        assert_eq!(varint(&[0x96, 0x01]), Some((150, 2)));
        // A longer encoding than needed is valid.
        assert_eq!(varint(&[0x8a, 0x80, 0x00]), Some((10, 3)));
        // −1 as an int32 or int64.
        let minus_one = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01];
        assert_eq!(varint(&minus_one), Some((u64::MAX, 10)));
        assert_eq!(varint(&[0xff; 11]), None);
        assert_eq!(varint(&[0x80]), None);
        assert_eq!(varint(&[]), None);
    }

    #[test]
    fn groups_are_skipped_with_what_they_hold() {
        // Field 15 as a group that holds field 1 = 1, then field 1 = 7.
        let field = first(&[0x7b, 0x08, 0x01, 0x7c, 0x08, 0x07]).unwrap().unwrap();
        assert_eq!((field.number, field.int64(&Place::ROOT)), (1, Ok(7)));
        let problem = |bytes: &[u8]| first(bytes).err().map(|error| error.problem);
        assert_eq!(problem(&[0x7b, 0x08, 0x01]), Some(MessageProblem::Group));
        assert_eq!(problem(&[0x7c]), Some(MessageProblem::Group));
        assert_eq!(problem(&[0x7b; 200]), Some(MessageProblem::Depth));
    }

    #[test]
    fn lengths_end_inside_their_message() {
        let error = first(&[0x0a, 0x05, 1, 2, 3]).err().unwrap();
        assert_eq!(error.problem, MessageProblem::Truncated { needed: 5, left: 3 });
        assert_eq!(error.offset, 2);
    }

    #[test]
    fn places_name_the_messages_around_a_field() {
        let root = Place::ROOT;
        let track = root.item("tracks", 3);
        let state = track.item("states", 20);
        assert_eq!(state.field("center_x").to_string(), "tracks[3]/states[20]/center_x");
    }
}
