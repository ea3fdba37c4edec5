//! TFRecord files: records one after another, each with the checksums of its length and of its data.
//!
//! | bytes | content |
//! | --- | --- |
//! | 8 | length n of the data, little-endian |
//! | 4 | masked CRC-32C of the length |
//! | n | data |
//! | 4 | masked CRC-32C of the data |
//!
//! There is no header and no index. A file that ends inside a record is truncated; the records before it are whole.

use std::{
    fs::File,
    io::{self, ErrorKind, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use crate::gzip::{MAX_EXPANSION, is_expansion};

/// Bytes before the data of a record.
pub(super) const HEADER: usize = 12;
/// Bytes after the data of a record.
pub(super) const FOOTER: usize = 4;
/// Limit of the length of a record, bytes. Records without lidar have about 1 MB.
pub(crate) const MAX_RECORD: u64 = 64 << 20;
/// Limit of the number of records of a file. Waymo's shards have about 500.
pub(super) const MAX_RECORDS: usize = 100_000;
/// Records without data, one after another, that end a file. No scene is empty.
const MOST_EMPTY: usize = 100;

/// The checksum of TFRecord: a rotated CRC-32C with a constant added, so that data that holds checksums has none of
/// its own.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// What is wrong with a record's frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameProblem {
    /// A file without records.
    #[error("the file is empty")]
    Empty,
    /// A file that is no TFRecord file.
    #[error("{0}")]
    NotTfRecord(String),
    /// The file ends inside a record.
    #[error("the file is truncated: it ends after {found} of {needed} bytes of this record; copy it again")]
    Truncated {
        /// Bytes of the record.
        found: u64,
        /// Bytes that the record needs.
        needed: u64,
    },
    /// A length with a right checksum that no record has.
    #[error("the record has a length of {0} bytes; no scene has more than {MAX_RECORD}")]
    Length(u64),
    /// The checksum of the length is wrong, so the next record cannot be found either.
    #[error(
        "the checksum of the record's length is wrong: the file is damaged from here on, or is no TFRecord file; copy it again"
    )]
    LengthChecksum,
    /// The checksum of the data is wrong.
    #[error("the checksum of the record's data is wrong: the record is damaged; copy the file again")]
    DataChecksum,
    /// More records than any shard has.
    #[error("the file has more than {MAX_RECORDS} records; split it")]
    Records,
    /// A stretch of records without data.
    #[error(
        "{MOST_EMPTY} records one after another are empty: the file is damaged from here on; copy it again"
    )]
    EmptyRecords,
    /// The compressed data is damaged.
    #[error("the gzip data is damaged: {0}; copy the file again")]
    Gzip(String),
    /// The compressed data expands more than any shard does.
    #[error(
        "the gzip data expands more than {MAX_EXPANSION} times; decompress the file first if it is no mistake"
    )]
    Expansion,
}

impl FrameProblem {
    /// True if the records after this one can still be read.
    pub fn is_skippable(&self) -> bool {
        matches!(self, Self::DataChecksum)
    }
}

/// The record in whose frame a problem was found.
#[derive(Debug)]
pub(super) struct FrameError {
    pub(super) record: usize,
    /// Offset of the record in the file, after decompression, bytes.
    pub(super) offset: u64,
    pub(super) problem: Failure,
}

/// Cause of a failed read.
#[derive(Debug)]
pub(super) enum Failure {
    Frame(FrameProblem),
    /// The operating system could not read.
    Read(io::Error),
}

/// A record with its frame. The checksum of its data is not verified yet.
#[derive(Clone)]
pub struct Record {
    /// The file.
    pub shard: PathBuf,
    /// Number of the record in its file, from 0.
    pub number: usize,
    /// Offset of the record in the file, after decompression, bytes.
    pub offset: u64,
    /// The record with its frame.
    pub framed: Vec<u8>,
}

/// The data of a framed record whose checksums are right.
pub(super) fn checked_data(framed: &[u8]) -> Result<&[u8], FrameProblem> {
    let length = data_length(framed)? as usize;
    let needed = (HEADER + length + FOOTER) as u64;
    let found = framed.len() as u64;
    let (Some(data), Some(footer)) = (
        framed.get(HEADER..HEADER + length),
        framed.get(HEADER + length..).and_then(|rest| rest.first_chunk()),
    ) else {
        return Err(FrameProblem::Truncated { found, needed });
    };
    if u32::from_le_bytes(*footer) != masked_crc(data) {
        return Err(FrameProblem::DataChecksum);
    }
    Ok(data)
}

