//! Files of records, called shards: one after another as a stream, or one by its number or id.
//!
//! A path such as `validation.tfrecord-00000-of-00150#3` names the record with number 3 of a shard, and
//! `…#5060f881443f897e` the scene with this id.

use std::{
    io::{self, BufReader, Cursor, Read, Seek},
    path::{Path, PathBuf},
};

use flate2::read::MultiGzDecoder;
use sage_core::files::{self, Opened};

use super::{
    decode,
    tfrecord::{
        FOOTER, Failure, FrameError, FrameProblem, Frames, HEADER, Record, Source, begins_with_record,
        checked_data, read_up_to,
    },
};
use crate::{Error, Format};

/// Part of the name of every shard of the Waymo Open Motion Dataset.
const NAME: &str = "tfrecord";
/// Bytes by which the content of a file is recognised.
const START: usize = HEADER;

/// A shard that is read record by record. Memory holds one record.
pub struct Shard {
    path: PathBuf,
    frames: Frames,
}

impl Shard {
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
    /// *Errors*: as [`Shard::open`].
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
        let inflated = Box::new(MultiGzDecoder::new(BufReader::new(source)));
        let (start, inflated) = with_start(inflated).map_err(|error| fail(FrameProblem::gzip(&error)))?;
        match other_format(&start) {
            Some(found) => {
                Err(fail(FrameProblem::NotTfRecord(format!("gzip of {found}; decompress it first"))))
            }
            None => Ok(Self { path: path.to_owned(), frames: Frames::new(Source::Stream(inflated, true)) }),
        }
    }

    /// The next record; `None` at the end, and after an error.
    ///
    /// *Errors*: [`Error::Shard`] or [`Error::Read`].
    pub fn next_record(&mut self) -> Option<Result<Record, Error>> {
        let next = self.frames.next()?;
        Some(next.map_err(|error| located(&self.path, error)))
    }

    /// Skips the next record, without reading it if the source is a file.
    fn skip_record(&mut self) -> Option<Result<(), Error>> {
        let next = self.frames.skip()?;
        Some(next.map_err(|error| located(&self.path, error)))
    }

    /// The file.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Path of one of its records.
    pub fn path_of(&self, record: &Record) -> PathBuf {
        record_path(&self.path, record.number)
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

/// True if a file is compressed by gzip.
pub(crate) fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// Name of the format of a file that is no shard; `None` for a shard, and for one that may be damaged.
fn other_format(start: &[u8]) -> Option<String> {
    if begins_with_record(start) {
        return None;
    }
    let (what, ending) = match Format::of(start) {
        Some(Format::Pickle) => ("a pickle", "pkl"),
        Some(Format::Native) => ("a native scene file", "safetensors"),
        _ if is_gzip(start) => ("a gzip file", "gz"),
        _ => return None,
    };
    Some(format!("{what}, which is no TFRecord file; its name must end in .{ending}"))
}

/// A shard, or bytes of another format.
pub(crate) enum Open {
    Shard(Shard),
    Other(Box<dyn Read + Send>),
}

/// Opens a file or a pipe. A pipe may hold any format.
///
/// *Errors*: as [`Shard::open`].
pub(crate) fn open(path: &Path) -> Result<Open, Error> {
    let fail = |source| Error::Read { path: path.to_owned(), source };
    match files::open_argument(path).map_err(fail)? {
        Opened::Stream(stream) => {
            let (start, stream) = with_start(stream).map_err(fail)?;
            if !is_start(&start) {
                return Ok(Open::Other(stream));
            }
            Shard::new(path, &start, Source::Stream(stream, false)).map(Open::Shard)
        }
        Opened::File(..) => Shard::open(path).map(Open::Shard),
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

/// True if a regular file is a shard: by its name, or by its first bytes.
pub fn is_shard(path: &Path) -> bool {
    let is_file = std::fs::metadata(path).is_ok_and(|found| found.is_file());
    is_file
        && (is_shard_name(path) || files::read_start(path, START as u64).is_ok_and(|start| is_start(&start)))
}

/// True if a path names a shard, as the files of the data set are named: it holds `tfrecord`.
pub(crate) fn is_shard_name(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().contains(NAME))
}

/// Path of a record by its number.
fn record_path(shard: &Path, number: usize) -> PathBuf {
    let mut path = shard.as_os_str().to_owned();
    path.push(format!("#{number}"));
    path.into()
}

/// The shard of a path such as `SHARD#3`; other paths as they are.
pub fn shard_of(path: &Path) -> PathBuf {
    let text = path.to_string_lossy();
    text.rsplit_once('#').map_or_else(|| path.to_owned(), |(shard, _)| PathBuf::from(shard))
}

/// The shard and the record that a path such as `SHARD#3` names; `None` for other paths.
pub(crate) fn split_path(path: &Path) -> Option<(PathBuf, String)> {
    let (shard, record) = path.to_str()?.rsplit_once('#')?;
    // A record, or a file whose name holds a `#`.
    let names_record = !record.is_empty() && !path.exists() && is_shard(Path::new(shard));
    names_record.then(|| (PathBuf::from(shard), record.to_owned()))
}

/// True if a path names a record of a shard, such as `SHARD#3`.
pub fn is_record_path(path: &Path) -> bool {
    split_path(path).is_some()
}

/// Number of scenes in a file; `None` for a compressed shard, which would have to be read.
pub(crate) fn count(file: &Path) -> Option<usize> {
    if !is_shard(file) {
        return Some(1);
    }
    let start = files::read_start(file, START as u64).unwrap_or_default();
    // A shard that cannot be read counts as one failure.
    if is_gzip(&start) { None } else { Some(record_paths(file).map_or(1, |paths| paths.len())) }
}

/// Paths of all records of a shard. The last one may be cut or damaged, which reading it reports.
///
/// *Errors*: [`Error::Read`], or [`Error::Shard`] if not even the first record is there.
pub(crate) fn record_paths(shard: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut records = Shard::open(shard)?;
    let mut paths = Vec::new();
    while let Some(skipped) = records.skip_record() {
        if paths.is_empty() {
            skipped?;
        }
        paths.push(record_path(shard, paths.len()));
    }
    Ok(paths)
}

/// The path of a record by its number, for one that names it by its id.
///
/// *Errors*: there is no such record; [`Error::Read`] or [`Error::Shard`].
pub(crate) fn numbered(path: &Path) -> Result<PathBuf, Error> {
    let Some((shard, wanted)) = split_path(path) else { return Ok(path.to_owned()) };
    let count = record_paths(&shard)?.len();
    if let Some(number) = wanted.parse().ok().filter(|number| *number < count) {
        return Ok(record_path(&shard, number));
    }
    let mut records = Shard::open(&shard)?;
    while let Some(record) = records.next_record() {
        let record = record?;
        if checked_data(&record.framed).is_ok_and(|data| decode::id(data).is_ok_and(|id| id == wanted)) {
            return Ok(records.path_of(&record));
        }
    }
    Err(Error::Field {
        path: shard,
        field: format!("#{wanted}"),
        found: "no record of the shard".to_owned(),
        expected: format!("a number from 0 to {} or the id of one of its scenes", count.saturating_sub(1)),
    })
}

/// A record with its frame, by a path such as `SHARD#3`, or the only record of a shard.
///
/// *Errors*: as [`numbered`]; several records.
pub(crate) fn read_framed(path: &Path) -> Result<Vec<u8>, Error> {
    let Some((shard, wanted)) = split_path(path) else {
        return match record_paths(path)?.len() {
            1 => read_number(path, 0)?.ok_or_else(|| several(path, 0)),
            count => Err(several(path, count)),
        };
    };
    let found = wanted.parse().ok().map(|number| read_number(&shard, number)).transpose()?.flatten();
    match found {
        Some(framed) => Ok(framed),
        // A number beyond the last record may be an id.
        None => read_framed(&numbered(path)?),
    }
}

/// A record with its frame, by its number; `None` beyond the last.
fn read_number(shard: &Path, number: usize) -> Result<Option<Vec<u8>>, Error> {
    let mut records = Shard::open(shard)?;
    for _ in 0..number {
        match records.skip_record() {
            Some(skipped) => skipped?,
            None => return Ok(None),
        }
    }
    let Some(record) = records.next_record().transpose()? else { return Ok(None) };
    match checked_data(&record.framed) {
        Ok(_) => Ok(Some(record.framed)),
        Err(problem) => {
            let path = shard.to_owned();
            Err(Error::Shard { path, record: record.number, offset: record.offset, problem })
        }
    }
}

/// The only record of a file, with its frame.
///
/// *Errors*: [`Error::Shard`]; several records.
pub(crate) fn only_record(path: &Path, bytes: Vec<u8>) -> Result<Vec<u8>, Error> {
    if checked_data(&bytes).is_ok_and(|data| data.len() + HEADER + FOOTER == bytes.len()) {
        return Ok(bytes);
    }
    let mut records = Shard::from_bytes(path, bytes)?;
    let first = records.next_record().transpose()?;
    let mut count = 1;
    while let Some(next) = records.next_record() {
        next?;
        count += 1;
    }
    first.filter(|_| count == 1).map(|record| record.framed).ok_or_else(|| several(path, count))
}

/// The error of a shard with several scenes where one is expected.
fn several(path: &Path, count: usize) -> Error {
    let remedy = match path.is_file() {
        true => format!("name one of them, such as `{}#0`", path.display()),
        false => "save the shard to a file, and name one of them as FILE#0".to_owned(),
    };
    Error::Field {
        path: path.to_owned(),
        field: "(records)".to_owned(),
        found: format!("a list of {count} scenes"),
        expected: format!("one scene; {remedy}"),
    }
}
