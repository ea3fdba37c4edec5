//! Records by path: `validation.tfrecord-00000-of-00150#3` names the record with number 3 of a shard, and
//! `…#5060f881443f897e` the scene with this id.

use std::path::{Path, PathBuf};

use super::{
    decode, open_shard,
    shard::{ShardReader, count_records, is_shard},
    tfrecord::{checked_data, frame_length},
};
use crate::Error;

/// Path of a record by its number.
pub(super) fn record_path(shard: &Path, number: usize) -> PathBuf {
    let mut path = shard.as_os_str().to_owned();
    path.push(format!("#{number}"));
    path.into()
}

/// The shard and the record that a path such as `SHARD#3` names; `None` for other paths.
pub(crate) fn split_path(path: &Path) -> Option<(PathBuf, String)> {
    let (shard, record) = path.to_str()?.rsplit_once('#')?;
    // A record, or a file whose name holds a `#`.
    let names_record = !record.is_empty() && !path.exists() && is_shard(Path::new(shard));
    names_record.then(|| (PathBuf::from(shard), record.to_owned()))
}

/// The shard of a path such as `SHARD#3`; `None` for other paths.
pub fn shard_of(path: &Path) -> Option<PathBuf> {
    split_path(path).map(|(shard, _)| shard)
}

/// True if a path names a record of a shard, such as `SHARD#3`.
pub fn is_record_path(path: &Path) -> bool {
    split_path(path).is_some()
}

/// Paths of all records of a shard. The last one may be cut or damaged, which reading it reports.
///
/// *Errors*: [`Error::Read`], or [`Error::Shard`] if not even the first record is there.
pub(crate) fn record_paths(shard: &Path) -> Result<Vec<PathBuf>, Error> {
    Ok((0..count_records(shard)?).map(|number| record_path(shard, number)).collect())
}

/// The path of a record by its number, for one that names it by its id.
///
/// *Errors*: there is no such record; [`Error::Read`] or [`Error::Shard`].
pub(crate) fn numbered(path: &Path) -> Result<PathBuf, Error> {
    let Some((shard, wanted)) = split_path(path) else { return Ok(path.to_owned()) };
    let count = count_records(&shard)?;
    if let Some(number) = number(&wanted).filter(|number| *number < count) {
        return Ok(record_path(&shard, number));
    }
    let mut records = ShardReader::open(&shard)?;
    while let Some(record) = records.next_record() {
        let record = record?;
        let is_it = |data: &[u8]| decode::heading(data).is_ok_and(|heading| heading.id == wanted);
        if checked_data(&record.framed).is_ok_and(is_it) {
            return Ok(record.path());
        }
    }
    Err(Error::Field {
        path: shard,
        field: format!("#{wanted}"),
        found: "no record of the file".to_owned(),
        expected: format!("a number from 0 to {} or the id of one of its scenes", count.saturating_sub(1)),
    })
}

/// A record with its frame, by a path such as `SHARD#3`, or the only record of a shard.
///
/// *Errors*: as [`numbered`]; several records.
pub(crate) fn read_framed(path: &Path) -> Result<Vec<u8>, Error> {
    let Some((shard, wanted)) = split_path(path) else {
        return match count_records(path)? {
            1 => read_number(path, 0)?.ok_or_else(|| several(path, 0)),
            count => Err(several(path, count)),
        };
    };
    let found = number(&wanted).map(|number| read_number(&shard, number)).transpose()?.flatten();
    match found {
        Some(framed) => Ok(framed),
        // A number beyond the last record may be an id.
        None => read_framed(&numbered(path)?),
    }
}

/// The number of a record in a path; `None` for an id.
fn number(text: &str) -> Option<usize> {
    text.parse().ok().filter(|_| text.bytes().all(|byte| byte.is_ascii_digit()))
}

/// A record with its frame, by its number; `None` beyond the last.
fn read_number(shard: &Path, number: usize) -> Result<Option<Vec<u8>>, Error> {
    let Some(record) = open_shard::record(shard, number)? else { return Ok(None) };
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
    // Whoever decodes the record verifies its data.
    if frame_length(&bytes).is_ok_and(|length| length == bytes.len() as u64) {
        return Ok(bytes);
    }
    let mut records = ShardReader::from_bytes(path, bytes)?;
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
        false => "save it to a file, and name one of them as FILE#0".to_owned(),
    };
    Error::Field {
        path: path.to_owned(),
        field: "(records)".to_owned(),
        found: format!("a list of {count} scenes"),
        expected: format!("one scene; {remedy}"),
    }
}
