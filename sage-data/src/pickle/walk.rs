//! Whether Python would run some bytes as a pickle of protocol 0 or 1.

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

/// True if Python, given these bytes as a pickle of protocol 0 or 1, would get to the end of the pickle, or to an opcode
/// that names a function or class. Until then it only makes values, which is harmless.
///
/// Python stops at the first byte that is no opcode, and in a native file or a record that is one of the first bytes,
/// unless the file was made to look like a pickle. The walk ignores the stack, so it may return true for a file that
/// Python refuses.
///
/// *Cost*: at most one pass over the bytes.
pub(crate) fn may_run(bytes: &[u8]) -> bool {
    let begins = match bytes {
        // Python accepts PROTO for these protocols, though nothing writes it.
        [op::PROTO, protocol, ..] => *protocol < 2,
        [first, ..] => op::begins_value(*first),
        [] => false,
    };
    begins && walk(bytes).unwrap_or(false)
}

/// `None` where the bytes end inside an argument.
fn walk(mut rest: &[u8]) -> Option<bool> {
    loop {
        let (code, tail) = rest.split_first()?;
        let argument = match code {
            b'.' | b'c' | b'i' | 0x82..=0x84 | 0x93 => return Some(true),
            b'(' | b'0' | b'1' | b'2' | b'N' | b'R' | b'a' | b'b' | b']' | b's' | b't' | b')' | b'u' | b'}'
            | b'l' | b'd' | b'e' | b'o' | 0x81 | 0x85..=0x89 | 0x8f..=0x92 | 0x94 => Argument::None,
            b'K' | b'h' | b'q' | 0x80 => Argument::Fixed(1),
            b'M' => Argument::Fixed(2),
            b'J' | b'j' | b'r' => Argument::Fixed(4),
            b'G' | 0x95 => Argument::Fixed(8),
            b'U' | b'C' | 0x8a | 0x8c => Argument::Counted(1),
            b'T' | b'X' | b'B' | 0x8b => Argument::Counted(4),
            0x8d | 0x8e | 0x96 => Argument::Counted(8),
            b'I' | b'L' | b'F' | b'S' | b'V' | b'g' | b'p' => Argument::Line,
            // Persistent ids and buffers need a caller that expects them.
            _ => return Some(false),
        };
        rest = match argument {
            Argument::None => tail,
            Argument::Fixed(n) => tail.get(n..)?,
            Argument::Counted(width) => {
                let mut count = [0; 8];
                count[..width].copy_from_slice(tail.get(..width)?);
                let count = usize::try_from(u64::from_le_bytes(count)).ok()?;
                let text = tail.get(width..)?.get(..count)?;
                if matches!(code, b'X' | 0x8c | 0x8d) && is_no_text(text) {
                    return Some(false);
                }
                &tail[width + count..]
            }
            Argument::Line => {
                let end = tail.iter().position(|byte| *byte == b'\n')?;
                &tail[end + 1..]
            }
        };
    }
}

/// Whether Python refuses bytes as text. It accepts surrogates, whose UTF-8 begins with 0xed.
fn is_no_text(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_err() && !bytes.contains(&0xed)
}
