//! Checks the pages of a Parquet file before they are read: a page of a few bytes may declare gigabytes, and the reader
//! allocates what is declared.
//!
//! The header of a page is a struct in Thrift's compact protocol with the two sizes, and a struct within it for the kind of
//! page, with the number of values and their encoding.

/// Most bytes of a page after decompression. Pages of real files have 20 kB to 1 MB.
const MOST_PAGE: u64 = 8 << 20;
/// Encodings whose values take no more memory than the page: plain, dictionaries and runs. Of the others a page may declare any
/// number of lengths.
const ENCODINGS: [i64; 4] = [0, 2, 3, 8];
/// Fields of the header that are structs: data pages of both versions, and dictionaries.
const DATA: i64 = 5;
const DICTIONARY: i64 = 7;
const DATA_2: i64 = 8;
/// Most levels of structs in a header.
const MOST_LEVELS: usize = 8;

/// Checks the pages of a column chunk with a number of rows, and sums their decompressed sizes.
///
/// *Errors*: what is wrong with a page.
pub(super) fn decompressed_size(chunk: &[u8], rows: u64) -> Result<u64, String> {
    let (mut at, mut sum, mut values) = (0, 0u64, 0u64);
    while at < chunk.len() {
        let mut header = Thrift { bytes: chunk, at };
        let page = header
            .page_header()
            .ok_or_else(|| format!("the header of a page at byte {at} of it is damaged"))?;
        let [decompressed, compressed] = page.sizes.map(|size| u64::try_from(size).unwrap_or(u64::MAX));
        if decompressed > MOST_PAGE {
            return Err(format!("a page of {decompressed} bytes; at most {MOST_PAGE} are read"));
        }
        for kind in &page.kinds {
            let count = u64::try_from(kind.values).unwrap_or(u64::MAX);
            let most = if kind.is_dictionary { decompressed } else { rows.saturating_sub(values) };
            if count > most {
                return Err(format!("a page of {} values; at most {most} are there", kind.values));
            }
            if !ENCODINGS.contains(&kind.encoding) {
                return Err(format!(
                    "a page in the encoding {}; plain values and dictionaries are read",
                    kind.encoding
                ));
            }
            values += if kind.is_dictionary { 0 } else { count };
        }
        if page.kinds.is_empty() {
            return Err(format!("a page at byte {at} of it holds no values"));
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

/// What the header of a page says.
struct PageHeader {
    /// Decompressed and compressed.
    sizes: [i64; 2],
    /// One, in a whole file.
    kinds: Vec<PageKind>,
}

struct PageKind {
    is_dictionary: bool,
    values: i64,
    encoding: i64,
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

    /// The header that is here. Goes to its end.
    fn page_header(&mut self) -> Option<PageHeader> {
        let (mut id, mut sizes, mut kinds) = (0i64, [None; 2], Vec::new());
        while let Some((next, kind)) = self.field(id)? {
            id = next;
            match (id, kind) {
                (2 | 3, 5) => sizes[id as usize - 2] = Some(self.integer()?),
                (DATA | DICTIONARY | DATA_2, 12) => kinds.push(self.page_kind(id)?),
                (_, kind) => self.skip(kind, 0)?,
            }
        }
        Some(PageHeader { sizes: [sizes[0]?, sizes[1]?], kinds })
    }

    /// The struct of a kind of page, which is the field `of` of the header.
    fn page_kind(&mut self, of: i64) -> Option<PageKind> {
        let place_of_encoding = if of == DATA_2 { 4 } else { 2 };
        let (mut id, mut values, mut encoding) = (0i64, None, None);
        while let Some((next, kind)) = self.field(id)? {
            id = next;
            match (id, kind) {
                (1, 5) => values = Some(self.integer()?),
                (_, 5) if id == place_of_encoding => encoding = Some(self.integer()?),
                (_, kind) => self.skip(kind, 1)?,
            }
        }
        Some(PageKind { is_dictionary: of == DICTIONARY, values: values?, encoding: encoding? })
    }

    /// Number and type of the next field after one; the inner `None` at the end of the struct.
    #[expect(clippy::option_option, reason = "an end is no damage")]
    fn field(&mut self, before: i64) -> Option<Option<(i64, u8)>> {
        let head = self.byte()?;
        if head == 0 {
            return Some(None);
        }
        let id = if head >> 4 == 0 { self.integer()? } else { before.checked_add(i64::from(head >> 4))? };
        Some(Some((id, head & 15)))
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

    /// A header of a data page with type 0, the sizes, and two plain values.
    fn header(decompressed: u8, compressed: u8) -> Vec<u8> {
        page(decompressed, compressed, 0x2c, &[4], 0)
    }

    /// A header with a struct for the kind of page; numbers are in zigzag.
    fn page(decompressed: u8, compressed: u8, kind: u8, values: &[u8], encoding: u8) -> Vec<u8> {
        let start = [0x15, 0, 0x15, 2 * decompressed, 0x15, 2 * compressed, kind, 0x15];
        [&start[..], values, &[0x15, encoding, 0x18, 1, b'x', 0, 0]].concat()
    }

    #[test]
    fn pages_are_found_one_after_another() {
        let chunk = [header(5, 3), vec![7; 3], header(9, 2), vec![7; 2]].concat();
        assert_eq!(decompressed_size(&chunk, 4), Ok(14));
        for cut in 1..chunk.len() {
            if cut != header(5, 3).len() + 3 {
                assert!(decompressed_size(&chunk[..cut], 4).is_err(), "{cut}");
            }
        }
    }

    #[test]
    fn large_pages_are_refused() {
        // 2^30 bytes.
        let head = [0x15, 0, 0x15, 0x80, 0x80, 0x80, 0x80, 0x08, 0x15, 2, 0, 7];
        assert!(decompressed_size(&head, 4).unwrap_err().contains("1073741824 bytes"));
    }

    #[test]
    fn counts_beyond_the_rows_and_the_bytes_are_refused() {
        let wrong = |header: Vec<u8>| decompressed_size(&[header, vec![7; 3]].concat(), 2).unwrap_err();
        // 2^31 values of a dictionary of five bytes, three values of two rows, lengths as differences.
        let many = [0x80, 0x80, 0x80, 0x80, 0x10];
        assert!(wrong(page(5, 3, 0x4c, &many, 0)).contains("2147483648 values; at most 5"));
        assert!(wrong(page(5, 3, 0x2c, &[6], 0)).contains("3 values; at most 2"));
        assert!(wrong(page(5, 3, 0x2c, &[4], 12)).contains("encoding 6"));
        // A negative number, and a page without values.
        assert!(wrong(page(5, 3, 0x2c, &[1], 0)).contains("-1 values"));
        assert!(wrong(vec![0x15, 0, 0x15, 10, 0x15, 6, 0]).contains("holds no values"));
        assert!(decompressed_size(&[page(5, 3, 0x4c, &[10], 0), vec![7; 3]].concat(), 2).is_ok());
    }
}
