//! Element types of numpy arrays.

use std::fmt;

/// Kind of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ElementKind {
    /// `b`: one byte, 0 or 1.
    Bool,
    /// `i`.
    Int,
    /// `u`.
    Uint,
    /// `f`.
    Float,
    /// `U`: texts of four bytes a character. Arrays of them are read as lists.
    Text,
    /// `S`: texts of one byte a character, likewise.
    Bytes,
}

/// A numpy type of numbers or texts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dtype {
    /// Kind.
    pub kind: ElementKind,
    /// Bytes an element: 1, 2, 4 or 8 of numbers.
    pub size: u8,
    /// Whether the most significant byte comes first.
    pub big_endian: bool,
}

impl Dtype {
    /// The type of a name such as `f4` or `<f4`.
    pub(super) fn from_name(name: &[u8]) -> Option<Self> {
        let (big_endian, name) = match name {
            [b'>', rest @ ..] => (true, rest),
            [b'<' | b'=' | b'|', rest @ ..] => (false, rest),
            _ => (false, name),
        };
        if let [letter @ (b'U' | b'S'), digits @ ..] = name {
            return Self::of_texts(*letter, digits, big_endian);
        }
        let (kind, sizes): (_, &[u8]) = match name.first()? {
            b'b' => (ElementKind::Bool, &[1]),
            b'i' => (ElementKind::Int, &[1, 2, 4, 8]),
            b'u' => (ElementKind::Uint, &[1, 2, 4, 8]),
            b'f' => (ElementKind::Float, &[2, 4, 8]),
            _ => return None,
        };
        match name[1..] {
            [digit] if sizes.contains(&digit.wrapping_sub(b'0')) => {
                Some(Self { kind, size: digit - b'0', big_endian })
            }
            _ => None,
        }
    }

    /// A type of texts, with its number of characters as digits.
    fn of_texts(letter: u8, digits: &[u8], big_endian: bool) -> Option<Self> {
        let (kind, unit) = if letter == b'U' { (ElementKind::Text, 4) } else { (ElementKind::Bytes, 1) };
        let is_plain =
            digits.first().is_some_and(|first| *first != b'0') && digits.iter().all(u8::is_ascii_digit);
        let characters: u8 = std::str::from_utf8(digits).ok().filter(|_| is_plain)?.parse().ok()?;
        Some(Self { kind, size: characters.checked_mul(unit)?, big_endian })
    }

    /// Whether its elements are texts.
    pub(super) fn is_text(self) -> bool {
        matches!(self.kind, ElementKind::Text | ElementKind::Bytes)
    }

    /// The number behind the letter: bytes of a number, characters of a text.
    pub(super) fn count(self) -> u8 {
        if self.kind == ElementKind::Text { self.size / 4 } else { self.size }
    }

    /// Letter of the kind.
    pub fn letter(self) -> char {
        match self.kind {
            ElementKind::Bool => 'b',
            ElementKind::Int => 'i',
            ElementKind::Uint => 'u',
            ElementKind::Float => 'f',
            ElementKind::Text => 'U',
            ElementKind::Bytes => 'S',
        }
    }

    /// Byte order as numpy writes it into a type's state.
    pub(super) fn order(self) -> char {
        match (self.size, self.big_endian) {
            _ if self.kind == ElementKind::Bytes => '|',
            (1, _) => '|',
            (_, true) => '>',
            (_, false) => '<',
        }
    }

    /// An integer of exactly one element; `None` if it does not fit 64 signed bits.
    pub(crate) fn integer(self, bytes: &[u8]) -> Option<i64> {
        let mut le = [0u8; 8];
        let slot = le.get_mut(..bytes.len())?;
        slot.copy_from_slice(bytes);
        if self.big_endian {
            slot.reverse();
        }
        let unused = 64 - 8 * bytes.len() as u32;
        let unsigned = u64::from_le_bytes(le);
        match self.kind {
            ElementKind::Int => Some(((unsigned << unused) as i64) >> unused),
            _ => i64::try_from(unsigned).ok(),
        }
    }

