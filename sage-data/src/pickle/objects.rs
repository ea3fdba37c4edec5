//! REDUCE and BUILD: the few objects that a scene file makes out of known globals.
//!
//! Arrays come as a function call that makes an empty one and a state that fills it (or, from
//! protocol 5 on, as one call with a buffer); their elements stay where they are in the file.

use super::{
    Array, Dtype, Id, Node, PickleProblem as Problem, Span,
    global::Global,
    machine::{Machine, kind},
};

impl Machine {
    fn node(&self, id: Id) -> &Node {
        &self.nodes[id.0 as usize]
    }

    pub(super) fn reduce(&mut self, function: Id, arguments: Id) -> Result<(), Problem> {
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
            (Global::Bytes, []) => Node::Bytes(Span::EMPTY),
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

    pub(super) fn build(&mut self, target: Id, state: Id) -> Result<(), Problem> {
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

fn array_size(shape: &[u64], dtype: Dtype, needed: u64, data: Span) -> Problem {
    Problem::ArraySize { shape: shape.to_vec(), dtype: dtype.to_string(), needed, found: data.len as usize }
}
