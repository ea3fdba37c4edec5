//! What a scene file is, by its first bytes.

/// Formats of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A Python pickle of protocol 2 to 5.
    Pickle,
    /// A native file: safetensors.
    Native,
}

impl Format {
    /// The format of a file; `None` if it is neither. The only place that decides it.
    ///
    /// Whatever begins like a pickle is one and nothing else: Python would take it for one, and a file
    /// that is data to one reader and a program to another is how strangers get in.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [0x80, 2..=5, ..] => Some(Self::Pickle),
            // The length of the header in eight bytes, then its opening brace.
            [_, _, _, _, _, _, _, _, b'{', ..] => Some(Self::Native),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_begins_like_a_pickle_is_one() {
        assert_eq!(Format::of(b"\x80\x04N."), Some(Format::Pickle));
        assert_eq!(Format::of(b"\x80\x04G\0\0\0\0\0{\"a\": 1}"), Some(Format::Pickle));
        assert_eq!(Format::of(b"\x88\x04\0\0\0\0\0\0{}"), Some(Format::Native));
        assert_eq!(Format::of(b"\x80\x06\0\0\0\0\0\0{}"), Some(Format::Native));
        for neither in [&b""[..], b"\x80", b"\x80\x01N.", b"{}", b"no scene at all"] {
            assert_eq!(Format::of(neither), None);
        }
    }
}