/// The length of a record's data from its header.
fn data_length(header: &[u8]) -> Result<u64, FrameProblem> {
    let truncated =
        || FrameProblem::Truncated { found: header.len() as u64, needed: (HEADER + FOOTER) as u64 };
    let length: &[u8; 8] = header.first_chunk().ok_or_else(truncated)?;
    let checksum: &[u8; 4] = header[8..].first_chunk().ok_or_else(truncated)?;
    if u32::from_le_bytes(*checksum) != masked_crc(length) {
        return Err(FrameProblem::LengthChecksum);
    }
    match u64::from_le_bytes(*length) {
        length if length <= MAX_RECORD => Ok(length),
        length => Err(FrameProblem::Length(length)),
    }
}

/// Length of a record with its frame, from its header.
pub(super) fn frame_length(framed: &[u8]) -> Result<u64, FrameProblem> {
    Ok(data_length(framed)? + (HEADER + FOOTER) as u64)
}

/// True if a file begins with the header of a record.
pub(crate) fn begins_with_record(bytes: &[u8]) -> bool {
    !matches!(data_length(bytes), Err(FrameProblem::LengthChecksum | FrameProblem::Truncated { .. }))
}

/// A record around some data, with both checksums.
pub fn frame(data: &[u8]) -> Vec<u8> {
    let mut framed = Vec::with_capacity(HEADER + data.len() + FOOTER);
    // Writing into memory does not fail.
    let _ = write_frame(&mut framed, data);
    framed
}

/// Writes a record around some data. Returns its length, bytes.
///
/// *Errors*: those of `out`.
pub fn write_frame(out: &mut (impl Write + ?Sized), data: &[u8]) -> io::Result<u64> {
    let length = (data.len() as u64).to_le_bytes();
    out.write_all(&length)?;
    out.write_all(&masked_crc(&length).to_le_bytes())?;
    out.write_all(data)?;
    out.write_all(&masked_crc(data).to_le_bytes())?;
    Ok((HEADER + data.len() + FOOTER) as u64)
}

/// Bytes of a file, a pipe, or a decompressor.
pub(super) enum Source {
    /// A regular file and its size, bytes.
    File(File, u64),
    /// Bytes that can be read only once, and whether a decompressor makes them.
    Stream(Box<dyn Read + Send>, bool),
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file, _) => file.read(buffer),
            Self::Stream(stream, _) => stream.read(buffer),
        }
    }
}

impl Source {
    /// Skips at most `length` bytes. Returns how many there were.
    fn skip(&mut self, length: u64) -> io::Result<u64> {
        match self {
            Self::File(file, size) => {
                let left = size.saturating_sub(file.stream_position()?);
                let skipped = length.min(left);
                file.seek(SeekFrom::Current(skipped as i64))?;
                Ok(skipped)
            }
            Self::Stream(stream, _) => io::copy(&mut stream.take(length), &mut io::sink()),
        }
    }
}

/// Reads the records of a file one after another. Memory holds one record.
pub(super) struct Frames {
    source: Source,
    number: usize,
    offset: u64,
    /// Number of empty records directly before this one.
    empty: usize,
    has_failed: bool,
}

impl Frames {
    pub(super) fn new(source: Source) -> Self {
        Self { source, number: 0, offset: 0, empty: 0, has_failed: false }
    }

    /// The next record; `None` at the end of the file, and after an error.
    pub(super) fn next(&mut self, shard: &Path) -> Option<Result<Record, FrameError>> {
        let (number, offset) = (self.number, self.offset);
        let framed = self.advance(read_record)?;
        Some(framed.map(|framed| Record { shard: shard.to_owned(), number, offset, framed }))
    }

    /// Skips the next record; `None` as for [`Frames::next`].
    pub(super) fn skip(&mut self) -> Option<Result<(), FrameError>> {
        self.advance(|source, _, rest| source.skip(rest).map(|skipped| ((), skipped)))
    }

    /// Reads a header, and by `read` the bytes after it: it returns a value and their number.
    fn advance<T>(
        &mut self,
        read: impl FnOnce(&mut Source, &[u8; HEADER], u64) -> io::Result<(T, u64)>,
    ) -> Option<Result<T, FrameError>> {
        if self.has_failed {
            return None;
        }
        let outcome = self.try_advance(read).transpose()?;
        Some(match outcome {
            Ok((value, length)) => {
                self.number += 1;
                self.offset += length;
                Ok(value)
            }
            Err(problem) => {
                self.has_failed = true;
                Err(FrameError { record: self.number, offset: self.offset, problem })
            }
        })
    }

