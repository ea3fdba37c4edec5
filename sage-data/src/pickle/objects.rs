//! REDUCE, NEWOBJ and BUILD: the few objects that a scene file creates from known globals.
//!
//! Arrays are a function call that creates an empty array and a state that fills it, or, from protocol 5
//! on, one call with a buffer. Their elements remain in the file's bytes.
//!
//! Arguments and states are accepted only in the form that numpy writes. The result of other forms would
//! depend on numpy's version. A type can be used only after its state is set, and its state can be set only
//! once, because Python's arrays share their type and a later state would change them all.

use super::{
    Array, Dtype, Id, Node, PickleProblem as Problem, Span,
    global::Global,
    machine::{Machine, NONE, kind},
};

/// Largest number of axes; scenes have two.
const MAX_AXES: usize = 8;

impl Machine {
    fn node(&self, id: Id) -> &Node {
        &self.nodes[id.0 as usize]
    }

    /// NEWOBJ, which makes a `Vector` and a `ScenarioDescription`. Python's value is a tuple with methods, so it is read as
    /// the tuple that it was made from.
    #[inline(never)]
    pub(super) fn new_object(&mut self, class: Id, arguments: Id) -> Result<(), Problem> {
        match (self.node(class), self.node(arguments)) {
            (Node::Global(Global::Vector), Node::Tuple(arguments)) if arguments.len() == 1 => {
                self.vector(arguments[0])
            }
            (Node::Global(Global::Vector), _) => Err(form("the arguments of Vector", "one tuple")),
            (Node::Global(Global::ScenarioDescription), Node::Tuple(arguments)) if arguments.is_empty() => {
                self.push(Node::Dict(Vec::new()))
            }
            (Node::Global(Global::PointLane), Node::Tuple(arguments)) if arguments.is_empty() => {
                self.unbuilt_lanes.insert(Id(self.nodes.len() as u32));
                self.push(Node::Dict(Vec::new()))
            }
            (Node::Global(Global::PointLane), _) => {
                Err(form("the arguments of PointLane", "none; its state follows"))
            }
            (Node::Global(Global::ScenarioDescription), _) => {
                Err(form("the arguments of ScenarioDescription", "none; its items follow"))
            }
            (other, _) => Err(kind(
                "the class of NEWOBJ",
                other,
                "MetaDrive's Vector, ScenarioDescription or PointLane",
            )),
        }
    }

    fn vector(&mut self, items: Id) -> Result<(), Problem> {
        match self.node(items) {
            Node::Tuple(_) => self.push_id(items),
            other => Err(kind("the items of a Vector", other, "a tuple")),
        }
    }

