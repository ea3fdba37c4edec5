//! The interpreter of opcodes.
//!
//! It is a loop over the bytes with a stack of ids, without recursion on the input or calls of globals.
//! Every opcode takes at least one byte and creates at most one value. Values, stack, marks and memo have
//! their own limits. Lengths are checked against the rest of the file before memory is reserved.
//!
//! Stack, marks, memo and opcodes behave as in CPython's C unpickler (`Modules/_pickle.c`). An accepted pickle has the value
//! that Python reads; where Python is more lenient, the file is refused. A reader that reads other values than Python can be
//! bypassed. A differential test compares them.

use std::collections::HashSet;

use super::{
    Document, Global, Id, LEAST_NODES, MAX_MARKS, MAX_NODES, Node, PickleError, PickleProblem as Problem,
    Span, opcode as op, walk::begins_value,
};

/// Values that every document starts with, so that common ones need no memory.
pub(super) const NONE: Id = Id(0);
pub(super) const FALSE: Id = Id(1);
pub(super) const TRUE: Id = Id(2);
/// No entry in the memo.
const EMPTY: Id = Id(u32::MAX);

impl Document {
    /// Interprets a pickle. The document stores the bytes.
    ///
    /// *Errors*: a [`PickleError`] for anything but plain values within the limits.
    pub fn parse(bytes: Vec<u8>) -> Result<Self, PickleError> {
        let mut machine = Machine {
            at: 0,
            end: bytes.len(),
            size: bytes.len(),
            nodes: Vec::with_capacity((bytes.len() / 32).min(1 << 16)),
            limit: (bytes.len() / 2).clamp(LEAST_NODES, MAX_NODES),
            document: bytes,
            stack: Vec::with_capacity(256),
            marks: Vec::new(),
            memo: Vec::new(),
            memo_entries: 0,
            protocol: 0,
            hashable_tuples: HashSet::new(),
            unbuilt_lanes: HashSet::new(),
            copied: 0,
        };
        machine.nodes.extend([Node::None, Node::Bool(false), Node::Bool(true)]);
        let mut opcode_at = 0;
        let root = machine.run(&mut opcode_at).map_err(|kind| PickleError { offset: opcode_at, kind })?;
        let document = Self { bytes: machine.document, nodes: machine.nodes, root, file_size: machine.size };
        let checked = document.check_nesting().and_then(|keyed| document.check_keys(&keyed));
        checked.map_err(|kind| PickleError { offset: opcode_at, kind })?;
        Ok(document)
    }
}

pub(super) struct Machine {
    /// The file, followed by the bytes that `_codecs.encode` produced.
    pub(super) document: Vec<u8>,
    pub(super) size: usize,
    pub(super) at: usize,
    /// End of the frame, or of the file between frames.
    pub(super) end: usize,
    pub(super) nodes: Vec<Node>,
    /// Limit of values, stack entries and memo entries.
    pub(super) limit: usize,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: Vec<Id>,
    /// Number of memo entries in use. MEMOIZE stores at this index, even if there are gaps.
    memo_entries: usize,
    /// Protocol of the last PROTO.
    pub(super) protocol: u8,
    /// Tuples that were used as keys, and the tuples in them.
    pub(super) hashable_tuples: HashSet<Id>,
    /// Lanes of MetaDrive whose attributes are still to come.
    pub(super) unbuilt_lanes: HashSet<Id>,
    /// Number of bytes copied from shared values so far.
    pub(super) copied: usize,
}

