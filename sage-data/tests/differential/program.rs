//! Pickle programs from a number: mostly valid, with many memo gaps, shared values and numpy objects.
//!
//! A model of the stack and the memo predicts what an opcode finds, so that most programs run. The model
//! may be inexact, because only the results of the two readers are compared.

use std::collections::{BTreeMap, BTreeSet};

use sage_core::seed::Rng;

/// A program and its contents.
pub struct Program {
    pub bytes: Vec<u8>,
    /// Its opcodes; empty if bytes were changed afterwards.
    pub opcodes: BTreeSet<u8>,
    /// Whether a MEMOIZE follows a gap in the memo.
    pub memoizes_after_gap: bool,
}

/// Opcodes that the reader knows, `BUILD` to `SETITEMS`, as in `src/pickle/opcode.rs`.
pub const OPCODES: &[u8] = b"(.012GJKMNRTUXabcehj]qrst)u}\
    \x80\x81\x85\x86\x87\x88\x89\x8a\x8bBC\x8c\x8d\x8e\x8f\x90\x91\x93\x94\x95\x96";

/// The model's kind of a value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Key,
    Str,
    Bytes,
    Other,
    List,
    Dict,
    Set,
    Reconstruct,
    FromBuffer,
    ScalarType,
    NdArray,
    DtypeType,
    Encode,
    DefaultDictType,
    SetType,
    Int,
}

impl Kind {
    fn is_plain(self) -> bool {
        matches!(
            self,
            Self::Key | Self::Str | Self::Bytes | Self::Other | Self::List | Self::Dict | Self::Set
        )
    }
}

/// A value of the model: its kind, and its number of values without sharing.
#[derive(Clone, Copy)]
pub(super) struct Value {
    pub(super) kind: Kind,
    pub(super) size: usize,
}

/// Largest value, in number of parts: shared values grow with every opcode.
pub(super) const LARGEST: usize = 300;

pub(super) struct Writer {
    pub(super) rng: Rng,
    pub(super) out: Vec<u8>,
    pub(super) opcodes: BTreeSet<u8>,
    pub(super) stack: Vec<Value>,
    pub(super) marks: Vec<usize>,
    pub(super) memo: BTreeMap<u32, Value>,
    pub(super) memoizes_after_gap: bool,
    pub(super) protocol: u8,
}

/// The program of a number.
pub fn program(number: u64) -> Program {
    let rng = Rng::new(number, "pickle program", "differential");
    let mut w = Writer {
        rng,
        out: Vec::new(),
        opcodes: BTreeSet::new(),
        stack: Vec::new(),
        marks: Vec::new(),
        memo: BTreeMap::new(),
        memoizes_after_gap: false,
        protocol: 2,
    };
    w.protocol += w.rng.below(4) as u8;
    w.op(0x80);
    w.out.push(w.protocol);
    let framed = w.rng.below(4) == 0;
    if framed {
        w.op(0x95);
        w.out.extend([0; 8]);
    }
    let start = w.out.len();
    for _ in 0..2 + w.rng.below(24) {
        w.step();
    }
    w.end();
    if framed {
        let length = (w.out.len() - start) as u64;
        // Some frames declare more bytes than there are.
        let length = if w.rng.below(8) == 0 { length + 1 } else { w.rng.below(length as usize + 1) as u64 };
        w.out[start - 8..start].copy_from_slice(&length.to_le_bytes());
    }
    if w.rng.below(6) == 0 {
        for _ in 0..1 + w.rng.below(3) {
            let at = w.rng.below(w.out.len());
            w.out[at] = match w.rng.below(3) {
                0 => OPCODES[w.rng.below(OPCODES.len())],
                1 => w.out[at] ^ (1 << w.rng.below(8)),
                _ => w.rng.below(8) as u8,
            };
        }
        w.opcodes.clear();
        w.memoizes_after_gap = false;
    }
    Program { bytes: w.out, opcodes: w.opcodes, memoizes_after_gap: w.memoizes_after_gap }
}

impl Writer {
    pub(super) fn op(&mut self, code: u8) {
        self.out.push(code);
        self.opcodes.insert(code);
    }

    pub(super) fn push(&mut self, kind: Kind, size: usize) {
        self.stack.push(Value { kind, size });
    }