    pub(super) fn reduce(&mut self, function: Id, arguments: Id) -> Result<(), Problem> {
        let Node::Global(function) = *self.node(function) else {
            return Err(kind("the function of REDUCE", self.node(function), "a known global"));
        };
        let Node::Tuple(arguments) = self.node(arguments) else {
            return Err(kind("the arguments of REDUCE", self.node(arguments), "a tuple"));
        };
        let (arguments, count) = first::<5>(arguments);
        let node = match (function, &arguments[..count]) {
            (Global::Reconstruct, [class, shape, letter]) => {
                self.check_empty_array(*class, *shape, *letter)?;
                Node::Unbuilt
            }
            (Global::Dtype, [name, align, copy]) => {
                if self.flag(*align) != Some(false) || self.flag(*copy) != Some(true) {
                    return Err(form("the arguments of numpy.dtype", "(name, False, True)"));
                }
                Node::UnbuiltDtype(self.dtype_name(*name)?)
            }
            (Global::Scalar, [dtype, data]) => match self.dtype(*dtype)? {
                texts if texts.is_text() => self.text_scalar(texts, self.data(*data)?)?,
                _ => self.scalar(*dtype, *data)?,
            },
            (Global::FromBuffer, [data, dtype, shape, order]) => {
                if !matches!(self.node(*data), Node::Bytes(_) | Node::ByteArray(_)) {
                    return Err(kind("the buffer of an array", self.node(*data), "bytes or a bytearray"));
                }
                let fortran = match self.str_bytes(*order) {
                    Some(b"C") => false,
                    Some(b"F") => true,
                    _ => return Err(form("the order of an array", "`C` or `F`")),
                };
                let array = self.array_of(*shape, *dtype, fortran, self.data(*data)?)?;
                self.array_or_texts(Array { from_buffer: true, ..array })?
            }
            (Global::Encode, [text, encoding]) => {
                if self.str_bytes(*encoding) != Some(b"latin1") {
                    return Err(form("the encoding of _codecs.encode", "`latin1`"));
                }
                Node::Bytes(self.encode(*text)?)
            }
            (Global::DefaultDict, []) => Node::DefaultDict { int_factory: false, entries: Vec::new() },
            (Global::DefaultDict, [factory]) => {
                let int_factory = match self.node(*factory) {
                    Node::Global(Global::Int) => true,
                    Node::None => false,
                    other => return Err(kind("the factory of a defaultdict", other, "int or None")),
                };
                Node::DefaultDict { int_factory, entries: Vec::new() }
            }
            (Global::Vector, [items]) => return self.vector(*items),
            (Global::FromWkb, [outline]) => match self.node(*outline) {
                // MetaDrive accepts no bytes in a scene, and the lane has the points of its outline too.
                Node::Bytes(_) => return self.push_id(NONE),
                other => return Err(kind("the outline of from_wkb", other, "bytes")),
            },
            (Global::Bytes, []) => Node::Bytes(Span::EMPTY),
            (Global::Set, []) => Node::Set(Vec::new()),
            (Global::Set, [items]) => match self.node(*items) {
                Node::List(items) | Node::Tuple(items) => {
                    let items = items.clone();
                    self.pay(items.len() * size_of::<Id>())?;
                    self.check_hashable(&items)?;
                    Node::Set(items)
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
        self.push(node)
    }

    /// Accounts for a copy of a value that may be shared. Without a limit a short file could cause many
    /// copies of one long value.
    pub(super) fn pay(&mut self, bytes: usize) -> Result<(), Problem> {
        let limit = self.size.saturating_mul(4);
        self.copied = self.copied.saturating_add(bytes);
        if self.copied > limit { Err(Problem::TooMuch(limit)) } else { Ok(()) }
    }

    pub(super) fn build(&mut self, target: Id, state: Id) -> Result<(), Problem> {
        if self.unbuilt_lanes.remove(&target) {
            let Node::Dict(attributes) = self.node(state) else {
                return Err(kind("the state of a PointLane", self.node(state), "a dict"));
            };
            let attributes = attributes.clone();
            self.pay(attributes.len() * size_of::<(Id, Id)>())?;
            self.nodes[target.0 as usize] = Node::Dict(attributes);
            return Ok(());
        }
        let Node::Tuple(state) = self.node(state) else {
            return Err(kind("the state of BUILD", self.node(state), "a tuple"));
        };
        let (state, count) = first::<9>(state);
        let built = match (self.node(target), &state[..count]) {
            (Node::Unbuilt, [version, shape, dtype, fortran, data]) => {
                let Some(fortran) = self.flag(*fortran).filter(|_| self.is_int(*version, 1)) else {
                    return Err(form("the state of an array", "(1, shape, type, order flag, bytes)"));
                };
                let data = match self.node(*data) {
                    Node::ByteArray(_) => {
                        return Err(kind("the data of an array", self.node(*data), "bytes"));
                    }
                    _ => self.data(*data)?,
                };
                let array = self.array_of(*shape, *dtype, fortran, data)?;
                self.array_or_texts(array)?
            }
            (Node::UnbuiltDtype(dtype), [version, order, subtype, names, fields, size, alignment, flags]) => {
                let is_plain =
                    [subtype, names, fields].iter().all(|id| matches!(self.node(**id), Node::None))
                        && self.is_int(*version, 3)
                        && ([size, alignment].iter().all(|id| self.is_int(**id, -1)) && !dtype.is_text()
                            || dtype.is_text() && self.is_state_of_texts(*dtype, *size, *alignment))
                        && self.is_int(*flags, 0);
                if !is_plain {
                    return Err(form(
                        "the state of a numpy type",
                        "(3, order, None, None, None, size, alignment, 0)",
                    ));
                }
                let order = match self.node(*order) {
                    Node::Bytes(order) => Some(self.slice(*order)),
                    _ => self.str_bytes(*order),
                };
                let big_endian = match order {
                    Some(b">") => true,
                    Some(b"<" | b"=" | b"|") => false,
                    _ => return Err(form("the byte order of a numpy type", "`<`, `>`, `=` or `|`")),
                };
                Node::Dtype(Dtype { big_endian, ..*dtype })
            }
            (Node::Unbuilt | Node::UnbuiltDtype(_), _) => {
                return Err(form("the state of an array or numpy type", "as many values as numpy writes"));
            }
            (other, _) => return Err(kind("the target of BUILD", other, "a new array or numpy type")),
        };
        self.nodes[target.0 as usize] = built;
        Ok(())
    }

    /// `_reconstruct(ndarray, (0,), b'b')` creates an empty array; other arguments are refused.
    fn check_empty_array(&self, class: Id, shape: Id, letter: Id) -> Result<(), Problem> {
        let is_class = matches!(self.node(class), Node::Global(Global::NdArray));
        let is_empty = matches!(self.node(shape), Node::Tuple(n) if n.len() == 1 && self.is_int(n[0], 0));
        let is_letter = match self.node(letter) {
            Node::Bytes(letter) | Node::Str(letter) => self.slice(*letter) == b"b",
            _ => false,
        };
        if is_class && is_empty && is_letter {
            Ok(())
        } else {
            Err(form("the arguments of _reconstruct", "(numpy.ndarray, (0,), b'b')"))
        }
    }

    fn str_bytes(&self, id: Id) -> Option<&[u8]> {
        match self.node(id) {
            Node::Str(span) => Some(self.slice(*span)),
            _ => None,
        }
    }

    pub(super) fn is_int(&self, id: Id, value: i64) -> bool {
        matches!(self.node(id), Node::Int(x) if *x == value)
    }

    /// A bool, which older versions write as 0 or 1.
    fn flag(&self, id: Id) -> Option<bool> {
        match self.node(id) {
            Node::Bool(x) => Some(*x),
            Node::Int(x @ (0 | 1)) => Some(*x == 1),
            _ => None,
        }
    }

    fn dtype_name(&self, name: Id) -> Result<Dtype, Problem> {
        let raw = match self.node(name) {
            Node::Str(span) | Node::Bytes(span) => self.slice(*span),
            other => return Err(kind("the name of a numpy type", other, "a str")),
        };
        // The byte order is part of the state.
        Dtype::from_name(raw)
            .filter(|_| raw[0].is_ascii_alphabetic())
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
            // Python 2 writes the bytes of an array as str. Non-ASCII bytes would differ from the text's
            // bytes.
            Node::Str(span) if self.slice(*span).is_ascii() => Ok(*span),
            other => Err(kind("the data of an array", other, "bytes")),
        }
    }

    fn scalar(&self, dtype: Id, data: Id) -> Result<Node, Problem> {
        let dtype = self.dtype(dtype)?;
        if let other @ Node::ByteArray(_) = self.node(data) {
            return Err(kind("the data of a numpy scalar", other, "bytes"));
        }
        let data = self.data(data)?;
        if data.len != u32::from(dtype.size) {
            return Err(array_size(&[], dtype, u64::from(dtype.size), data));
        }
        Ok(Node::Scalar(dtype, data))
    }

    fn array_of(&self, shape: Id, dtype: Id, fortran: bool, data: Span) -> Result<Array, Problem> {
        let dtype = self.dtype(dtype)?;
        let Node::Tuple(lengths) = self.node(shape) else {
            return Err(kind("the shape of an array", self.node(shape), "a tuple"));
        };
        let mut axes = [0u64; MAX_AXES];
        for (axis, length) in lengths.iter().enumerate() {
            match (self.node(*length), axes.get_mut(axis)) {
                (Node::Int(n), Some(slot)) if *n >= 0 => *slot = *n as u64,
                (other, _) => {
                    return Err(kind("a length in the shape of an array", other, "an int of at least 0"));
                }
            }
        }
        let axes = &axes[..lengths.len()];
        let needed = axes.iter().try_fold(u64::from(dtype.size), |n, length| n.checked_mul(*length));
        let needed = needed.unwrap_or(u64::MAX);
        let short = |n: &u64| u32::try_from(*n).ok();
        let shape: Option<Vec<u32>> =
            (needed == u64::from(data.len)).then(|| axes.iter().map(short).collect()).flatten();
        let shape = shape.ok_or_else(|| array_size(axes, dtype, needed, data))?;
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
        Ok(self.append(&bytes))
    }

    /// Adds bytes that the file holds in another form.
    pub(super) fn append(&mut self, bytes: &[u8]) -> Span {
        let start = self.document.len() as u32;
        self.document.extend_from_slice(bytes);
        Span { start, len: bytes.len() as u32 }
    }
}

/// The first values of a tuple, and their number, without an allocation for each array.
fn first<const N: usize>(items: &[Id]) -> ([Id; N], usize) {
    let mut first = [NONE; N];
    let count = items.len().min(N);
    first[..count].copy_from_slice(&items[..count]);
    (first, count)
}

/// An error for a value that does not have the form that numpy and Python write.
fn form(what: &'static str, expected: &'static str) -> Problem {
    Problem::Kind { what, found: "something else", expected }
}

fn array_size(shape: &[u64], dtype: Dtype, needed: u64, data: Span) -> Problem {
    Problem::ArraySize { shape: shape.to_vec(), dtype: dtype.to_string(), needed, found: data.len as usize }
}