impl Machine {
    fn run(&mut self, opcode_at: &mut usize) -> Result<Id, Problem> {
        let first = *self.document.first().ok_or(Problem::EmptyFile)?;
        if first != op::PROTO {
            return Err(if begins_value(first) {
                Problem::OldProtocol
            } else {
                Problem::NotAPickle { first }
            });
        }
        loop {
            *opcode_at = self.at;
            let code = self.byte()?;
            match code {
                op::PROTO => {
                    self.protocol = match self.byte()? {
                        0 | 1 => return Err(Problem::OldProtocol),
                        protocol @ 2..=5 => protocol,
                        protocol => return Err(Problem::Protocol(protocol)),
                    };
                }
                op::FRAME => {
                    let needed = self.length::<8>()?;
                    let left = self.size - self.at;
                    if needed > left as u64 {
                        return Err(Problem::Truncated { needed, left });
                    }
                    if self.at < self.end && self.end < self.size {
                        return Err(Problem::Frame);
                    }
                    self.end = self.at + needed as usize;
                }
                op::STOP => return self.pop(code).map_err(|_| Problem::Empty),
                op::MARK if self.marks.len() == MAX_MARKS => return Err(Problem::Depth),
                op::MARK => self.marks.push(self.stack.len()),
                op::POP => {
                    // As in Python: if nothing is above the mark, the mark is removed.
                    if self.marks.last() == Some(&self.stack.len()) {
                        self.marks.pop();
                    } else {
                        self.pop(code)?;
                    }
                }
                op::POP_MARK => {
                    let mark = self.mark(code)?;
                    self.stack.truncate(mark);
                }
                op::DUP => {
                    let top = self.top(code)?;
                    self.push_id(top)?;
                }
                op::NONE => self.push_id(NONE)?,
                op::NEWTRUE => self.push_id(TRUE)?,
                op::NEWFALSE => self.push_id(FALSE)?,
                op::BININT => {
                    let raw = self.array::<4>()?;
                    self.push(Node::Int(i64::from(i32::from_le_bytes(raw))))?;
                }
                op::BININT1 => {
                    let x = self.byte()?;
                    self.push(Node::Int(i64::from(x)))?;
                }
                op::BININT2 => {
                    let raw = self.array::<2>()?;
                    self.push(Node::Int(i64::from(u16::from_le_bytes(raw))))?;
                }
                op::LONG1 => {
                    let n = u64::from(self.byte()?);
                    self.long(n)?;
                }
                op::LONG4 => {
                    let n = self.length::<4>()?;
                    self.long(n)?;
                }
                op::BINFLOAT => {
                    let raw = self.array::<8>()?;
                    self.push(Node::Float(f64::from_be_bytes(raw)))?;
                }
                op::SHORT_BINUNICODE => {
                    let n = u64::from(self.byte()?);
                    self.text(n)?;
                }
                op::BINUNICODE => {
                    let n = self.length::<4>()?;
                    self.text(n)?;
                }
                op::BINUNICODE8 => {
                    let n = self.length::<8>()?;
                    self.text(n)?;
                }
                op::SHORT_BINBYTES => {
                    let n = u64::from(self.byte()?);
                    let span = self.span(n)?;
                    self.push(Node::Bytes(span))?;
                }
                op::BINBYTES | op::BINBYTES8 | op::BYTEARRAY8 => {
                    let n = if code == op::BINBYTES { self.length::<4>()? } else { self.length::<8>()? };
                    let span = self.span(n)?;
                    self.push(if code == op::BYTEARRAY8 {
                        Node::ByteArray(span)
                    } else {
                        Node::Bytes(span)
                    })?;
                }
                op::SHORT_BINSTRING | op::BINSTRING => {
                    // Python 2's str: Python 3 reads it as text if it is ASCII, and refuses it otherwise.
                    let n = if code == op::BINSTRING { self.length::<4>()? } else { u64::from(self.byte()?) };
                    let span = self.span(n)?;
                    if !self.slice(span).is_ascii() {
                        return Err(Problem::NotAscii);
                    }
                    self.push(Node::Str(span))?;
                }
                op::EMPTY_LIST => self.push(Node::List(Vec::new()))?,
                op::EMPTY_TUPLE => self.push(Node::Tuple(Vec::new()))?,
                op::EMPTY_DICT => self.push(Node::Dict(Vec::new()))?,
                op::EMPTY_SET => self.push(Node::Set(Vec::new()))?,
                op::TUPLE1 | op::TUPLE2 | op::TUPLE3 => {
                    let start = self.stack.len().checked_sub(usize::from(code - op::TUPLE1) + 1);
                    let start =
                        start.filter(|s| *s >= self.floor()).ok_or_else(|| Problem::Stack(op::name(code)))?;
                    let items = self.stack.split_off(start);
                    self.push(Node::Tuple(items))?;
                }
                op::TUPLE | op::FROZENSET => {
                    let mark = self.mark(code)?;
                    let items = self.stack.split_off(mark);
                    if code == op::TUPLE {
                        self.push(Node::Tuple(items))?;
                    } else {
                        self.check_hashable(&items)?;
                        self.push(Node::FrozenSet(items))?;
                    }
                }
                op::APPEND => {
                    let item = self.pop(code)?;
                    let list = self.top(code)?;
                    self.list(list)?.push(item);
                }
                op::APPENDS => {
                    let mark = self.mark(code)?;
                    let list = self.below(mark, code)?;
                    let items = self.stack.split_off(mark);
                    self.list(list)?.extend(items);
                }
                op::ADDITEMS => {
                    let mark = self.mark(code)?;
                    let set = self.below(mark, code)?;
                    let items = self.stack.split_off(mark);
                    self.check_hashable(&items)?;
                    match &mut self.nodes[set.0 as usize] {
                        Node::Set(held) => held.extend(items),
                        other => return Err(kind("the target of ADDITEMS", other, "a set")),
                    }
                }
                op::SETITEM => {
                    let mark = self.stack.len().checked_sub(2).filter(|m| *m >= self.floor());
                    let mark = mark.ok_or_else(|| Problem::Stack(op::name(code)))?;
                    let dict = self.below(mark, code)?;
                    self.insert_pairs(code, mark, dict)?;
                }
                op::SETITEMS => {
                    let mark = self.mark(code)?;
                    let dict = self.below(mark, code)?;
                    self.insert_pairs(code, mark, dict)?;
                }
                op::MEMOIZE => self.memoize(code, self.memo_entries as u64)?,
                op::BINPUT | op::LONG_BINPUT => {
                    let k = if code == op::BINPUT { u64::from(self.byte()?) } else { self.length::<4>()? };
                    self.memoize(code, k)?;
                }
                op::BINGET | op::LONG_BINGET => {
                    let k = if code == op::BINGET { u64::from(self.byte()?) } else { self.length::<4>()? };
                    self.recall(k)?;
                }
                op::GLOBAL => {
                    let module = self.line()?;
                    let name = self.line()?;
                    self.global(module, name)?;
                }
                op::STACK_GLOBAL => {
                    let (name, module) = (self.pop(code)?, self.pop(code)?);
                    match (&self.nodes[module.0 as usize], &self.nodes[name.0 as usize]) {
                        (Node::Str(module), Node::Str(name)) => self.global(*module, *name)?,
                        (other, Node::Str(_)) | (_, other) => {
                            return Err(kind("the name of a global", other, "a str"));
                        }
                    }
                }
                op::NEWOBJ => {
                    let (arguments, class) = (self.pop(code)?, self.pop(code)?);
                    self.new_object(class, arguments)?;
                }
                op::REDUCE => {
                    let (arguments, function) = (self.pop(code)?, self.pop(code)?);
                    self.reduce(function, arguments)?;
                }
                op::BUILD => {
                    let state = self.pop(code)?;
                    let target = self.top(code)?;
                    self.build(target, state)?;
                }
                _ => return Err(Problem::Opcode { code, name: op::name(code) }),
            }
        }
    }