    fn floor(&self) -> usize {
        self.marks.last().copied().unwrap_or(0)
    }

    /// Values above the last mark.
    pub(super) fn open(&self) -> &[Value] {
        &self.stack[self.floor()..]
    }

    fn step(&mut self) {
        match self.rng.below(30) {
            0..8 => self.literal(),
            8..10 => self.empty_container(),
            10..12 => {
                self.op(b'(');
                self.marks.push(self.stack.len());
            }
            12..15 => self.close(),
            15 => self.few(),
            16 | 17 => self.add_one(),
            18..22 => self.store(),
            22..24 => self.recall(),
            24 => self.drop_or_double(),
            25 | 26 => self.numpy(),
            27 => self.call(),
            29 => self.vector(),
            28 if self.rng.below(3) == 0 => {
                let code = OPCODES[self.rng.below(OPCODES.len())];
                self.op(code);
            }
            _ => self.literal(),
        }
    }

    pub(super) fn key_text(&mut self) -> Vec<u8> {
        let length = 1 + self.rng.below(3);
        (0..length).map(|_| b'a' + self.rng.below(26) as u8).collect()
    }

    pub(super) fn literal(&mut self) {
        let mut kind = Kind::Key;
        match self.rng.below(18) {
            0 => self.op(b'N'),
            1 => self.op(0x88),
            2 => self.op(0x89),
            3 => {
                self.op(b'G');
                let x = [0.0, -0.0, 1.0, 1.5, -2.25e300, f64::NAN, f64::INFINITY, 255.0][self.rng.below(8)];
                self.out.extend(x.to_be_bytes());
            }
            4 => {
                self.op(b'J');
                let x = self.rng.bits() as u32;
                self.out.extend(x.to_le_bytes());
            }
            5 => {
                self.op(b'K');
                let x = self.rng.bits() as u8;
                self.out.push(x);
            }
            6 => {
                self.op(b'M');
                let x = self.rng.bits() as u16;
                self.out.extend(x.to_le_bytes());
            }
            7 | 8 => {
                let length = self.rng.below(12);
                if self.rng.below(2) == 0 {
                    self.op(0x8a);
                    self.out.push(length as u8);
                } else {
                    self.op(0x8b);
                    self.out.extend((length as u32).to_le_bytes());
                }
                // Bytes that make long encodings of short numbers.
                let fill = [0, 0xff, 0x80, self.rng.bits() as u8][self.rng.below(4)];
                for _ in 0..length {
                    let x = if self.rng.below(3) == 0 { self.rng.bits() as u8 } else { fill };
                    self.out.push(x);
                }
            }
            9 | 10 => {
                let raw = self.key_text();
                let (code, width) = [(b'C', 1), (b'B', 4), (0x8e, 8), (0x96, 8)][self.rng.below(4)];
                self.counted(code, width, &raw);
                kind = if code == 0x96 { Kind::Other } else { Kind::Bytes };
            }
            11 => {
                let mut raw = self.key_text();
                if self.rng.below(8) == 0 {
                    raw.push(0xe9);
                }
                let (code, width) = [(b'U', 1), (b'T', 4)][self.rng.below(2)];
                self.counted(code, width, &raw);
                kind = Kind::Str;
            }
            _ => {
                let mut raw = self.key_text();
                match self.rng.below(16) {
                    0 => raw.extend("é".bytes()),
                    1 => raw.extend([0xed, 0xa0, 0x80]),
                    2 => raw.push(0),
                    _ => {}
                }
                let (code, width) = [(0x8c, 1), (b'X', 4), (0x8d, 8)][self.rng.below(3)];
                self.counted(code, width, &raw);
                kind = Kind::Str;
            }
        }
        self.push(kind, 1);
    }

    pub(super) fn counted(&mut self, code: u8, width: usize, raw: &[u8]) {
        self.op(code);
        self.out.extend(&(raw.len() as u64).to_le_bytes()[..width]);
        self.out.extend(raw);
    }

    pub(super) fn word(&mut self, text: &str) {
        self.counted(0x8c, 1, text.as_bytes());
    }