    /// Elements as floats. Integers beyond 2⁵³ are rounded.
    pub fn read(self, bytes: &[u8]) -> impl Iterator<Item = f64> {
        bytes.chunks_exact(usize::from(self.size)).map(move |raw| {
            let mut le = [0u8; 8];
            let size = raw.len().min(8);
            let raw = &raw[..size];
            le[..size].copy_from_slice(raw);
            if self.big_endian {
                le[..size].reverse();
            }
            let unsigned = u64::from_le_bytes(le);
            match self.kind {
                ElementKind::Bool => f64::from(u8::from(unsigned != 0)),
                ElementKind::Uint => unsigned as f64,
                ElementKind::Int => {
                    let unused = 64 - 8 * size as u32;
                    (((unsigned << unused) as i64) >> unused) as f64
                }
                ElementKind::Float => match size {
                    8 => f64::from_bits(unsigned),
                    4 => f64::from(f32::from_bits(unsigned as u32)),
                    _ => half(unsigned as u16),
                },
                // No array holds texts.
                ElementKind::Text | ElementKind::Bytes => f64::NAN,
            }
        })
    }

    /// Encodes floats in this type. Numbers that it cannot represent are rounded as `as` does; halves are
    /// rounded towards 0.
    pub(crate) fn write(self, values: impl Iterator<Item = f64>) -> Vec<u8> {
        let mut out = Vec::new();
        for x in values {
            let bits = match (self.kind, self.size) {
                (ElementKind::Bool, _) => u64::from(x != 0.0),
                (ElementKind::Uint, _) => x as u64,
                (ElementKind::Int, _) => x as i64 as u64,
                (ElementKind::Float, 8) => x.to_bits(),
                (ElementKind::Float, 4) => u64::from((x as f32).to_bits()),
                (ElementKind::Float, _) => u64::from(to_half(x as f32)),
                (ElementKind::Text | ElementKind::Bytes, _) => 0,
            };
            let mut raw = bits.to_le_bytes();
            let raw = &mut raw[..usize::from(self.size).min(8)];
            if self.big_endian {
                raw.reverse();
            }
            out.extend_from_slice(raw);
        }
        out
    }
}

impl fmt::Display for Dtype {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let order = if self.big_endian && self.size > 1 { ">" } else { "" };
        write!(f, "{order}{}{}", self.letter(), self.count())
    }
}

/// Value of an IEEE 754 half.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    sign * match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    }
}

/// The nearest half that is not larger in magnitude.
fn to_half(x: f32) -> u16 {
    /// Bits of infinity; halves are ordered like their bits.
    const INFINITY: u16 = 0x7c00;
    let sign = if x.is_sign_negative() { 1 << 15 } else { 0 };
    let magnitude = f64::from(x.abs());
    let (mut low, mut high) = (0, INFINITY);
    while low < high {
        let middle = high - (high - low) / 2;
        if half(middle) <= magnitude { low = middle } else { high = middle - 1 }
    }
    sign | low
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_reads_what_it_wrote() {
        for (name, values) in [
            ("b1", vec![0.0, 1.0]),
            ("i1", vec![-128.0, 127.0]),
            ("u1", vec![0.0, 255.0]),
            ("<i2", vec![-300.0, 300.0]),
            (">i4", vec![-70_000.0, 70_000.0]),
            ("u8", vec![0.0, 1e15]),
            ("f2", vec![-0.5, 1.0, 65504.0, 2f64.powi(-24)]),
            (">f4", vec![1.5, -3.25e7]),
            ("<f8", vec![std::f64::consts::PI, -1e300]),
        ] {
            let dtype = Dtype::from_name(name.as_bytes()).unwrap();
            let bytes = dtype.write(values.iter().copied());
            assert_eq!(bytes.len(), values.len() * usize::from(dtype.size));
            assert_eq!(dtype.read(&bytes).collect::<Vec<_>>(), values, "{name}");
        }
        for (name, size) in [("U15", 60), ("<U1", 4), ("S15", 15)] {
            let dtype = Dtype::from_name(name.as_bytes()).unwrap();
            assert_eq!((dtype.size, dtype.is_text()), (size, true), "{name}");
        }
        for bad in ["O8", "U", "U0", "U64", "U05", "S256", "f3", "f16", "c8", "", "M8[ns]", "V4"] {
            assert_eq!(Dtype::from_name(bad.as_bytes()), None, "{bad}");
        }
    }
}
