//! Decompression by gzip, with a limit on how far the data expands.

use std::io::{self, BufReader, Read};

use flate2::read::MultiGzDecoder;

/// How many times compressed data may expand. Scenes expand 3 to 20 times, gzip up to 1000 times.
pub(crate) const MAX_EXPANSION: u64 = 100;
/// Decompressed bytes that are free of that limit.
const FREE: u64 = 64 << 20;

/// True if bytes are compressed by gzip.
pub(crate) fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

/// The decompressed bytes of a source. Beyond the limit of expansion reading fails ([`is_expansion`]).
pub(crate) fn inflated<R: Read + Send>(source: R) -> impl Read + Send {
    let counted = Counted { source, bytes: 0 };
    Inflated { decoder: MultiGzDecoder::new(BufReader::new(counted)), bytes: 0 }
}

/// The decompressed bytes of data in memory, at most `limit` of them.
///
/// *Errors*: damaged data, and data that expands too far; [`io::ErrorKind::FileTooLarge`] beyond the limit.
pub(crate) fn inflate(bytes: &[u8], limit: u64) -> io::Result<Vec<u8>> {
    let mut all = Vec::new();
    inflated(bytes).take(limit + 1).read_to_end(&mut all)?;
    if all.len() as u64 > limit {
        return Err(io::ErrorKind::FileTooLarge.into());
    }
    Ok(all)
}

/// The first decompressed bytes of data whose end may be missing.
pub(crate) fn inflated_start(bytes: &[u8], length: u64) -> Vec<u8> {
    let mut start = Vec::new();
    // What was read before an error stays.
    let _ = inflated(bytes).take(length).read_to_end(&mut start);
    start
}

/// True for the error of data that expands too far.
pub(crate) fn is_expansion(error: &io::Error) -> bool {
    error.get_ref().is_some_and(|inner| inner.is::<Expansion>())
}

#[derive(Debug, thiserror::Error)]
#[error("the data expands more than {MAX_EXPANSION} times")]
struct Expansion;

/// A source, and the number of bytes that were read from it.
struct Counted<R> {
    source: R,
    bytes: u64,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let found = self.source.read(buffer)?;
        self.bytes += found as u64;
        Ok(found)
    }
}

struct Inflated<R> {
    decoder: MultiGzDecoder<BufReader<Counted<R>>>,
    bytes: u64,
}

impl<R: Read> Read for Inflated<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let found = self.decoder.read(buffer)?;
        self.bytes += found as u64;
        if self.bytes > FREE + MAX_EXPANSION * self.decoder.get_ref().get_ref().bytes {
            return Err(io::Error::other(Expansion));
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn data_that_expands_too_far_is_refused() {
        let zeros = |count: u64| {
            let mut writer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
            let block = vec![0; 1 << 20];
            for _ in 0..count >> 20 {
                writer.write_all(&block).unwrap();
            }
            io::Cursor::new(writer.finish().unwrap())
        };
        let read = |count| io::copy(&mut inflated(zeros(count)), &mut io::sink());
        assert_eq!(read(FREE).unwrap(), FREE);
        assert!(is_expansion(&read(2 * FREE).unwrap_err()));
    }
}
