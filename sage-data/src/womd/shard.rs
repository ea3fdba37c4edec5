//! Files of records, called shards, as a stream: a file, a pipe or standard input, compressed or not.

use std::{
    io::{self, Cursor, Read, Seek},
    path::{Path, PathBuf},
};

use sage_core::files::{self, Opened};

use super::tfrecord::{
    Failure, FrameError, FrameProblem, Frames, HEADER, Record, Source, begins_with_record, read_up_to,
};
use crate::{
    Error, Format,
    foreign::{self, Foreign},
    gpudrive,
    gzip::{inflated, is_gzip},
};

/// Part of the name of every shard of the Waymo Open Motion Dataset.
const NAME: &str = "tfrecord";
/// Bytes by which the content of a file is recognised.
const START: usize = HEADER;

/// A shard that is read record by record. Memory holds one record.
pub struct ShardReader {
    path: PathBuf,
    frames: Frames,
}

impl ShardReader {
    /// Opens a shard: a file, a pipe, or `-` for standard input, compressed by gzip or not.
    ///
    /// *Errors*: [`Error::Read`]; [`Error::Shard`] for another format, which it names.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let fail = |source| Error::Read { path: path.to_owned(), source };
        match files::open_argument(path).map_err(fail)? {
            Opened::File(mut file, size) => {
                let start = read_start(&mut file).map_err(fail)?;
                file.rewind().map_err(fail)?;
                Self::new(path, &start, Source::File(file, size))
            }
            Opened::Stream(stream) => {
                let (start, stream) = with_start(stream).map_err(fail)?;
                Self::new(path, &start, Source::Stream(stream, false))
            }
        }
    }

    /// A shard whose bytes are in memory. `path` only names it in errors.
    ///
    /// *Errors*: as [`ShardReader::open`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, Error> {
        let start = bytes[..bytes.len().min(START)].to_vec();
        Self::new(path, &start, Source::Stream(Box::new(Cursor::new(bytes)), false))
    }

    /// Recognises the format by the first bytes.
    fn new(path: &Path, start: &[u8], source: Source) -> Result<Self, Error> {
        let fail = |problem| Error::Shard { path: path.to_owned(), record: 0, offset: 0, problem };
        if !is_gzip(start) {
            return match other_format(start) {
                Some(found) => Err(fail(FrameProblem::NotTfRecord(found))),
                None => Ok(Self { path: path.to_owned(), frames: Frames::new(source) }),
            };
        }
        let inflated = Box::new(inflated(source));
        let (start, inflated) = with_start(inflated).map_err(|error| fail(FrameProblem::gzip(&error)))?;
        match other_format(&start) {
            Some(found) => Err(fail(FrameProblem::NotTfRecord(format!(
                "compressed: decompress it first; inside is {found}"
            )))),
            None => Ok(Self { path: path.to_owned(), frames: Frames::new(Source::Stream(inflated, true)) }),
        }
    }

    /// The next record; `None` at the end, and after an error.
    ///
    /// *Errors*: [`Error::Shard`] or [`Error::Read`].
    pub fn next_record(&mut self) -> Option<Result<Record, Error>> {
        let next = self.frames.next(&self.path)?;
        Some(next.map_err(|error| located(&self.path, error)))
    }

    /// Skips the next record, without reading it if the source is a file.
    pub(super) fn skip_record(&mut self) -> Option<Result<(), Error>> {
        let next = self.frames.skip()?;
        Some(next.map_err(|error| located(&self.path, error)))
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

/// The first bytes of a stream, and the whole stream.
fn with_start(mut stream: Box<dyn Read + Send>) -> io::Result<(Vec<u8>, Box<dyn Read + Send>)> {
    let start = read_start(&mut stream)?;
    Ok((start.clone(), Box::new(Cursor::new(start).chain(stream))))
}

fn read_start(source: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut start = [0; START];
    let found = read_up_to(source, &mut start)?;
    Ok(start[..found].to_vec())
}

/// Name of the format of a file that is no shard; `None` for a shard, and for one that may be damaged.
fn other_format(start: &[u8]) -> Option<String> {
    if begins_with_record(start) {
        return None;
    }
    let (what, ending) = match Format::of(start) {
        Some(Format::Pickle) => ("a pickle", "pkl"),
        Some(Format::Native) => ("a native scene file", "safetensors"),
        Some(Format::GpuDrive) => ("JSON of GPUDrive", "json"),
        _ if is_gzip(start) => ("a gzip file", "gz"),
        _ => {
            let Foreign { what, remedy } = foreign::by_magic(start)?;
            return Some(format!("{what}; {remedy}"));
        }
    };
    Some(format!("{what}, which is no TFRecord file; give it a name that ends in .{ending}"))
}

/// A shard, or bytes of another format.
pub(crate) enum Open {
    Shard(ShardReader),
    Other(Box<dyn Read + Send>),
}

/// Opens a file or a pipe. A pipe may hold any format.
///
/// *Errors*: as [`ShardReader::open`].
pub(crate) fn open(path: &Path) -> Result<Open, Error> {
    let fail = |source| Error::Read { path: path.to_owned(), source };
    match files::open_argument(path).map_err(fail)? {
        Opened::Stream(stream) => {
            let (start, stream) = with_start(stream).map_err(fail)?;
            if !is_start(&start) {
                return Ok(Open::Other(stream));
            }
            ShardReader::new(path, &start, Source::Stream(stream, false)).map(Open::Shard)
        }
        Opened::File(..) => ShardReader::open(path).map(Open::Shard),
    }
}

fn is_start(start: &[u8]) -> bool {
    is_gzip(start) || Format::of(start) == Some(Format::TfRecord)
}

fn located(path: &Path, error: FrameError) -> Error {
    let FrameError { record, offset, problem } = error;
    match problem {
        Failure::Frame(problem) => Error::Shard { path: path.to_owned(), record, offset, problem },
        Failure::Read(source) => Error::Read { path: path.to_owned(), source },
    }
}

/// True if a regular file is a shard: by its name, or by its first bytes unless it is named like another format.
pub fn is_shard(path: &Path) -> bool {
    let is_other = |ending: &std::ffi::OsStr| ending == "pkl" || ending == "safetensors" || ending == "json";
    if path.extension().is_some_and(is_other) || gpudrive::is_compressed_name(path) {
        return false;
    }
    let is_file = std::fs::metadata(path).is_ok_and(|found| found.is_file());
    is_file
        && (is_shard_name(path) || files::read_start(path, START as u64).is_ok_and(|start| is_start(&start)))
}

/// True if a path names a shard, as the files of the data set are named: it holds `tfrecord`, and then at most the
/// number of the shard and `.gz`.
pub(crate) fn is_shard_name(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let Some((_, rest)) = name.rsplit_once(NAME) else { return false };
    let rest = rest.strip_suffix(".gz").unwrap_or(rest);
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let numbers = rest.strip_prefix('-').and_then(|rest| rest.split_once("-of-"));
    rest.is_empty() || numbers.is_some_and(|(number, of)| is_number(number) && is_number(of))
}

/// Number of scenes in a file; `None` for a compressed shard, which would have to be read.
pub(crate) fn count(file: &Path) -> Option<usize> {
    if !is_shard(file) {
        return Some(1);
    }
    let start = files::read_start(file, START as u64).unwrap_or_default();
    // A shard that cannot be read counts as one failure.
    if is_gzip(&start) { None } else { Some(count_records(file).unwrap_or(1)) }
}

/// Number of records of a shard, the last of which may be cut or damaged.
pub(super) fn count_records(shard: &Path) -> Result<usize, Error> {
    let mut records = ShardReader::open(shard)?;
    let mut count = 0;
    while let Some(skipped) = records.skip_record() {
        if count == 0 {
            skipped?;
        }
        count += 1;
    }
    Ok(count)
}