    fn empty_container(&mut self) {
        let (code, kind) =
            [(b']', Kind::List), (b')', Kind::Key), (b'}', Kind::Dict), (0x8f, Kind::Set)][self.rng.below(4)];
        self.op(code);
        self.push(kind, 1);
    }

    /// Closes the values above the last mark, with one of the opcodes that they allow.
    fn close(&mut self) {
        let Some(&mark) = self.marks.last() else { return };
        let items = self.open().to_vec();
        let size = 1 + items.iter().map(|v| v.size).sum::<usize>();
        let below =
            mark.checked_sub(1).filter(|b| *b >= self.marks.iter().rev().nth(1).copied().unwrap_or(0));
        let below = below.map(|b| self.stack[b].kind);
        let plain = items.iter().all(|v| v.kind.is_plain());
        let is_key = |v: &Value| matches!(v.kind, Kind::Key | Kind::Str | Kind::Bytes);
        let (keys, pairs) =
            (items.iter().all(is_key), items.len().is_multiple_of(2) && items.iter().step_by(2).all(is_key));
        let mut options: Vec<(u8, Option<Kind>)> = vec![(b'1', None)];
        if plain && size < LARGEST {
            options.push((b't', Some(if keys { Kind::Key } else { Kind::Other })));
            if keys {
                options.push((0x91, Some(Kind::Key)));
            }
            match below {
                Some(Kind::List) => options.extend([(b'e', None); 3]),
                Some(Kind::Dict) if pairs => options.extend([(b'u', None); 3]),
                Some(Kind::Set) if keys => options.extend([(0x90, None); 3]),
                _ => {}
            }
        }
        let (code, result) = options[self.rng.below(options.len())];
        self.op(code);
        self.marks.pop();
        self.stack.truncate(mark);
        match result {
            Some(kind) => self.push(kind, size),
            None if code != b'1' => self.grow_top(size),
            None => {}
        }
    }

    fn grow_top(&mut self, size: usize) {
        if let Some(top) = self.stack.last_mut() {
            top.size += size;
        }
    }

    /// TUPLE1 to TUPLE3.
    fn few(&mut self) {
        let n = 1 + self.rng.below(3);
        let open = self.open();
        if open.len() < n {
            return self.literal();
        }
        let items = &open[open.len() - n..];
        let size = 1 + items.iter().map(|v| v.size).sum::<usize>();
        if size > LARGEST || !items.iter().all(|v| v.kind.is_plain()) {
            return;
        }
        let keys = items.iter().all(|v| matches!(v.kind, Kind::Key | Kind::Str | Kind::Bytes));
        self.op(0x84 + n as u8);
        self.stack.truncate(self.stack.len() - n);
        self.push(if keys { Kind::Key } else { Kind::Other }, size);
    }

    /// APPEND or SETITEM with new literals, if the top takes them.
    fn add_one(&mut self) {
        match self.open().last().map(|v| v.kind) {
            Some(Kind::List) => {
                self.literal();
                self.maybe_store();
                self.op(b'a');
                self.stack.pop();
                self.grow_top(1);
            }
            Some(Kind::Dict) => {
                self.literal();
                self.maybe_store();
                self.literal();
                self.op(b's');
                self.stack.truncate(self.stack.len() - 2);
                self.grow_top(2);
            }
            _ => self.empty_container(),
        }
    }

    fn drop_or_double(&mut self) {
        let top = self.open().last().copied();
        match top {
            Some(top) if self.rng.below(2) == 0 && top.size < LARGEST / 4 => {
                self.op(b'2');
                self.stack.push(top);
            }
            Some(_) => {
                self.op(b'0');
                self.stack.pop();
            }
            None if !self.marks.is_empty() => {
                self.op(b'0');
                self.marks.pop();
            }
            None => {}
        }
    }

    /// Reduces the stack to one value, and ends with STOP.
    fn end(&mut self) {
        while !self.marks.is_empty() {
            self.close();
        }
        while self.stack.last().is_some_and(|top| !top.kind.is_plain()) {
            self.op(b'0');
            self.stack.pop();
        }
        if self.stack.is_empty() {
            self.literal();
        }
        if self.rng.below(40) == 0 {
            self.op(b'(');
        }
        self.op(b'.');
        if self.rng.below(10) == 0 {
            self.out.extend(b"what follows is not read");
        }
    }
}
