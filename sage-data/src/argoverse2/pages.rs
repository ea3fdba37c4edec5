//! Checks the pages of a Parquet file before they are decompressed: a page of a few bytes may declare gigabytes.
//!
//! The header of a page is a struct in Thrift's compact protocol; two of its fields are the sizes.

/// Most bytes of a page after decompression. Pages of real files have 20 kB to 1 MB.
const MOST_PAGE: u64 = 8 << 20;
/// Most levels of structs in a header.
const MOST_LEVELS: usize = 8;

/// Sums the decompressed sizes of the pages of a column chunk.
///
/// *Errors*: what is wrong with a page.
pub(super) fn decompressed_size(chunk: &[u8]) -> Result<u64, String> {
    let (mut at, mut sum) = (0, 0u64);
    while at < chunk.len() {
        let mut header = Thrift { bytes: chunk, at };
        let sizes = header
            .page_header()
            .ok_or_else(|| format!("the header of a page at byte {at} of it is damaged"))?;
        let [decompressed, compressed] = sizes.map(|size| u64::try_from(size).unwrap_or(u64::MAX));
        if decompressed > MOST_PAGE {
            return Err(format!("a page of {decompressed} bytes; at most {MOST_PAGE} are read"));
        }
        let start = header.at;
        let end = usize::try_from(compressed).ok().and_then(|size| start.checked_add(size));
        let body = end.and_then(|end| chunk.get(start..end));
        let body = body.ok_or_else(|| format!("a page at byte {at} of it goes beyond its end"))?;
        sum += decompressed;
        at = start + body.len();
    }
    Ok(sum)
}

struct Thrift<'b> {
    bytes: &'b [u8],
    at: usize,
}

impl Thrift<'_> {
    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn integer(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    fn skip_bytes(&mut self, count: u64) -> Option<()> {
        let end = self.at.checked_add(usize::try_from(count).ok()?)?;
        self.at = (end <= self.bytes.len()).then_some(end)?;
        Some(())
    }

    /// Decompressed and compressed size of the page whose header is here. Goes to its end.
    fn page_header(&mut self) -> Option<[i64; 2]> {
        let (mut id, mut sizes) = (0i64, [None; 2]);
        loop {
            let head = self.byte()?;
            if head == 0 {
                return Some([sizes[0]?, sizes[1]?]);
            }
            id = if head >> 4 == 0 { self.integer()? } else { id + i64::from(head >> 4) };
            match (id, head & 15) {
                (2 | 3, 5) => sizes[id as usize - 2] = Some(self.integer()?),
                (_, kind) => self.skip(kind, 0)?,
            }
        }
    }

    /// Skips a value of a type.
    fn skip(&mut self, kind: u8, level: usize) -> Option<()> {
        if level > MOST_LEVELS {
            return None;
        }
        match kind {
            // Bools are part of their head.
            1 | 2 => Some(()),
            3 => self.skip_bytes(1),
            4..=6 => self.varint().map(|_| ()),
            7 => self.skip_bytes(8),
            8 => {
                let length = self.varint()?;
                self.skip_bytes(length)
            }
            9 | 10 => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.varint()? } else { u64::from(head >> 4) };
                // Bools have a byte in a list.
                let of = if matches!(head & 15, 1 | 2) { 3 } else { head & 15 };
                (0..count).try_for_each(|_| self.skip(of, level + 1))
            }
            12 => loop {
                let head = self.byte()?;
                if head == 0 {
                    return Some(());
                }
                if head >> 4 == 0 {
                    self.integer()?;
                }
                self.skip(head & 15, level + 1)?;
            },
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header with type 0, the sizes, and a nested struct.
    fn header(decompressed: u8, compressed: u8) -> Vec<u8> {
        vec![0x15, 0, 0x15, 2 * decompressed, 0x15, 2 * compressed, 0x2c, 0x15, 4, 0x18, 1, b'x', 0, 0]
    }

    #[test]
    fn pages_are_found_one_after_another() {
        let chunk = [header(5, 3), vec![7; 3], header(9, 2), vec![7; 2]].concat();
        assert_eq!(decompressed_size(&chunk), Ok(14));
        for cut in 1..chunk.len() {
            if cut != header(5, 3).len() + 3 {
                assert!(decompressed_size(&chunk[..cut]).is_err(), "{cut}");
            }
        }
    }

    #[test]
    fn large_pages_are_refused() {
        // 2^30 bytes.
        let head = [0x15, 0, 0x15, 0x80, 0x80, 0x80, 0x80, 0x08, 0x15, 2, 0, 7];
        assert!(decompressed_size(&head).unwrap_err().contains("1073741824 bytes"));
    }
}
