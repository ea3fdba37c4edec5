//! The shard that was read last, kept open: reading its records by number one after another takes one pass.
//!
//! A shard has no index, so a record is found by skipping all before it, in a compressed shard by decompressing them.

use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::SystemTime,
};

use super::{shard::ShardReader, tfrecord::Record};
use crate::Error;

/// Records that are kept behind the present one, because threads ask for them in a slightly different order.
const KEPT: usize = 32;
/// Bytes of kept records at most, besides the last one.
const KEPT_BYTES: usize = 32 << 20;

/// An open shard.
struct OpenShard {
    path: PathBuf,
    /// Size and time of the file, by which a change is noticed.
    version: Option<(u64, SystemTime)>,
    reader: ShardReader,
    /// Number of the record that the reader reads next.
    next: usize,
    /// The last records that were read, the newest last.
    recent: VecDeque<Record>,
}

static LAST: Mutex<Option<OpenShard>> = Mutex::new(None);

/// A record by its number; `None` beyond the last.
///
/// *Errors*: those of the reader, also for a record before it that cannot be skipped.
pub(super) fn record(path: &Path, number: usize) -> Result<Option<Record>, Error> {
    let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    // Taken out, so that after an error the shard is opened again.
    let kept = last.take().filter(|open| open.is_of(path));
    if let Some(open) = kept {
        if let Some(record) = open.recent.iter().find(|record| record.number == number).cloned() {
            *last = Some(open);
            return Ok(Some(record));
        }
        if open.next <= number {
            let (record, open) = open.read(number)?;
            *last = open;
            return Ok(record);
        }
    }
    let (record, open) = OpenShard::new(path)?.read(number)?;
    *last = open;
    Ok(record)
}

fn version(path: &Path) -> Option<(u64, SystemTime)> {
    let found = std::fs::metadata(path).ok()?;
    Some((found.len(), found.modified().ok()?))
}

impl OpenShard {
    fn new(path: &Path) -> Result<Self, Error> {
        let (path, reader) = (path.to_owned(), ShardReader::open(path)?);
        Ok(Self { version: version(&path), path, reader, next: 0, recent: VecDeque::new() })
    }

    fn is_of(&self, path: &Path) -> bool {
        self.path == path && self.version.is_some() && self.version == version(path)
    }

    /// Reads on to a record, and keeps those just before it. Returns it with the shard, which is at its end without it.
    fn read(mut self, number: usize) -> Result<(Option<Record>, Option<Self>), Error> {
        while self.next + KEPT < number {
            match self.reader.skip_record() {
                Some(skipped) => skipped?,
                None => return Ok((None, None)),
            }
            self.next += 1;
        }
        while self.next <= number {
            let Some(record) = self.reader.next_record().transpose()? else { return Ok((None, None)) };
            self.next += 1;
            self.recent.push_back(record);
            let bytes = |recent: &VecDeque<Record>| recent.iter().map(|r| r.framed.len()).sum::<usize>();
            while self.recent.len() > KEPT || self.recent.len() > 1 && bytes(&self.recent) > KEPT_BYTES {
                self.recent.pop_front();
            }
        }
        Ok((self.recent.back().cloned(), Some(self)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::womd::frame;

    #[test]
    fn records_are_found_in_any_order_and_after_a_change_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("some.tfrecord");
        let write = |letter: u8, count: u8| {
            let shard: Vec<u8> = (0..count).flat_map(|k| frame(&[letter, k])).collect();
            std::fs::write(&path, shard).unwrap();
        };
        let found =
            |number: usize| record(&path, number).unwrap().map(|record| record.framed[12..14].to_vec());
        write(b'a', 200);
        let orders = [0, 1, 3, 2, 150, 149, 100, 199, 5, 6, 7, 198, 0];
        for number in orders {
            assert_eq!(found(number), Some(vec![b'a', number as u8]), "{number}");
        }
        assert_eq!(found(200), None);
        assert_eq!(found(3), Some(vec![b'a', 3]));
        write(b'b', 100);
        assert_eq!((found(4), found(100)), (Some(vec![b'b', 4]), None));
        std::fs::remove_file(&path).unwrap();
        assert!(record(&path, 5).is_err());
    }
}
