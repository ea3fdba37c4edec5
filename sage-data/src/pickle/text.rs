//! Opcodes of protocols 0 and 1 whose argument is a line of text.
//!
//! Numbers are accepted in the form that Python writes. CPython takes more, such as octal and hexadecimal ints;
//! these are refused. Every line is read once, so work and memory are proportional to the file.

use super::{
    MAX_DIGITS, Node, PickleProblem as Problem, Span,
    machine::{FALSE, Machine, TRUE},
    opcode as op,
};

/// Decimal digits that are converted at once.
const CHUNK: usize = 18;

impl Machine {
    /// INT, LONG, FLOAT, STRING, UNICODE, PUT or GET with its line.
    #[inline(never)] // The loop over binary opcodes is faster without it.
    pub(super) fn text_opcode(&mut self, code: u8) -> Result<(), Problem> {
        let span = self.line()?;
        match code {
            op::INT | op::LONG => self.integer(code, span),
            op::FLOAT => {
                let value = float(self.slice(span));
                let value =
                    value.ok_or_else(|| self.line_error(code, span, "a float as Python writes it"))?;
                self.push(Node::Float(value))
            }
            op::STRING => self.string(span),
            op::UNICODE => self.unicode(span),
            _ => {
                let entry = memo_entry(self.slice(span));
                let entry = entry.ok_or_else(|| self.line_error(code, span, "the number of a memo entry"))?;
                if code == op::PUT { self.memoize(code, entry) } else { self.recall(entry) }
            }
        }
    }

    #[cold]
    fn line_error(&self, code: u8, span: Span, expected: &'static str) -> Problem {
        let raw = self.slice(span);
        let found = raw[..raw.len().min(40)].escape_ascii().to_string();
        Problem::Line { opcode: op::name(code), found, expected }
    }

    fn integer(&mut self, code: u8, span: Span) -> Result<(), Problem> {
        let raw = self.slice(span);
        match raw {
            b"00" if code == op::INT => return self.push_id(FALSE),
            b"01" if code == op::INT => return self.push_id(TRUE),
            _ => {}
        }
        let raw = if code == op::LONG { raw.strip_suffix(b"L").unwrap_or(raw) } else { raw };
        let (is_negative, digits) = match raw {
            [b'-', digits @ ..] => (true, digits),
            _ => (false, raw),
        };
        // Python writes no leading zero, and no −0.
        let is_plain = match digits {
            [b'0'] => !is_negative,
            [b'1'..=b'9', rest @ ..] => rest.iter().all(u8::is_ascii_digit),
            _ => false,
        };
        if !is_plain || digits.len() > MAX_DIGITS {
            return Err(self.line_error(code, span, "an int of at most 4300 digits as Python writes it"));
        }
        let short = std::str::from_utf8(raw).ok().and_then(|text| text.parse().ok());
        if let Some(value) = short {
            return self.push(Node::Int(value));
        }
        let bytes = twos_complement(is_negative, digits);
        let span = self.append(&bytes);
        self.push(Node::BigInt(span))
    }

    /// Python 2's str between quotes, with its escapes. Python 3 reads it as text if it is ASCII.
    fn string(&mut self, span: Span) -> Result<(), Problem> {
        let raw = self.slice(span);
        let inner = match raw {
            [first @ (b'\'' | b'"'), .., last] if first == last => &raw[1..raw.len() - 1],
            _ => return Err(self.line_error(op::STRING, span, "text in quotes")),
        };
        let span = if inner.contains(&b'\\') {
            let text = unescaped(inner);
            let text =
                text.ok_or_else(|| self.line_error(op::STRING, span, "escapes as Python writes them"))?;
            self.append(&text)
        } else {
            Span { start: span.start + 1, len: span.len - 2 }
        };
        if !self.slice(span).is_ascii() {
            return Err(Problem::NotAscii);
        }
        self.push(Node::Str(span))
    }

    /// Text in Python's encoding `raw-unicode-escape`: Latin-1, and `\u` or `\U` for other characters.
    fn unicode(&mut self, span: Span) -> Result<(), Problem> {
        let raw = self.slice(span);
        if raw.is_ascii() && !raw.contains(&b'\\') {
            return self.push(Node::Str(span));
        }
        let text = raw_unicode(raw)?;
        let span = self.append(text.as_bytes());
        self.push(Node::Str(span))
    }
}

/// The number of a memo entry.
fn memo_entry(raw: &[u8]) -> Option<u64> {
    let is_plain = match raw {
        [b'0'] => true,
        [b'1'..=b'9', rest @ ..] => rest.len() < CHUNK && rest.iter().all(u8::is_ascii_digit),
        _ => false,
    };
    is_plain.then(|| decimal(raw))
}

