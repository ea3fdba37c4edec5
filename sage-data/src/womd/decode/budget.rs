//! The limit on the size of the values that a record becomes.

use crate::womd::message_error::{MessageError, Place};

/// A dict without entries and with this many entries takes about `DICT + ENTRY * n` bytes.
pub(super) const DICT: usize = 64;
pub(super) const ENTRY: usize = 8;

/// Bytes that the values of a record may still take.
pub(super) struct Budget(usize);

impl Budget {
    /// The limit for a record, as for pickles. Without a limit, a message of two bytes could become a track.
    pub(super) fn of(record: usize) -> Self {
        Self(record.saturating_mul(4).saturating_add(4 << 20))
    }

    /// Accounts for values of `bytes` bytes.
    ///
    /// *Errors*: the limit is reached; `what` names the values.
    #[inline]
    pub(super) fn spend(
        &mut self,
        bytes: usize,
        offset: usize,
        place: &Place,
        what: &str,
    ) -> Result<(), MessageError> {
        match self.0.checked_sub(bytes) {
            Some(left) => {
                self.0 = left;
                Ok(())
            }
            None => Err(MessageError::value(
                offset,
                place,
                format!("part of a scene with more {what} than a record of its size describes"),
                "a scene that is not many times larger than its record",
            )),
        }
    }
}
