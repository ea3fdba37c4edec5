//! Documents back to pickles (protocol 4), and new values for them.
//!
//! Values that were shared stay shared. Arrays are written the way numpy 1 and 2 both read.

use std::collections::HashMap;

use super::{Array, Document, Dtype, Id, Node, Span, opcode as op};

/// Entries a batch of SETITEMS, APPENDS or ADDITEMS, as Python's pickler has it.
const BATCH: usize = 1000;

impl Document {
    /// A document of None, to add values to.
    pub(crate) fn empty() -> Self {
        Self { bytes: Vec::new(), nodes: vec![Node::None], root: Id(0), file_size: 0 }
    }

    /// Makes a value the outermost.
    pub(crate) fn set_root(&mut self, root: Id) {
        self.root = root;
    }

    /// Puts another value in place of one, for everything that refers to it.
    pub(crate) fn replace(&mut self, id: Id, node: Node) {
        self.nodes[id.0 as usize] = node;
    }

    /// Adds a value that nothing refers to yet.
    pub(crate) fn push(&mut self, node: Node) -> Id {
        let id = Id(self.nodes.len() as u32);
        self.nodes.push(node);
        id
    }

    /// Adds bytes.
    pub(crate) fn push_bytes(&mut self, bytes: &[u8]) -> Span {
        let start = self.bytes.len() as u32;
        self.bytes.extend_from_slice(bytes);
        Span { start, len: bytes.len() as u32 }
    }

    /// Sets a str key of a dict.
    pub(crate) fn set(&mut self, dict: Id, key: &str, value: Id) {
        let span = self.push_bytes(key.as_bytes());
        let place = match self.entries(dict) {
            Some(entries) => entries.iter().rposition(|(k, _)| self.text(*k) == Some(key)),
            None => return,
        };
        let key = self.push(Node::Str(span));
        if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut self.nodes[dict.0 as usize] {
            match place {
                Some(place) => entries[place].1 = value,
                None => entries.push((key, value)),
            }
        }
    }

    /// The document as a pickle that Python loads.
    pub fn to_pickle(&self) -> Vec<u8> {
        let references = self.count_references();
        let mut writer = Writer {
            document: self,
            shared: |id: Id| references[id.0 as usize] > 1,
            out: Vec::with_capacity(self.bytes.len() + self.bytes.len() / 8),
            stored: HashMap::new(),
            memo_len: 0,
            tasks: vec![Task::Value(self.root)],
        };
        let newest = self.nodes.iter().any(|node| match node {
            Node::ByteArray(_) => true,
            Node::Array(array) => needs_buffer(array),
            _ => false,
        });
        writer.out.extend([op::PROTO, if newest { 5 } else { 4 }]);
        while let Some(task) = writer.tasks.pop() {
            writer.perform(task);
        }
        writer.out.push(op::STOP);
        writer.out
    }

    /// How often each value is referred to from reachable containers.
    fn count_references(&self) -> Vec<u32> {
        let mut references = vec![0u32; self.nodes.len()];
        let mut open = vec![self.root];
        while let Some(id) = open.pop() {
            let count = &mut references[id.0 as usize];
            *count += 1;
            if *count > 1 {
                continue;
            }
            match self.node(id) {
                Node::List(v) | Node::Tuple(v) | Node::Set(v) | Node::FrozenSet(v) => open.extend(v),
                Node::Dict(v) | Node::DefaultDict { entries: v, .. } => {
                    open.extend(v.iter().flat_map(|(k, value)| [*k, *value]));
                }
                _ => {}
            }
        }
        references
    }
}

/// What can be in the memo.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Stored {
    Value(Id),
    Global(&'static str, &'static str),
    Dtype(char, u8, bool),
}

/// What is left to write, last first.
enum Task {
    Value(Id),
    Byte(u8),
    Store(Id),
}

struct Writer<'d, F> {
    document: &'d Document,
    shared: F,
    out: Vec<u8>,
    stored: HashMap<Stored, u32>,
    memo_len: u32,
    tasks: Vec<Task>,
}

