//! Whether Python would run some bytes as a pickle of protocol 0 or 1.
//!
//! These protocols have no first byte of their own. A file that reaches the name of a function or class is a pickle.

use super::opcode as op;

/// The argument of an opcode.
enum Argument {
    None,
    /// A number of bytes.
    Fixed(usize),
    /// Bytes after their number, which has this width.
    Counted(usize),
    /// The rest of the line.
    Line,
}

/// What Python comes to, given some bytes as a pickle of protocol 0 or 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Walk {
    /// An opcode that names a function or class. Until then Python only makes values, which is harmless.
    Names,
    /// The end of the pickle.
    Ends,
    /// A byte that is no opcode, an argument that Python refuses, or the end of the bytes.
    Fails,
}

/// Walks over some bytes as Python would, given them as a pickle of protocol 0 or 1.
///
/// In a native file or a record, Python stops at one of the first bytes, unless the file was made to look like a pickle.
/// The walk knows the stack only roughly, so Python may refuse a file earlier, but not later.
///
/// *Cost*: at most one pass over the bytes.
pub(crate) fn walk(bytes: &[u8]) -> Walk {
    let begins = match bytes {
        // Python accepts PROTO for these protocols, though nothing writes it.
        [op::PROTO, protocol, ..] => *protocol < 2,
        [first, ..] => begins_value(*first),
        [] => false,
    };
    if begins { steps(bytes).unwrap_or(Walk::Fails) } else { Walk::Fails }
}

/// Whether an opcode can begin a pickle of protocol 0 or 1: it creates a value from nothing, or is MARK.
pub(super) fn begins_value(code: u8) -> bool {
    b"(])}cNILFSVJKMGTUX".contains(&code)
}

/// `None` where the bytes end inside an argument.
fn steps(mut rest: &[u8]) -> Option<Walk> {
    let (mut texts, mut has_mark) = (0, false);
    loop {
        let (code, tail) = rest.split_first()?;
        let argument = match code {
            b'.' => return Some(Walk::Ends),
            b'c' | b'i' => {
                let is_named = has_global(tail)? && (*code == b'c' || has_mark);
                return Some(if is_named { Walk::Names } else { Walk::Fails });
            }
            0x93 => return Some(if texts < 2 { Walk::Fails } else { Walk::Names }),
            b'('
            | b'0'
            | b'1'
            | b'2'
            | b'N'
            | b'R'
            | b'a'
            | b'b'
            | b']'
            | b's'
            | b't'
            | b')'
            | b'u'
            | b'}'
            | b'l'
            | b'd'
            | b'e'
            | b'o'
            | 0x81
            | 0x85..=0x89
            | 0x8f..=0x92
            | 0x94 => Argument::None,
            b'K' | b'h' | b'q' | 0x80 => Argument::Fixed(1),
            b'M' => Argument::Fixed(2),
            b'J' | b'j' | b'r' => Argument::Fixed(4),
            b'G' | 0x95 => Argument::Fixed(8),
            b'U' | b'C' | 0x8a | 0x8c => Argument::Counted(1),
            b'T' | b'X' | b'B' | 0x8b => Argument::Counted(4),
            0x8d | 0x8e | 0x96 => Argument::Counted(8),
            b'I' | b'L' | b'F' | b'S' | b'V' | b'g' | b'p' => Argument::Line,
            // Persistent ids, registered classes and buffers need a program that expects them.
            _ => return Some(Walk::Fails),
        };
        has_mark |= *code == b'(';
        texts += usize::from(matches!(code, b'S' | b'T' | b'U' | b'V' | b'X' | 0x8c | 0x8d));
        rest = match argument {
            Argument::None => tail,
            Argument::Fixed(n) => tail.get(n..)?,
            Argument::Counted(width) => {
                let mut count = [0; 8];
                count[..width].copy_from_slice(tail.get(..width)?);
                let count = usize::try_from(u64::from_le_bytes(count)).ok()?;
                let text = tail.get(width..)?.get(..count)?;
                if matches!(code, b'X' | 0x8c | 0x8d) && is_no_text(text) {
                    return Some(Walk::Fails);
                }
                &tail[width + count..]
            }
            Argument::Line => {
                let (_, after) = line(tail)?;
                after
            }
        };
    }
}

/// The rest of a line, and what follows it.
fn line(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    Some((&bytes[..end], &bytes[end + 1..]))
}

/// Whether two lines can be the names of a module and of something in it.
fn has_global(bytes: &[u8]) -> Option<bool> {
    let (module, rest) = line(bytes)?;
    let (name, _) = line(rest)?;
    let is_name = |raw: &[u8]| {
        let text = std::str::from_utf8(raw).unwrap_or_default();
        !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '.' | '-'))
    };
    Some(is_name(module) && is_name(name))
}

/// Whether Python refuses bytes as text. It accepts surrogates, whose UTF-8 begins with 0xed.
fn is_no_text(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_err() && !bytes.contains(&0xed)
}
