//! Writes a pickled dict entry by entry, so that the whole dict need not fit in memory.

use std::io::{self, Write};

use super::{Document, opcode as op};

/// A partly written dict with str keys.
pub(crate) struct DictWriter<'w> {
    out: &'w mut dyn Write,
    memo: u32,
}

impl<'w> DictWriter<'w> {
    /// Begins a pickle of protocol 4 whose root value is the dict.
    pub(crate) fn begin(out: &'w mut dyn Write) -> io::Result<Self> {
        out.write_all(&[op::PROTO, 4, op::EMPTY_DICT])?;
        Ok(Self { out, memo: 0 })
    }

    /// Adds an entry. Keys must differ, and the value must not need protocol 5.
    pub(crate) fn add(&mut self, key: &str, value: &Document) -> io::Result<()> {
        let mut bytes = vec![op::BINUNICODE];
        bytes.extend((key.len() as u32).to_le_bytes());
        bytes.extend_from_slice(key.as_bytes());
        self.memo = value.append_to(&mut bytes, self.memo);
        bytes.push(op::SETITEM);
        self.out.write_all(&bytes)
    }

    /// Ends the pickle.
    pub(crate) fn end(self) -> io::Result<()> {
        self.out.write_all(&[op::STOP])
    }
}
