//! Reads the bytes of opcodes, never beyond their frame or the file.

use super::{PickleProblem as Problem, Span, machine::Machine};

impl Machine {
    pub(super) fn take(&mut self, n: u64) -> Result<usize, Problem> {
        if n > (self.end - self.at) as u64 {
            self.leave_frame(n)?;
        }
        let start = self.at;
        self.at += n as usize;
        Ok(start)
    }

    /// Continues after a completely read frame. All bytes of an opcode must be in one frame, because across
    /// a frame's end Python reads other bytes from a file than from memory.
    #[cold]
    fn leave_frame(&mut self, needed: u64) -> Result<(), Problem> {
        let left = self.size - self.at;
        if needed > left as u64 {
            return Err(Problem::Truncated { needed, left });
        }
        if self.at < self.end {
            return Err(Problem::Frame);
        }
        self.end = self.size;
        Ok(())
    }

    #[inline]
    pub(super) fn byte(&mut self) -> Result<u8, Problem> {
        let start = self.take(1)?;
        Ok(self.document[start])
    }

    #[inline]
    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let start = self.take(N as u64)?;
        let mut raw = [0; N];
        raw.copy_from_slice(&self.document[start..start + N]);
        Ok(raw)
    }

    pub(super) fn length<const N: usize>(&mut self) -> Result<u64, Problem> {
        let mut raw = [0; 8];
        raw[..N].copy_from_slice(&self.array::<N>()?);
        Ok(u64::from_le_bytes(raw))
    }

    pub(super) fn span(&mut self, n: u64) -> Result<Span, Problem> {
        let start = self.take(n)?;
        // Files are smaller than 4 GiB, so both fit.
        Ok(Span { start: start as u32, len: n as u32 })
    }

    pub(super) fn slice(&self, span: Span) -> &[u8] {
        &self.document[span.start as usize..(span.start + span.len) as usize]
    }

    pub(super) fn line(&mut self) -> Result<Span, Problem> {
        if self.at == self.end {
            self.end = self.size;
        }
        let rest = &self.document[self.at..self.end];
        let end = rest.iter().position(|b| *b == b'\n');
        let len =
            end.ok_or_else(|| Problem::Truncated { needed: rest.len() as u64 + 1, left: rest.len() })?;
        let start = self.take(len as u64 + 1)?;
        Ok(Span { start: start as u32, len: len as u32 })
    }
}