    fn try_advance<T>(
        &mut self,
        read: impl FnOnce(&mut Source, &[u8; HEADER], u64) -> io::Result<(T, u64)>,
    ) -> Result<Option<(T, u64)>, Failure> {
        let mut header = [0; HEADER];
        let found = read_up_to(&mut self.source, &mut header).map_err(|error| self.failure(error))?;
        match found {
            0 if self.number == 0 => return Err(Failure::Frame(FrameProblem::Empty)),
            0 => return Ok(None),
            _ => {}
        }
        let length = data_length(&header[..found]).map_err(Failure::Frame)?;
        self.empty = if length == 0 { self.empty + 1 } else { 0 };
        if self.empty > MOST_EMPTY {
            return Err(Failure::Frame(FrameProblem::EmptyRecords));
        }
        if self.number == MAX_RECORDS {
            return Err(Failure::Frame(FrameProblem::Records));
        }
        let needed = length + FOOTER as u64;
        let (value, read) = read(&mut self.source, &header, needed).map_err(|error| self.failure(error))?;
        if read < needed {
            let [found, needed] = [read, needed].map(|n| n + HEADER as u64);
            return Err(Failure::Frame(FrameProblem::Truncated { found, needed }));
        }
        Ok(Some((value, HEADER as u64 + needed)))
    }

    fn failure(&self, error: io::Error) -> Failure {
        match self.source {
            // The decompressor has no errors of the system of its own kind.
            Source::Stream(_, true) => Failure::Frame(FrameProblem::gzip(&error)),
            _ => Failure::Read(error),
        }
    }
}

impl FrameProblem {
    /// The error of a decompressor.
    pub(super) fn gzip(error: &io::Error) -> Self {
        if is_expansion(error) {
            return Self::Expansion;
        }
        Self::Gzip(match error.kind() {
            ErrorKind::UnexpectedEof => "it is truncated".to_owned(),
            _ => error.to_string(),
        })
    }
}

/// A whole record from its header on. The buffer grows with what the file holds, not with the declared length.
fn read_record(source: &mut Source, header: &[u8; HEADER], rest: u64) -> io::Result<(Vec<u8>, u64)> {
    /// Size of most records; larger ones grow by doubling.
    const USUAL: u64 = 2 << 20;
    let mut framed = Vec::with_capacity(HEADER + rest.min(USUAL) as usize);
    framed.extend(header);
    let read = source.take(rest).read_to_end(&mut framed)?;
    Ok((framed, read as u64))
}

/// Reads until the buffer is full or the source ends. Returns the number of bytes.
pub(super) fn read_up_to(source: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut found = 0;
    while found < buffer.len() {
        match source.read(&mut buffer[found..]) {
            Ok(0) => break,
            Ok(n) => found += n,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_the_format() {
        assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
        // The header of an empty record, as TensorFlow writes it.
        assert_eq!(frame(b"")[..12], [0, 0, 0, 0, 0, 0, 0, 0, 0x29, 0x03, 0x98, 0x07]);
    }

    #[test]
    fn records_are_read_in_order_and_cut_ones_are_errors() {
        let file = [frame(b"first"), frame(b""), frame(&[7; 5000])].concat();
        for cut in 0..=file.len() {
            let mut frames =
                Frames::new(Source::Stream(Box::new(io::Cursor::new(file[..cut].to_vec())), false));
            let mut whole = Vec::new();
            let end = loop {
                match frames.next(Path::new("some")) {
                    Some(Ok(record)) => whole.push(checked_data(&record.framed).unwrap().len()),
                    Some(Err(error)) => break Some(error.problem),
                    None => break None,
                }
            };
            let ends = [21, 37, 37 + 5016];
            let expected = ends.iter().filter(|end| **end <= cut).count();
            assert_eq!(whole, [5, 0, 5000][..expected], "cut at {cut}");
            let is_end = ends.contains(&cut);
            assert_eq!(end.is_none(), is_end, "cut at {cut}: {end:?}");
        }
    }

    #[test]
    fn empty_records_and_their_number_are_limited() {
        let ends = |file: Vec<u8>| {
            let mut frames = Frames::new(Source::Stream(Box::new(io::Cursor::new(file)), false));
            let mut count = 0;
            loop {
                match frames.skip() {
                    Some(Ok(())) => count += 1,
                    Some(Err(error)) => break (count, format!("{:?}", error.problem)),
                    None => break (count, String::new()),
                }
            }
        };
        assert_eq!(ends(frame(b"").repeat(MOST_EMPTY)), (MOST_EMPTY, String::new()));
        assert_eq!(ends(frame(b"").repeat(2 * MOST_EMPTY)), (MOST_EMPTY, "Frame(EmptyRecords)".to_owned()));
        assert_eq!(ends(frame(b"x").repeat(MAX_RECORDS)), (MAX_RECORDS, String::new()));
        assert_eq!(ends(frame(b"x").repeat(MAX_RECORDS + 1)), (MAX_RECORDS, "Frame(Records)".to_owned()));
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let good = frame(b"some data of a record");
        assert!(checked_data(&good).is_ok());
        for bit in 0..8 * good.len() {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(checked_data(&bad).is_err(), "bit {bit}");
        }
    }
}