impl<F: Fn(Id) -> bool> Writer<'_, F> {
    fn perform(&mut self, task: Task) {
        match task {
            Task::Byte(byte) => self.out.push(byte),
            Task::Store(id) => self.store(Stored::Value(id)),
            Task::Value(id) => {
                if !self.recall(Stored::Value(id)) {
                    self.value(id);
                }
            }
        }
    }

    /// Writes a reference if the thing is in the memo.
    fn recall(&mut self, thing: Stored) -> bool {
        let Some(&place) = self.stored.get(&thing) else { return false };
        match u8::try_from(place) {
            Ok(short) => self.out.extend([op::BINGET, short]),
            Err(_) => {
                self.out.push(op::LONG_BINGET);
                self.out.extend(place.to_le_bytes());
            }
        }
        true
    }

    fn store(&mut self, thing: Stored) {
        self.out.push(op::MEMOIZE);
        self.stored.insert(thing, self.memo_len);
        self.memo_len += 1;
    }

    fn store_if_shared(&mut self, id: Id) {
        if (self.shared)(id) {
            self.store(Stored::Value(id));
        }
    }

    fn value(&mut self, id: Id) {
        let document = self.document;
        match document.node(id) {
            // Unfinished objects never get past the reader.
            Node::None | Node::Unbuilt | Node::UnbuiltDtype(_) | Node::Global(_) => self.out.push(op::NONE),
            Node::Bool(x) => self.out.push(if *x { op::NEWTRUE } else { op::NEWFALSE }),
            Node::Int(x) => self.int(*x),
            Node::BigInt(span) => {
                self.counted(op::LONG1, op::LONG4, document.bytes(*span));
                self.store_if_shared(id);
            }
            Node::Float(x) => {
                self.out.push(op::BINFLOAT);
                self.out.extend(x.to_be_bytes());
            }
            Node::Str(span) => {
                self.counted(op::SHORT_BINUNICODE, op::BINUNICODE, document.bytes(*span));
                self.store_if_shared(id);
            }
            Node::Bytes(span) => {
                self.counted(op::SHORT_BINBYTES, op::BINBYTES, document.bytes(*span));
                self.store_if_shared(id);
            }
            Node::ByteArray(span) => {
                let bytes = document.bytes(*span);
                self.out.push(op::BYTEARRAY8);
                self.out.extend((bytes.len() as u64).to_le_bytes());
                self.out.extend_from_slice(bytes);
                self.store_if_shared(id);
            }
            Node::Tuple(items) => {
                // Stored after its items: a tuple cannot hold itself.
                let (open, close) = match items.len() {
                    0 => (None, op::EMPTY_TUPLE),
                    1 => (None, op::TUPLE1),
                    2 => (None, op::TUPLE2),
                    3 => (None, op::TUPLE3),
                    _ => (Some(op::MARK), op::TUPLE),
                };
                self.out.extend(open);
                self.finish_later(id, close);
                self.tasks.extend(items.iter().rev().map(|item| Task::Value(*item)));
            }
            Node::FrozenSet(items) => {
                self.out.push(op::MARK);
                self.finish_later(id, op::FROZENSET);
                self.tasks.extend(items.iter().rev().map(|item| Task::Value(*item)));
            }
            Node::List(items) => {
                self.out.push(op::EMPTY_LIST);
                self.store_if_shared(id);
                self.batches(items.iter().map(|item| [Some(*item), None]), op::APPENDS);
            }
            Node::Set(items) => {
                self.out.push(op::EMPTY_SET);
                self.store_if_shared(id);
                self.batches(items.iter().map(|item| [Some(*item), None]), op::ADDITEMS);
            }
            Node::Dict(entries) => {
                self.out.push(op::EMPTY_DICT);
                self.store_if_shared(id);
                self.batches(entries.iter().map(|(k, v)| [Some(*k), Some(*v)]), op::SETITEMS);
            }
            Node::DefaultDict { int_factory, entries } => {
                self.global("collections", "defaultdict");
                if *int_factory {
                    self.global("builtins", "int");
                    self.out.push(op::TUPLE1);
                } else {
                    self.out.push(op::EMPTY_TUPLE);
                }
                self.out.push(op::REDUCE);
                self.store_if_shared(id);
                self.batches(entries.iter().map(|(k, v)| [Some(*k), Some(*v)]), op::SETITEMS);
            }
            Node::Array(array) => self.array(id, array),
            Node::Scalar(dtype, span) => {
                self.global("numpy.core.multiarray", "scalar");
                self.dtype(*dtype);
                self.counted(op::SHORT_BINBYTES, op::BINBYTES, document.bytes(*span));
                self.out.extend([op::TUPLE2, op::REDUCE]);
                self.store_if_shared(id);
            }
            Node::Dtype(dtype) => self.dtype(*dtype),
        }
    }

    fn finish_later(&mut self, id: Id, close: u8) {
        if (self.shared)(id) {
            self.tasks.push(Task::Store(id));
        }
        self.tasks.push(Task::Byte(close));
    }

    /// Items (or keys and values) of a container, in batches.
    fn batches(&mut self, items: impl ExactSizeIterator<Item = [Option<Id>; 2]>, close: u8) {
        let n = items.len();
        let mut tasks = Vec::with_capacity(2 * n + 2);
        for (k, item) in items.enumerate() {
            if k % BATCH == 0 {
                tasks.push(Task::Byte(op::MARK));
            }
            tasks.extend(item.into_iter().flatten().map(Task::Value));
            if (k + 1) % BATCH == 0 || k + 1 == n {
                tasks.push(Task::Byte(close));
            }
        }
        self.tasks.extend(tasks.into_iter().rev());
    }

    fn int(&mut self, x: i64) {
        if let Ok(short) = u8::try_from(x) {
            self.out.extend([op::BININT1, short]);
        } else if let Ok(short) = u16::try_from(x) {
            self.out.push(op::BININT2);
            self.out.extend(short.to_le_bytes());
        } else if let Ok(short) = i32::try_from(x) {
            self.out.push(op::BININT);
            self.out.extend(short.to_le_bytes());
        } else {
            self.out.extend([op::LONG1, 8]);
            self.out.extend(x.to_le_bytes());
        }
    }

    /// Bytes with a length of one or four bytes before them.
    fn counted(&mut self, short: u8, long: u8, bytes: &[u8]) {
        match u8::try_from(bytes.len()) {
            Ok(n) => self.out.extend([short, n]),
            Err(_) => {
                self.out.push(long);
                self.out.extend((bytes.len() as u32).to_le_bytes());
            }
        }
        self.out.extend_from_slice(bytes);
    }

    fn word(&mut self, text: &str) {
        self.counted(op::SHORT_BINUNICODE, op::BINUNICODE, text.as_bytes());
    }

    fn global(&mut self, module: &'static str, name: &'static str) {
        if !self.recall(Stored::Global(module, name)) {
            self.word(module);
            self.word(name);
            self.out.push(op::STACK_GLOBAL);
            self.store(Stored::Global(module, name));
        }
    }

    fn dtype(&mut self, dtype: Dtype) {
        let key = Stored::Dtype(dtype.letter(), dtype.size, dtype.big_endian);
        if self.recall(key) {
            return;
        }
        self.global("numpy", "dtype");
        self.word(&format!("{}{}", dtype.letter(), dtype.size));
        self.out.extend([op::NEWFALSE, op::NEWTRUE, op::TUPLE3, op::REDUCE]);
        self.store(key);
        self.out.extend([op::MARK, op::BININT1, 3]);
        self.word(&dtype.order().to_string());
        self.out.extend([op::NONE, op::NONE, op::NONE]);
        self.int(-1);
        self.int(-1);
        self.out.extend([op::BININT1, 0, op::TUPLE, op::BUILD]);
    }

    fn array(&mut self, id: Id, array: &Array) {
        if needs_buffer(array) {
            return self.buffered_array(id, array);
        }
        self.global("numpy.core.multiarray", "_reconstruct");
        self.global("numpy", "ndarray");
        self.out.extend([op::BININT1, 0, op::TUPLE1]);
        self.counted(op::SHORT_BINBYTES, op::BINBYTES, b"b");
        self.out.extend([op::TUPLE3, op::REDUCE]);
        self.store_if_shared(id);
        self.out.extend([op::MARK, op::BININT1, 1, op::MARK]);
        for length in &array.shape {
            self.int(i64::from(*length));
        }
        self.out.push(op::TUPLE);
        self.dtype(array.dtype);
        self.out.push(if array.fortran { op::NEWTRUE } else { op::NEWFALSE });
        self.counted(op::SHORT_BINBYTES, op::BINBYTES, self.document.bytes(array.data));
        self.out.extend([op::TUPLE, op::BUILD]);
    }

    fn buffered_array(&mut self, id: Id, array: &Array) {
        let bytes = self.document.bytes(array.data);
        self.global("numpy.core.numeric", "_frombuffer");
        self.out.push(op::MARK);
        self.out.push(op::BYTEARRAY8);
        self.out.extend((bytes.len() as u64).to_le_bytes());
        self.out.extend_from_slice(bytes);
        self.dtype(array.dtype);
        self.out.push(op::MARK);
        for length in &array.shape {
            self.int(i64::from(*length));
        }
        self.out.push(op::TUPLE);
        self.word(if array.fortran { "F" } else { "C" });
        self.out.extend([op::TUPLE, op::REDUCE]);
        self.store_if_shared(id);
    }
}

/// Whether only protocol 5's way keeps an array's byte order.
fn needs_buffer(array: &Array) -> bool {
    array.from_buffer && array.dtype.big_endian && array.dtype.size > 1
}