    /// Lowest stack index that the current mark leaves accessible.
    fn floor(&self) -> usize {
        self.marks.last().copied().unwrap_or(0)
    }

    #[inline]
    pub(super) fn push(&mut self, node: Node) -> Result<(), Problem> {
        if self.nodes.len() >= self.limit {
            return Err(Problem::TooMuch(self.limit));
        }
        let id = Id(self.nodes.len() as u32);
        self.nodes.push(node);
        self.push_id(id)
    }

    #[inline]
    pub(super) fn push_id(&mut self, id: Id) -> Result<(), Problem> {
        if self.stack.len() >= self.limit {
            return Err(Problem::TooMuch(self.limit));
        }
        self.stack.push(id);
        Ok(())
    }

    fn pop(&mut self, code: u8) -> Result<Id, Problem> {
        if self.stack.len() <= self.floor() {
            return Err(Problem::Stack(op::name(code)));
        }
        self.stack.pop().ok_or_else(|| Problem::Stack(op::name(code)))
    }

    fn top(&self, code: u8) -> Result<Id, Problem> {
        let open = self.stack.len() > self.floor();
        self.stack.last().copied().filter(|_| open).ok_or_else(|| Problem::Stack(op::name(code)))
    }

    fn mark(&mut self, code: u8) -> Result<usize, Problem> {
        self.marks.pop().ok_or_else(|| Problem::Stack(op::name(code)))
    }

