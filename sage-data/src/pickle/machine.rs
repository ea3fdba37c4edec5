//! The interpreter of opcodes.
//!
//! It is a loop over the bytes with a stack of ids: no recursion on the input, no call of anything
//! the file names. Every opcode takes at least one byte and makes at most one value, so memory is
//! bounded by the file's size; lengths are checked against what is left of the file before
//! anything is reserved.

use super::{
    Array, Document, Dtype, Id, MAX_DEPTH, MAX_NODES, Node, PickleError, PickleProblem as Problem, Span,
    opcode as op,
};

/// Globals that scene files use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Global {
    /// `numpy.core.multiarray._reconstruct` and its `_core` twin.
    Reconstruct,
    /// `numpy.core.numeric._frombuffer` and its `_core` twin (protocol 5).
    FromBuffer,
    /// `numpy.core.multiarray.scalar` and its `_core` twin.
    Scalar,
    /// `numpy.ndarray`.
    NdArray,
    /// `numpy.dtype`.
    Dtype,
    /// `_codecs.encode`: how protocol 2 writes bytes.
    Encode,
    /// `collections.defaultdict`.
    DefaultDict,
    /// `builtins.int`, a defaultdict's factory.
    Int,
    /// `builtins.set`.
    Set,
    /// `__builtin__.bytes`, called with nothing: how protocol 2 writes empty bytes.
    Bytes,
}

impl Global {
    fn from_name(module: &[u8], name: &[u8]) -> Option<Self> {
        Some(match (module, name) {
            (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"_reconstruct") => Self::Reconstruct,
            (b"numpy.core.numeric" | b"numpy._core.numeric", b"_frombuffer") => Self::FromBuffer,
            (b"numpy.core.multiarray" | b"numpy._core.multiarray", b"scalar") => Self::Scalar,
            (b"numpy", b"ndarray") => Self::NdArray,
            (b"numpy", b"dtype") => Self::Dtype,
            (b"_codecs", b"encode") => Self::Encode,
            (b"collections", b"defaultdict") => Self::DefaultDict,
            // Python 3 writes `int` under Python 2's name `long` in protocol 2.
            (b"builtins" | b"__builtin__", b"int") | (b"__builtin__", b"long") => Self::Int,
            (b"builtins" | b"__builtin__", b"set") => Self::Set,
            (b"__builtin__", b"bytes") => Self::Bytes,
            _ => return None,
        })
    }
}

/// Values that every document starts with, so that common ones cost nothing.
const NONE: Id = Id(0);
const FALSE: Id = Id(1);
const TRUE: Id = Id(2);
/// No entry in the memo.
const EMPTY: Id = Id(u32::MAX);

impl Document {
    /// Interprets a pickle. The document keeps the bytes.
    ///
    /// *Errors*: a [`PickleError`] for anything but plain values within the limits.
    pub fn parse(bytes: Vec<u8>) -> Result<Self, PickleError> {
        let mut machine = Machine {
            at: 0,
            size: bytes.len(),
            nodes: Vec::with_capacity((bytes.len() / 32).min(1 << 16)),
            document: bytes,
            stack: Vec::with_capacity(256),
            marks: Vec::new(),
            memo: Vec::new(),
            copied: 0,
        };
        machine.nodes.extend([Node::None, Node::Bool(false), Node::Bool(true)]);
        let mut opcode_at = 0;
        let root = machine.run(&mut opcode_at).map_err(|kind| PickleError { offset: opcode_at, kind })?;
        let document = Self { bytes: machine.document, nodes: machine.nodes, root, file_size: machine.size };
        document.check_nesting().map_err(|kind| PickleError { offset: opcode_at, kind })?;
        Ok(document)
    }

