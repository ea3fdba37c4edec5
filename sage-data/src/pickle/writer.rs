//! Writes documents as pickles (protocol 4).
//!
//! Shared values stay shared. Both numpy 1 and numpy 2 can read the arrays.

use super::{Array, Document, Dtype, ElementKind, Id, Node, Span, opcode as op};

/// Number of entries per SETITEMS, APPENDS or ADDITEMS, as in Python's pickler.
const BATCH: usize = 1000;

impl Document {
    /// The document as a pickle that Python loads.
    pub fn to_pickle(&self) -> Vec<u8> {
        self.to_pickle_without(|_| false).0
    }

    /// The document as a pickle in which some arrays are empty. Also returns all arrays in the order of the
    /// pickle.
    pub(crate) fn to_pickle_without(&self, is_emptied: impl Fn(Id) -> bool) -> (Vec<u8>, Vec<Id>) {
        let references = self.count_references();
        let newest = self.nodes.iter().any(|node| match node {
            Node::ByteArray(_) => true,
            Node::Array(array) => needs_buffer(array),
            _ => false,
        });
        let mut out = Vec::with_capacity(self.bytes.len() + self.bytes.len() / 8);
        out.extend([op::PROTO, if newest { 5 } else { 4 }]);
        let mut writer = Writer::new(self, &references, &is_emptied, out, 0);
        writer.write_root();
        writer.out.push(op::STOP);
        (writer.out, writer.arrays)
    }

    /// Appends the root value to a pickle that is written in parts and has `memo` memo entries so far.
    /// Returns the new number of memo entries. The value must not need protocol 5.
    pub(crate) fn append_to(&self, out: &mut Vec<u8>, memo: u32) -> u32 {
        let references = self.count_references();
        let mut writer = Writer::new(self, &references, &|_| false, std::mem::take(out), memo);
        writer.write_root();
        *out = writer.out;
        writer.memo_len
    }

    /// Number of references to each value from reachable containers.
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

/// Content of a memo entry that is not a value.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stored {
    Global(&'static str, &'static str),
    Dtype(char, u8, bool),
}

/// Marks a value without a memo entry.
const NOT_STORED: u32 = u32::MAX;

/// Remaining output, last first.
enum Task {
    Value(Id),
    Byte(u8),
    Store(Id),
}

struct Writer<'d> {
    document: &'d Document,
    /// Number of references to each value: only values with several references are stored.
    references: &'d [u32],
    is_emptied: &'d dyn Fn(Id) -> bool,
    out: Vec<u8>,
    /// Memo entry of each value.
    values: Vec<u32>,
    /// Memo entries of globals and dtypes; there are few.
    others: Vec<(Stored, u32)>,
    memo_len: u32,
    tasks: Vec<Task>,
    /// Arrays in the order of writing.
    arrays: Vec<Id>,
}

impl<'d> Writer<'d> {
    fn new(
        document: &'d Document,
        references: &'d [u32],
        is_emptied: &'d dyn Fn(Id) -> bool,
        out: Vec<u8>,
        memo_len: u32,
    ) -> Self {
        let values = vec![NOT_STORED; document.nodes.len()];
        let (others, tasks, arrays) = (Vec::new(), Vec::new(), Vec::new());
        Self { document, references, is_emptied, out, values, others, memo_len, tasks, arrays }
    }

    fn write_root(&mut self) {
        self.tasks.push(Task::Value(self.document.root));
        while let Some(task) = self.tasks.pop() {
            match task {
                Task::Byte(byte) => self.out.push(byte),
                Task::Store(id) => self.store_value(id),
                Task::Value(id) => match self.values[id.0 as usize] {
                    NOT_STORED => self.value(id),
                    entry => self.recall(entry),
                },
            }
        }
    }

    /// Writes a reference to a memo entry.
    fn recall(&mut self, entry: u32) {
        match u8::try_from(entry) {
            Ok(short) => self.out.extend([op::BINGET, short]),
            Err(_) => {
                self.out.push(op::LONG_BINGET);
                self.out.extend(entry.to_le_bytes());
            }
        }
    }

    /// Writes a reference if the memo contains it.
    fn recalls(&mut self, stored: Stored) -> bool {
        let known = self.others.iter().find(|(other, _)| *other == stored).map(|(_, entry)| *entry);
        known.map(|entry| self.recall(entry)).is_some()
    }

    fn memoize(&mut self) -> u32 {
        self.out.push(op::MEMOIZE);
        self.memo_len += 1;
        self.memo_len - 1
    }

    fn store(&mut self, stored: Stored) {
        let entry = self.memoize();
        self.others.push((stored, entry));
    }

    fn store_value(&mut self, id: Id) {
        self.values[id.0 as usize] = self.memoize();
    }

    fn is_shared(&self, id: Id) -> bool {
        self.references[id.0 as usize] > 1
    }

    fn store_if_shared(&mut self, id: Id) {
        if self.is_shared(id) {
            self.store_value(id);
        }
    }

    fn value(&mut self, id: Id) {
        let document = self.document;
        match document.node(id) {
            // The reader refuses unfinished objects.
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
                // Stored after its items: a tuple cannot contain itself.
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
            Node::Array(array) => {
                self.arrays.push(id);
                if (self.is_emptied)(id) {
                    let empty = Array { shape: vec![0], data: Span::EMPTY, ..(**array).clone() };
                    self.array(id, &empty);
                } else {
                    self.array(id, array);
                }
            }
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
        if self.is_shared(id) {
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

    /// Bytes after a length of one or four bytes.
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
        if !self.recalls(Stored::Global(module, name)) {
            self.word(module);
            self.word(name);
            self.out.push(op::STACK_GLOBAL);
            self.store(Stored::Global(module, name));
        }
    }

    fn dtype(&mut self, dtype: Dtype) {
        let key = Stored::Dtype(dtype.letter(), dtype.size, dtype.big_endian);
        if self.recalls(key) {
            return;
        }
        self.global("numpy", "dtype");
        self.word(&format!("{}{}", dtype.letter(), dtype.count()));
        self.out.extend([op::NEWFALSE, op::NEWTRUE, op::TUPLE3, op::REDUCE]);
        self.store(key);
        self.out.extend([op::MARK, op::BININT1, 3]);
        self.word(&dtype.order().to_string());
        self.out.extend([op::NONE, op::NONE, op::NONE]);
        let [size, alignment] = match dtype.kind {
            ElementKind::Text => [i64::from(dtype.size), 4],
            ElementKind::Bytes => [i64::from(dtype.size), 1],
            _ => [-1, -1],
        };
        self.int(size);
        self.int(alignment);
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

/// True if only the form of protocol 5 preserves the byte order of an array.
fn needs_buffer(array: &Array) -> bool {
    array.from_buffer && array.dtype.big_endian && array.dtype.size > 1
}
