//! Canonical bytes of a document: equal for equal values, types included. `recorded_unpickler.py` writes
//! the same.

use sage_data::pickle::{Document, Dtype, Id, Node};

/// Longest text; because of shared values a short program can have a long one.
const LONGEST: usize = 1 << 16;

/// The text of a document's value; `None` if it is longer than 64 KiB.
pub fn text(document: &Document) -> Option<Vec<u8>> {
    value(document, document.root(), LONGEST)
}

fn value(document: &Document, id: Id, room: usize) -> Option<Vec<u8>> {
    let all = |items: &mut dyn Iterator<Item = Id>, sorted: bool| -> Option<Vec<u8>> {
        let (mut parts, mut length) = (Vec::new(), 0);
        for item in items {
            let part = value(document, item, room.checked_sub(length)?)?;
            length += part.len();
            parts.push(part);
        }
        if sorted {
            parts.sort();
        }
        Some(parts.concat())
    };
    let text = match document.node(id) {
        Node::None => b"N".to_vec(),
        Node::Bool(x) => if *x { b"T" } else { b"F" }.to_vec(),
        Node::Int(x) => integer(&x.to_le_bytes()),
        Node::BigInt(span) => integer(document.bytes(*span)),
        Node::Float(x) => format!("f{:016x}", x.to_bits()).into_bytes(),
        Node::Str(span) => counted("s", document.bytes(*span)),
        Node::Bytes(span) => counted("b", document.bytes(*span)),
        Node::ByteArray(span) => counted("a", document.bytes(*span)),
        Node::List(v) => [b"[", &all(&mut v.iter().copied(), false)?[..], b"]"].concat(),
        Node::Tuple(v) => [b"(", &all(&mut v.iter().copied(), false)?[..], b")"].concat(),
        Node::Set(v) => [b"S{", &all(&mut v.iter().copied(), true)?[..], b"}"].concat(),
        Node::FrozenSet(v) => [b"Z{", &all(&mut v.iter().copied(), true)?[..], b"}"].concat(),
        Node::Dict(v) => [b"D{", &all(&mut v.iter().flat_map(|(k, v)| [*k, *v]), false)?[..], b"}"].concat(),
        Node::DefaultDict { int_factory, entries } => {
            let head: &[u8] = if *int_factory { b"Ei{" } else { b"En{" };
            [head, &all(&mut entries.iter().flat_map(|(k, v)| [*k, *v]), false)?, b"}"].concat()
        }
        Node::Dtype(dtype) => [b"Y", name(*dtype).as_bytes()].concat(),
        Node::Scalar(dtype, span) => {
            [b"C", name(*dtype).as_bytes(), &counted("", document.bytes(*span))].concat()
        }
        Node::Array(array) => {
            let flags =
                [if array.fortran { b'F' } else { b'C' }, if array.from_buffer { b'B' } else { b'R' }];
            let shape: Vec<u8> =
                array.shape.iter().flat_map(|n| integer(&i64::from(*n).to_le_bytes())).collect();
            let data = counted("", document.bytes(array.data));
            [b"A", name(array.dtype).as_bytes(), &flags, b"(", &shape, b")", &data].concat()
        }
        unfinished @ (Node::Global(_) | Node::Unbuilt | Node::UnbuiltDtype(_)) => {
            panic!("a finished document holds {}", unfinished.kind())
        }
    };
    (text.len() <= room).then_some(text)
}

fn counted(letter: &str, raw: &[u8]) -> Vec<u8> {
    [format!("{letter}{}:", raw.len()).as_bytes(), raw].concat()
}

/// Shortest two's complement, as hexadecimal digits of its little-endian bytes.
fn integer(le: &[u8]) -> Vec<u8> {
    let mut short = le.to_vec();
    while let [.., before, last] = short[..]
        && ((last == 0 && before < 0x80) || (last == 0xff && before >= 0x80))
    {
        short.pop();
    }
    let digits: String = short.iter().map(|b| format!("{b:02x}")).collect();
    format!("i{digits};").into_bytes()
}

fn name(dtype: Dtype) -> String {
    let order = if dtype.big_endian { ">" } else { "<" };
    format!("{}{}{order}", dtype.letter(), dtype.size)
}