    /// Refuses cycles, deep nesting and arrays without state among the reachable values.
    fn check_nesting(&self) -> Result<(), Problem> {
        /// What is known of a value.
        #[derive(Clone, Copy, PartialEq)]
        enum State {
            New,
            Open,
            /// Finished; containers below it, itself included.
            Depth(u8),
        }
        let mut states = vec![State::New; self.nodes.len()];
        // Children come off a copy of the id list position by position, so no recursion.
        let child = |id: Id, k: usize| -> Option<Id> {
            match self.node(id) {
                Node::List(v) | Node::Tuple(v) | Node::Set(v) | Node::FrozenSet(v) => v.get(k).copied(),
                Node::Dict(v) | Node::DefaultDict { entries: v, .. } => {
                    v.get(k / 2).map(|pair| if k.is_multiple_of(2) { pair.0 } else { pair.1 })
                }
                _ => None,
            }
        };
        let mut path: Vec<(Id, usize, u8)> = Vec::with_capacity(MAX_DEPTH);
        let mut next = Some(self.root);
        loop {
            if let Some(id) = next.take() {
                let deepest = |path: &mut Vec<(Id, usize, u8)>, depth: u8| {
                    if let Some(top) = path.last_mut() {
                        top.2 = top.2.max(depth);
                    }
                };
                match states[id.0 as usize] {
                    State::Open => return Err(Problem::Cycle),
                    State::Depth(depth) => {
                        deepest(&mut path, depth);
                        if path.len() + usize::from(depth) > MAX_DEPTH {
                            return Err(Problem::Depth);
                        }
                    }
                    State::New => match self.node(id) {
                        Node::List(_)
                        | Node::Tuple(_)
                        | Node::Set(_)
                        | Node::FrozenSet(_)
                        | Node::Dict(_)
                        | Node::DefaultDict { .. } => {
                            if path.len() == MAX_DEPTH {
                                return Err(Problem::Depth);
                            }
                            states[id.0 as usize] = State::Open;
                            path.push((id, 0, 0));
                        }
                        Node::Unbuilt => {
                            return Err(Problem::Kind {
                                what: "a value",
                                found: "an array without state",
                                expected: "a finished array",
                            });
                        }
                        Node::Global(_) => {
                            return Err(Problem::Kind {
                                what: "a value",
                                found: "a function or class",
                                expected: "plain data",
                            });
                        }
                        _ => states[id.0 as usize] = State::Depth(0),
                    },
                }
            }
            let Some(top) = path.last_mut() else { return Ok(()) };
            match child(top.0, top.1) {
                Some(id) => {
                    top.1 += 1;
                    next = Some(id);
                }
                None => {
                    let (id, _, below) = *top;
                    states[id.0 as usize] = State::Depth(below + 1);
                    path.pop();
                    if let Some(parent) = path.last_mut() {
                        parent.2 = parent.2.max(below + 1);
                    }
                }
            }
        }
    }
}

struct Machine {
    /// The file, followed by bytes that `_codecs.encode` decoded.
    document: Vec<u8>,
    size: usize,
    at: usize,
    nodes: Vec<Node>,
    stack: Vec<Id>,
    marks: Vec<usize>,
    memo: Vec<Id>,
    /// Bytes copied out of shared values so far.
    copied: usize,
}

