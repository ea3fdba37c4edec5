//! Opcodes that store values in the memo and recall them.

use super::program::{LARGEST, Writer};

impl Writer {
    pub(super) fn maybe_store(&mut self) {
        if self.rng.below(3) == 0 {
            self.store();
        }
    }

    pub(super) fn store(&mut self) {
        let Some(top) = self.open().last().copied() else { return self.literal() };
        let next = self.memo.len() as u32;
        let entry_index = match self.rng.below(5) {
            0..3 => {
                self.op(0x94);
                self.memoizes_after_gap |= self.memo.keys().next_back().is_some_and(|last| *last >= next);
                next
            }
            3 => {
                let entry_index = self.rng.below(10) as u8;
                self.op(b'q');
                self.out.push(entry_index);
                u32::from(entry_index)
            }
            _ => {
                let most = if self.rng.below(4) == 0 { 3000 } else { 10 };
                let entry_index = self.rng.below(most) as u32;
                self.op(b'r');
                self.out.extend(entry_index.to_le_bytes());
                entry_index
            }
        };
        self.memo.insert(entry_index, top);
    }

    pub(super) fn recall(&mut self) {
        if self.memo.is_empty() {
            return self.store();
        }
        let (entry_index, value) = {
            let entry = self.rng.below(self.memo.len());
            self.memo.iter().nth(entry).map(|(p, v)| (*p, *v)).expect("it is not empty")
        };
        if value.size > LARGEST / 4 {
            return;
        }
        match u8::try_from(entry_index) {
            Ok(entry_index) if self.rng.below(2) == 0 => {
                self.op(b'h');
                self.out.push(entry_index);
            }
            _ => {
                self.op(b'j');
                self.out.extend(entry_index.to_le_bytes());
            }
        }
        self.stack.push(value);
    }
}
