//! Values of Python and numpy as a pickle of protocol 4, written by hand so that the reader is not tested against its own writer.

/// A value.
#[derive(Clone, Debug)]
pub enum Value {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
    List(Vec<Self>),
    Dict(Vec<(Self, Self)>),
    /// `f4` if the flag is set, else `f8`; rows of a width, or a column for 0.
    Floats(bool, Vec<f64>, usize),
    Bools(Vec<bool>),
    /// `i4`.
    Ints(Vec<i32>),
    /// `U` of the longest text.
    Texts(Vec<String>),
}

/// A text.
pub fn text(text: impl Into<String>) -> Value {
    Value::Text(text.into())
}

/// A dict whose keys are texts.
pub fn dict<'k>(entries: impl IntoIterator<Item = (&'k str, Value)>) -> Value {
    Value::Dict(entries.into_iter().map(|(key, value)| (text(key), value)).collect())
}

/// The bytes of a pickle.
pub fn pickle(value: &Value) -> Vec<u8> {
    let mut out = vec![0x80, 4];
    write(value, &mut out);
    out.push(b'.');
    out
}

fn write(value: &Value, out: &mut Vec<u8>) {
    match value {
        Value::None => out.push(b'N'),
        Value::Bool(x) => out.push(if *x { 0x88 } else { 0x89 }),
        Value::Int(x) => {
            out.extend([0x8a, 8]);
            out.extend(x.to_le_bytes());
        }
        Value::Float(x) => {
            out.push(b'G');
            out.extend(x.to_be_bytes());
        }
        Value::Text(x) => {
            out.push(b'X');
            out.extend((x.len() as u32).to_le_bytes());
            out.extend(x.as_bytes());
        }
        Value::List(items) => {
            out.extend([b']', b'(']);
            items.iter().for_each(|item| write(item, out));
            out.push(b'e');
        }
        Value::Dict(entries) => {
            out.extend([b'}', b'(']);
            for (key, value) in entries {
                write(key, out);
                write(value, out);
            }
            out.push(b'u');
        }
        Value::Floats(is_single, numbers, width) => {
            let bytes = match is_single {
                true => numbers.iter().flat_map(|x| (*x as f32).to_le_bytes()).collect::<Vec<_>>(),
                false => numbers.iter().flat_map(|x| x.to_le_bytes()).collect(),
            };
            let shape = match width {
                0 => vec![numbers.len()],
                width => vec![numbers.len() / width, *width],
            };
            array(&shape, if *is_single { "f4" } else { "f8" }, [-1, -1], &bytes, out);
        }
        Value::Bools(flags) => {
            let bytes: Vec<u8> = flags.iter().map(|flag| u8::from(*flag)).collect();
            array(&[flags.len()], "b1", [-1, -1], &bytes, out);
        }
        Value::Ints(numbers) => {
            let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
            array(&[numbers.len()], "i4", [-1, -1], &bytes, out);
        }
        Value::Texts(texts) => {
            let longest = texts.iter().map(|text| text.chars().count()).max().unwrap_or(1).max(1);
            let padded = |text: &String| {
                let characters: Vec<char> = text.chars().collect();
                (0..longest).flat_map(move |k| (characters.get(k).map_or(0, |c| *c as u32)).to_le_bytes())
            };
            let bytes: Vec<u8> = texts.iter().flat_map(padded).collect();
            array(&[texts.len()], &format!("U{longest}"), [4 * longest as i64, 4], &bytes, out);
        }
    }
}

/// An array as numpy writes it: `_reconstruct`, then its state.
fn array(shape: &[usize], name: &str, [size, alignment]: [i64; 2], bytes: &[u8], out: &mut Vec<u8>) {
    out.extend(b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\n");
    write(&Value::Int(0), out);
    out.push(0x85);
    out.extend(b"C\x01b");
    out.extend([0x87, b'R', b'(']);
    write(&Value::Int(1), out);
    out.push(b'(');
    shape.iter().for_each(|length| write(&Value::Int(*length as i64), out));
    out.push(b't');
    out.extend(b"cnumpy\ndtype\n");
    write(&text(name), out);
    out.extend([0x89, 0x88, 0x87, b'R', b'(']);
    write(&Value::Int(3), out);
    write(&text(if name == "b1" { "|" } else { "<" }), out);
    out.extend(b"NNN");
    write(&Value::Int(size), out);
    write(&Value::Int(alignment), out);
    write(&Value::Int(0), out);
    out.extend([b't', b'b', 0x89, b'B']);
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend(bytes);
    out.extend([b't', b'b']);
}