impl Machine {
    fn run(&mut self, opcode_at: &mut usize) -> Result<Id, Problem> {
        let first = self.document.first().copied().unwrap_or(0);
        if first != op::PROTO {
            return Err(Problem::NotAPickle { first });
        }
        loop {
            *opcode_at = self.at;
            let code = self.byte()?;
            match code {
                op::PROTO => {
                    let protocol = self.byte()?;
                    if !(2..=5).contains(&protocol) {
                        return Err(Problem::Protocol(protocol));
                    }
                }
                // Frames only group bytes; what they hold is checked opcode by opcode.
                op::FRAME => {
                    self.take(8)?;
                }
                op::STOP => return self.stack.pop().ok_or(Problem::Empty),
                op::MARK => self.marks.push(self.stack.len()),
                op::POP => {
                    // As in Python: with nothing above the mark, the mark itself goes.
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
                    self.stack.push(top);
                }
                op::NONE => self.stack.push(NONE),
                op::NEWTRUE => self.stack.push(TRUE),
                op::NEWFALSE => self.stack.push(FALSE),
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
                    // Python 2's str: text if it is ASCII, bytes otherwise.
                    let n = if code == op::BINSTRING { self.length::<4>()? } else { u64::from(self.byte()?) };
                    let span = self.span(n)?;
                    let ascii = self.slice(span).is_ascii();
                    self.push(if ascii { Node::Str(span) } else { Node::Bytes(span) })?;
                }
                op::EMPTY_LIST => self.push(Node::List(Vec::new()))?,
                op::EMPTY_TUPLE => self.push(Node::Tuple(Vec::new()))?,
                op::EMPTY_DICT => self.push(Node::Dict(Vec::new()))?,
                op::EMPTY_SET => self.push(Node::Set(Vec::new()))?,
                op::TUPLE1 | op::TUPLE2 | op::TUPLE3 => {
                    let start = self.stack.len().checked_sub(usize::from(code - op::TUPLE1) + 1);
                    let start = start.filter(|s| *s >= self.floor()).ok_or(Problem::Stack(op::name(code)))?;
                    let items = self.stack.split_off(start);
                    self.push(Node::Tuple(items))?;
                }
                op::TUPLE | op::LIST | op::FROZENSET => {
                    let mark = self.mark(code)?;
                    let items = self.stack.split_off(mark);
                    self.push(match code {
                        op::TUPLE => Node::Tuple(items),
                        op::LIST => Node::List(items),
                        _ => {
                            self.check_keys(items.iter())?;
                            Node::FrozenSet(items)
                        }
                    })?;
                }
                op::DICT => {
                    let mark = self.mark(code)?;
                    self.push(Node::Dict(Vec::new()))?;
                    let dict = self.pop(code)?;
                    self.insert_pairs(code, mark, dict)?;
                    self.stack.push(dict);
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
                    self.check_keys(items.iter())?;
                    match &mut self.nodes[set.0 as usize] {
                        Node::Set(held) => held.extend(items),
                        other => return Err(kind("the target of ADDITEMS", other, "a set")),
                    }
                }
                op::SETITEM => {
                    let mark = self.stack.len().checked_sub(2).filter(|m| *m >= self.floor());
                    let mark = mark.ok_or(Problem::Stack(op::name(code)))?;
                    let dict = self.below(mark, code)?;
                    self.insert_pairs(code, mark, dict)?;
                }
                op::SETITEMS => {
                    let mark = self.mark(code)?;
                    let dict = self.below(mark, code)?;
                    self.insert_pairs(code, mark, dict)?;
                }
                op::MEMOIZE => {
                    let top = self.top(code)?;
                    self.memo.push(top);
                }
                op::BINPUT | op::LONG_BINPUT => {
                    let k = if code == op::BINPUT { u64::from(self.byte()?) } else { self.length::<4>()? };
                    // A pickler numbers what it stores, and each value takes a byte.
                    let place =
                        usize::try_from(k).ok().filter(|k| *k <= self.size).ok_or(Problem::Memo(k))?;
                    let top = self.top(code)?;
                    if place >= self.memo.len() {
                        self.memo.resize(place + 1, EMPTY);
                    }
                    self.memo[place] = top;
                }
                op::BINGET | op::LONG_BINGET => {
                    let k = if code == op::BINGET { u64::from(self.byte()?) } else { self.length::<4>()? };
                    let found = usize::try_from(k).ok().and_then(|k| self.memo.get(k)).copied();
                    let id = found.filter(|id| *id != EMPTY).ok_or(Problem::Memo(k))?;
                    self.stack.push(id);
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

    // --- bytes ---

    fn take(&mut self, n: u64) -> Result<usize, Problem> {
        let left = self.size - self.at;
        if n > left as u64 {
            return Err(Problem::Truncated { needed: n, left });
        }
        let start = self.at;
        self.at += n as usize;
        Ok(start)
    }

    #[inline]
    fn byte(&mut self) -> Result<u8, Problem> {
        let start = self.take(1)?;
        Ok(self.document[start])
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N], Problem> {
        let start = self.take(N as u64)?;
        let mut raw = [0; N];
        raw.copy_from_slice(&self.document[start..start + N]);
        Ok(raw)
    }

    fn length<const N: usize>(&mut self) -> Result<u64, Problem> {
        let mut raw = [0; 8];
        raw[..N].copy_from_slice(&self.array::<N>()?);
        Ok(u64::from_le_bytes(raw))
    }

    fn span(&mut self, n: u64) -> Result<Span, Problem> {
        let start = self.take(n)?;
        // Files are below 4 GiB, so both fit.
        Ok(Span { start: start as u32, len: n as u32 })
    }

    fn slice(&self, span: Span) -> &[u8] {
        &self.document[span.start as usize..(span.start + span.len) as usize]
    }

    fn line(&mut self) -> Result<Span, Problem> {
        let rest = &self.document[self.at..self.size];
        let end = rest.iter().position(|b| *b == b'\n');
        let len = end.ok_or(Problem::Truncated { needed: rest.len() as u64 + 1, left: rest.len() })?;
        let start = self.take(len as u64 + 1)?;
        Ok(Span { start: start as u32, len: len as u32 })
    }

    // --- stack ---

    /// Lowest place that the current mark leaves open.
    fn floor(&self) -> usize {
        self.marks.last().copied().unwrap_or(0)
    }

    #[inline]
    fn push(&mut self, node: Node) -> Result<(), Problem> {
        if self.nodes.len() >= MAX_NODES {
            return Err(Problem::TooMuch(MAX_NODES));
        }
        self.stack.push(Id(self.nodes.len() as u32));
        self.nodes.push(node);
        Ok(())
    }

    fn pop(&mut self, code: u8) -> Result<Id, Problem> {
        if self.stack.len() <= self.floor() {
            return Err(Problem::Stack(op::name(code)));
        }
        self.stack.pop().ok_or(Problem::Stack(op::name(code)))
    }

    fn top(&self, code: u8) -> Result<Id, Problem> {
        let open = self.stack.len() > self.floor();
        self.stack.last().copied().filter(|_| open).ok_or(Problem::Stack(op::name(code)))
    }

    fn mark(&mut self, code: u8) -> Result<usize, Problem> {
        self.marks.pop().ok_or(Problem::Stack(op::name(code)))
    }

    /// The value just under a place of the stack.
    fn below(&self, place: usize, code: u8) -> Result<Id, Problem> {
        let under = place.checked_sub(1).filter(|p| *p >= self.floor());
        under.map(|p| self.stack[p]).ok_or(Problem::Stack(op::name(code)))
    }

    fn list(&mut self, id: Id) -> Result<&mut Vec<Id>, Problem> {
        match &mut self.nodes[id.0 as usize] {
            Node::List(items) => Ok(items),
            other => Err(kind("the target of APPEND", other, "a list")),
        }
    }

    fn check_keys<'k>(&self, mut keys: impl Iterator<Item = &'k Id>) -> Result<(), Problem> {
        match keys.find(|id| !self.nodes[id.0 as usize].is_hashable()) {
            Some(id) => Err(kind("a key", &self.nodes[id.0 as usize], "a value that can be a key")),
            None => Ok(()),
        }
    }

    fn insert_pairs(&mut self, code: u8, mark: usize, dict: Id) -> Result<(), Problem> {
        if !(self.stack.len() - mark).is_multiple_of(2) {
            return Err(Problem::Stack(op::name(code)));
        }
        self.check_keys(self.stack[mark..].iter().step_by(2))?;
        match &mut self.nodes[dict.0 as usize] {
            Node::Dict(held) | Node::DefaultDict { entries: held, .. } => {
                held.extend(self.stack[mark..].chunks_exact(2).map(|pair| (pair[0], pair[1])));
            }
            other => return Err(kind("the target of SETITEM", other, "a dict")),
        }
        self.stack.truncate(mark);
        Ok(())
    }

    // --- values ---

    fn long(&mut self, n: u64) -> Result<(), Problem> {
        let span = self.span(n)?;
        let raw = self.slice(span);
        if raw.len() > 8 {
            return self.push(Node::BigInt(span));
        }
        let negative = raw.last().is_some_and(|b| b & 0x80 != 0);
        let mut le = [if negative { 0xff } else { 0 }; 8];
        le[..raw.len()].copy_from_slice(raw);
        self.push(Node::Int(i64::from_le_bytes(le)))
    }

    fn text(&mut self, n: u64) -> Result<(), Problem> {
        let span = self.span(n)?;
        if std::str::from_utf8(self.slice(span)).is_err() {
            return Err(Problem::Text);
        }
        self.push(Node::Str(span))
    }

    fn global(&mut self, module: Span, name: Span) -> Result<(), Problem> {
        let (module, name) = (self.slice(module), self.slice(name));
        match Global::from_name(module, name) {
            Some(global) => self.push(Node::Global(global)),
            None => {
                let shown = |raw: &[u8]| String::from_utf8_lossy(&raw[..raw.len().min(60)]).into_owned();
                Err(Problem::Global(format!("{}.{}", shown(module), shown(name))))
            }
        }
    }

    fn node(&self, id: Id) -> &Node {
        &self.nodes[id.0 as usize]
    }

    fn reduce(&mut self, function: Id, arguments: Id) -> Result<(), Problem> {
        let Node::Global(function) = *self.node(function) else {
            return Err(kind("the function of REDUCE", self.node(function), "a known global"));
        };
        let Node::Tuple(arguments) = self.node(arguments) else {
            return Err(kind("the arguments of REDUCE", self.node(arguments), "a tuple"));
        };
        let arguments: Vec<Id> = arguments.iter().take(5).copied().collect();
        let made = match (function, &arguments[..]) {
            (Global::Reconstruct, [_, _, _]) => Node::Unbuilt,
            (Global::Dtype, [name, ..]) => Node::Dtype(self.dtype_name(*name)?),
            (Global::Scalar, [dtype, data]) => self.scalar(*dtype, *data)?,
            (Global::FromBuffer, [data, dtype, shape, order]) => {
                let fortran = matches!(self.node(*order), Node::Str(s) if self.slice(*s) == b"F");
                let array = self.array_of(*shape, *dtype, fortran, *data)?;
                Node::Array(Box::new(Array { from_buffer: true, ..array }))
            }
            (Global::Encode, [text, _]) => Node::Bytes(self.encode(*text)?),
            (Global::DefaultDict, []) => Node::DefaultDict { int_factory: false, entries: Vec::new() },
            (Global::DefaultDict, [factory]) => {
                let int_factory = match self.node(*factory) {
                    Node::Global(Global::Int) => true,
                    Node::None => false,
                    other => return Err(kind("the factory of a defaultdict", other, "int or None")),
                };
                Node::DefaultDict { int_factory, entries: Vec::new() }
            }
            (Global::Bytes, []) => Node::Bytes(Span { start: 0, len: 0 }),
            (Global::Set, []) => Node::Set(Vec::new()),
            (Global::Set, [items]) => match self.node(*items) {
                Node::List(items) | Node::Tuple(items) => {
                    self.check_keys(items.iter())?;
                    let cost = items.len() * size_of::<Id>();
                    let set = Node::Set(items.clone());
                    self.pay(cost)?;
                    set
                }
                other => return Err(kind("the items of a set", other, "a list")),
            },
            _ => {
                return Err(Problem::Kind {
                    what: "the arguments of REDUCE",
                    found: "another number of values",
                    expected: "what the function takes",
                });
            }
        };
        self.push(made)
    }

    /// Accounts for a copy out of a value that may be shared: without a limit a short file could
    /// ask for one long value again and again.
    fn pay(&mut self, bytes: usize) -> Result<(), Problem> {
        let limit = self.size.saturating_mul(4);
        self.copied = self.copied.saturating_add(bytes);
        if self.copied > limit { Err(Problem::TooMuch(limit)) } else { Ok(()) }
    }

    fn build(&mut self, target: Id, state: Id) -> Result<(), Problem> {
        let Node::Tuple(state) = self.node(state) else {
            return Err(kind("the state of BUILD", self.node(state), "a tuple"));
        };
        let state: Vec<Id> = state.iter().take(9).copied().collect();
        let built = match (self.node(target), &state[..]) {
            (Node::Unbuilt, [_, shape, dtype, fortran, data]) => {
                let fortran = match self.node(*fortran) {
                    Node::Bool(x) => *x,
                    Node::Int(x) => *x != 0,
                    other => return Err(kind("the order flag of an array", other, "a bool")),
                };
                Node::Array(Box::new(self.array_of(*shape, *dtype, fortran, *data)?))
            }
            (Node::Dtype(dtype), [_, order, ..]) => {
                let big_endian = match self.node(*order) {
                    Node::Str(s) => self.slice(*s) == b">",
                    Node::Bytes(s) => self.slice(*s) == b">",
                    other => return Err(kind("the byte order of a type", other, "a str")),
                };
                Node::Dtype(Dtype { big_endian, ..*dtype })
            }
            (other, _) => return Err(kind("the target of BUILD", other, "an array or a numpy type")),
        };
        self.nodes[target.0 as usize] = built;
        Ok(())
    }

    fn dtype_name(&self, name: Id) -> Result<Dtype, Problem> {
        let raw = match self.node(name) {
            Node::Str(span) | Node::Bytes(span) => self.slice(*span),
            other => return Err(kind("the name of a numpy type", other, "a str")),
        };
        Dtype::from_name(raw)
            .ok_or_else(|| Problem::Dtype(String::from_utf8_lossy(&raw[..raw.len().min(20)]).into_owned()))
    }

    fn dtype(&self, id: Id) -> Result<Dtype, Problem> {
        match self.node(id) {
            Node::Dtype(dtype) => Ok(*dtype),
            other => Err(kind("the type of an array", other, "a numpy type")),
        }
    }

    fn data(&self, id: Id) -> Result<Span, Problem> {
        match self.node(id) {
            Node::Bytes(span) | Node::ByteArray(span) => Ok(*span),
            // Python 2 writes the bytes of an array as str, and ASCII ones look like text.
            Node::Str(span) => Ok(*span),
            other => Err(kind("the data of an array", other, "bytes")),
        }
    }

    fn scalar(&self, dtype: Id, data: Id) -> Result<Node, Problem> {
        let (dtype, data) = (self.dtype(dtype)?, self.data(data)?);
        if data.len != u32::from(dtype.size) {
            return Err(array_size(&[], dtype, u64::from(dtype.size), data));
        }
        Ok(Node::Scalar(dtype, data))
    }

    fn array_of(&self, shape: Id, dtype: Id, fortran: bool, data: Id) -> Result<Array, Problem> {
        let (dtype, data) = (self.dtype(dtype)?, self.data(data)?);
        let Node::Tuple(lengths) = self.node(shape) else {
            return Err(kind("the shape of an array", self.node(shape), "a tuple"));
        };
        let mut shape = Vec::with_capacity(lengths.len().min(8));
        for length in lengths {
            match self.node(*length) {
                Node::Int(n) if *n >= 0 && shape.len() < 8 => shape.push(*n as u64),
                other => {
                    return Err(kind("a length in the shape of an array", other, "an int of at least 0"));
                }
            }
        }
        let needed = shape.iter().try_fold(u64::from(dtype.size), |n, length| n.checked_mul(*length));
        let needed = needed.unwrap_or(u64::MAX);
        if needed != u64::from(data.len) {
            return Err(array_size(&shape, dtype, needed, data));
        }
        let short: Option<Vec<u32>> = shape.iter().map(|n| u32::try_from(*n).ok()).collect();
        let shape = short.ok_or_else(|| array_size(&shape, dtype, needed, data))?;
        Ok(Array { dtype, shape, fortran, from_buffer: false, data })
    }

    /// Bytes of `_codecs.encode(text, "latin1")`, appended to the document.
    fn encode(&mut self, text: Id) -> Result<Span, Problem> {
        let Node::Str(span) = *self.node(text) else {
            return Err(kind("the text of _codecs.encode", self.node(text), "a str"));
        };
        self.pay(span.len as usize)?;
        let text = std::str::from_utf8(self.slice(span)).map_err(|_| Problem::Text)?;
        let bytes: Option<Vec<u8>> = text.chars().map(|c| u8::try_from(u32::from(c)).ok()).collect();
        let bytes = bytes.ok_or(Problem::Text)?;
        let start = self.document.len() as u32;
        self.document.extend_from_slice(&bytes);
        Ok(Span { start, len: bytes.len() as u32 })
    }
}

fn kind(what: &'static str, found: &Node, expected: &'static str) -> Problem {
    Problem::Kind { what, found: found.kind(), expected }
}

fn array_size(shape: &[u64], dtype: Dtype, needed: u64, data: Span) -> Problem {
    Problem::ArraySize { shape: shape.to_vec(), dtype: dtype.to_string(), needed, found: data.len as usize }
}