    /// The value just below a stack index.
    fn below(&self, index: usize, code: u8) -> Result<Id, Problem> {
        let under = index.checked_sub(1).filter(|p| *p >= self.floor());
        under.map(|p| self.stack[p]).ok_or_else(|| Problem::Stack(op::name(code)))
    }

    fn list(&mut self, id: Id) -> Result<&mut Vec<Id>, Problem> {
        match &mut self.nodes[id.0 as usize] {
            Node::List(items) => Ok(items),
            other => Err(kind("the target of APPEND", other, "a list")),
        }
    }

    /// Stores the top of the stack in a memo entry, replacing its value.
    #[inline(always)] // Inlining saves a twentieth of the reading time.
    pub(super) fn memoize(&mut self, code: u8, entry: u64) -> Result<(), Problem> {
        let top = self.top(code)?;
        // Picklers number the stored values consecutively.
        let index = usize::try_from(entry).ok().filter(|k| *k < self.limit).ok_or(Problem::Memo(entry))?;
        if index == self.memo.len() {
            self.memo.push(EMPTY);
        } else if index > self.memo.len() {
            self.memo.resize(index + 1, EMPTY);
        }
        let before = std::mem::replace(&mut self.memo[index], top);
        self.memo_entries += usize::from(before == EMPTY);
        Ok(())
    }

    /// Pushes the value of a memo entry.
    #[inline]
    pub(super) fn recall(&mut self, entry: u64) -> Result<(), Problem> {
        let found = usize::try_from(entry).ok().and_then(|k| self.memo.get(k)).copied();
        let id = found.filter(|id| *id != EMPTY).ok_or(Problem::Memo(entry))?;
        self.push_id(id)
    }

    fn insert_pairs(&mut self, code: u8, mark: usize, dict: Id) -> Result<(), Problem> {
        if !(self.stack.len() - mark).is_multiple_of(2) {
            return Err(Problem::Stack(op::name(code)));
        }
        let is_plain = |id: &Id| matches!(self.nodes[id.0 as usize], Node::Str(_));
        if !self.stack[mark..].iter().step_by(2).all(is_plain) {
            let keys: Vec<Id> = self.stack[mark..].iter().step_by(2).copied().collect();
            self.check_hashable(&keys)?;
        }
        match &mut self.nodes[dict.0 as usize] {
            Node::Dict(held) | Node::DefaultDict { entries: held, .. } => {
                held.extend(self.stack[mark..].chunks_exact(2).map(|pair| (pair[0], pair[1])));
            }
            other => return Err(kind("the target of SETITEM", other, "a dict")),
        }
        self.stack.truncate(mark);
        Ok(())
    }

    fn long(&mut self, n: u64) -> Result<(), Problem> {
        let span = self.span(n)?;
        let raw = self.slice(span);
        let negative = raw.last().is_some_and(|b| b & 0x80 != 0);
        let fill = if negative { 0xff } else { 0 };
        let in_use = raw.iter().rposition(|b| *b != fill).map_or(0, |last| last + 1);
        // The highest bit in use must still represent the sign.
        if in_use > 8 || (in_use == 8 && (raw[7] & 0x80 != 0) != negative) {
            return self.push(Node::BigInt(span));
        }
        let mut le = [fill; 8];
        le[..in_use].copy_from_slice(&raw[..in_use]);
        self.push(Node::Int(i64::from_le_bytes(le)))
    }

    fn text(&mut self, n: u64) -> Result<(), Problem> {
        let span = self.span(n)?;
        // Names are short and ASCII, which this test finds without a function call.
        let raw = self.slice(span);
        let is_plain = raw.len() <= 32 && raw.iter().fold(0, |all, byte| all | byte) < 0x80;
        if !is_plain && std::str::from_utf8(raw).is_err() {
            return Err(Problem::Text);
        }
        self.push(Node::Str(span))
    }

    fn global(&mut self, module: Span, name: Span) -> Result<(), Problem> {
        let (module, name) = (self.slice(module), self.slice(name));
        match Global::from_name(module, name, self.protocol) {
            Some(global) => self.push(Node::Global(global)),
            None => {
                let shown = |raw: &[u8]| raw[..raw.len().min(60)].escape_ascii().to_string();
                Err(Problem::Global(format!("{}.{}", shown(module), shown(name))))
            }
        }
    }
}

pub(super) fn kind(what: &'static str, found: &Node, expected: &'static str) -> Problem {
    Problem::Kind { what, found: found.kind(), expected }
}