/// Value of at most [`CHUNK`] digits, which fits 64 bits.
fn decimal(digits: &[u8]) -> u64 {
    digits.iter().fold(0, |sum, digit| 10 * sum + u64::from(digit - b'0'))
}

/// Shortest two's complement of a decimal number, little-endian.
fn twos_complement(is_negative: bool, digits: &[u8]) -> Vec<u8> {
    let mut limbs: Vec<u64> = Vec::with_capacity(digits.len() / CHUNK + 1);
    let (head, chunks) = digits.split_at(digits.len() % CHUNK);
    for chunk in std::iter::once(head).chain(chunks.chunks(CHUNK)) {
        let scale = u128::from(10u64.pow(chunk.len() as u32));
        let mut carry = u128::from(decimal(chunk));
        for limb in &mut limbs {
            carry += u128::from(*limb) * scale;
            *limb = carry as u64;
            carry >>= 64;
        }
        if carry > 0 {
            limbs.push(carry as u64);
        }
    }
    let mut bytes: Vec<u8> = limbs.iter().flat_map(|limb| limb.to_le_bytes()).chain([0]).collect();
    if is_negative {
        let mut carry = true;
        for byte in &mut bytes {
            (*byte, carry) = (!*byte).overflowing_add(u8::from(carry));
        }
    }
    while let [.., before, last] = bytes[..]
        && ((last == 0 && before < 0x80) || (last == 0xff && before >= 0x80))
    {
        bytes.pop();
    }
    bytes
}

/// A float as Python writes it, or with digits in any of the usual forms. Rust and CPython both round to the
/// nearest float.
fn float(raw: &[u8]) -> Option<f64> {
    if raw.len() > MAX_DIGITS {
        return None;
    }
    match raw {
        b"inf" => return Some(f64::INFINITY),
        b"-inf" => return Some(f64::NEG_INFINITY),
        b"nan" => return Some(f64::NAN),
        _ => {}
    }
    let is_plain = raw.iter().all(|b| matches!(b, b'0'..=b'9' | b'.' | b'e' | b'E' | b'+' | b'-'));
    let text = std::str::from_utf8(raw).ok().filter(|_| is_plain)?;
    // Python refuses numbers that are too large for a float.
    text.parse::<f64>().ok().filter(|value| value.is_finite())
}

/// Bytes of a literal of Python 2, without its quotes.
fn unescaped(raw: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(raw.len());
    let mut rest = raw;
    while let [first, tail @ ..] = rest {
        if *first != b'\\' {
            out.push(*first);
            rest = tail;
            continue;
        }
        let (byte, after) = match tail {
            [c @ (b'\\' | b'\'' | b'"'), after @ ..] => (*c, after),
            [b'n', after @ ..] => (b'\n', after),
            [b'r', after @ ..] => (b'\r', after),
            [b't', after @ ..] => (b'\t', after),
            [b'a', after @ ..] => (7, after),
            [b'b', after @ ..] => (8, after),
            [b'f', after @ ..] => (12, after),
            [b'v', after @ ..] => (11, after),
            [b'x', high, low, after @ ..] => ((16 * hex(*high)? + hex(*low)?) as u8, after),
            [b'0'..=b'7', ..] => {
                let count = tail.iter().take(3).take_while(|b| matches!(b, b'0'..=b'7')).count();
                let value = tail[..count].iter().fold(0, |sum, b| 8 * sum + u32::from(b - b'0'));
                (u8::try_from(value).ok()?, &tail[count..])
            }
            // Python keeps the backslash of an unknown escape, with a warning. Nothing writes one.
            _ => return None,
        };
        out.push(byte);
        rest = after;
    }
    Some(out)
}

fn hex(digit: u8) -> Option<u32> {
    char::from(digit).to_digit(16)
}

/// Text of `raw-unicode-escape`. Only `\u` and `\U` are escapes: another backslash stands for itself, together with
/// the byte after it.
fn raw_unicode(raw: &[u8]) -> Result<String, Problem> {
    let mut text = String::with_capacity(raw.len() + raw.len() / 2);
    let mut rest = raw;
    while let [first, tail @ ..] = rest {
        rest = tail;
        let digits = match (first, tail) {
            (b'\\', [b'u', ..]) => 4,
            (b'\\', [b'U', ..]) => 8,
            (b'\\', [second, after @ ..]) => {
                text.push('\\');
                text.push(char::from(*second));
                rest = after;
                continue;
            }
            _ => {
                text.push(char::from(*first));
                continue;
            }
        };
        let code = tail.get(1..=digits).ok_or(Problem::Text)?;
        let code = code.iter().try_fold(0u32, |sum, digit| Some(sum << 4 | hex(*digit)?));
        // Half of a surrogate pair is no character.
        text.push(code.and_then(char::from_u32).ok_or(Problem::Text)?);
        rest = &tail[1 + digits..];
    }
    Ok(text)
}
