//! The wire format of Protocol Buffers: fields of a message, without a schema and without copies.
//!
//! Source: the encoding guide of Protocol Buffers. Groups, which no schema here uses, are skipped.
//!
//! The decoder is our own: it needs no schema compiler, and the memory of values is counted before they are made
//! (`decode/budget.rs`).

use super::message_error::{MAX_GROUPS, MessageError, MessageProblem, Place};

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

/// What a key begins.
enum Part<'r> {
    Field(Field<'r>),
    StartGroup(u32),
    EndGroup(u32),
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
        while self.at < self.message.bytes.len() {
            match self.part(place)? {
                Part::Field(field) => return Ok(Some(field)),
                Part::StartGroup(number) => self.skip_group(number, place)?,
                Part::EndGroup(_) => return Err(self.error(place, MessageProblem::Group)),
            }
        }
        Ok(None)
    }

    /// A field, or the start or end of a group.
    #[inline]
    fn part(&mut self, place: &Place) -> Result<Part<'r>, MessageError> {
        let start = self.at;
        let key = self.varint(place)?;
        let number = key >> 3;
        if number == 0 || number >= 1 << 29 {
            return Err(self.error_at(start, place, MessageProblem::FieldNumber(number)));
        }
        let number = number as u32;
        let mut at = self.at;
        let value = match key & 7 {
            0 => Value::Varint(self.varint(place)?),
            1 => Value::Fixed64(*self.array(place)?),
            2 => {
                let length = self.varint(place)?;
                at = self.at;
                Value::Bytes(self.take(length, place)?)
            }
            5 => Value::Fixed32(*self.array(place)?),
            3 => return Ok(Part::StartGroup(number)),
            4 => return Ok(Part::EndGroup(number)),
            other => {
                return Err(self.error_at(start, place, MessageProblem::UnknownWireType(other as u8)));
            }
        };
        Ok(Part::Field(Field { number, value, offset: self.message.offset + at }))
    }

    /// Skips the rest of a group and the groups in it.
    #[cold]
    fn skip_group(&mut self, number: u32, place: &Place) -> Result<(), MessageError> {
        let mut open = vec![number];
        while let Some(innermost) = open.last().copied() {
            if self.at == self.message.bytes.len() {
                return Err(self.error(place, MessageProblem::Group));
            }
            match self.part(place)? {
                Part::Field(_) => {}
                Part::StartGroup(_) if open.len() == MAX_GROUPS => {
                    return Err(self.error(place, MessageProblem::Depth));
                }
                Part::StartGroup(number) => open.push(number),
                Part::EndGroup(number) if number == innermost => drop(open.pop()),
                Part::EndGroup(_) => return Err(self.error(place, MessageProblem::Group)),
            }
        }
        Ok(())
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
        // Some writers encode a negative number in 32 bits.
        let narrow = i32::try_from(value).ok().or(u32::try_from(value).ok().map(|value| value as i32));
        narrow.ok_or_else(|| MessageError::value(self.offset, place, value, "a 32-bit integer"))
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
        // The end of another group.
        assert_eq!(problem(&[0x7b, 0x74]), Some(MessageProblem::Group));
        assert_eq!(problem(&[0x7b; 200]), Some(MessageProblem::Depth));
    }

    #[test]
    fn lengths_end_inside_their_message() {
        let error = first(&[0x0a, 0x05, 1, 2, 3]).err().unwrap();
        assert_eq!(error.problem, MessageProblem::Truncated { needed: 5, left: 3 });
        assert_eq!(error.offset, 2);
    }
}
