//! Reads with a size limit. Devices and sockets are refused. A pipe is read once, to its end.

use std::{
    fs::{File, FileType},
    io::{self, ErrorKind, Read},
    path::Path,
};

use super::inputs;

/// Path that means standard input on the command line.
const STANDARD_INPUT: &str = "-";

/// Reads a whole regular file. It is for files that the program finds itself, such as those in a folder.
///
/// *Errors*: those of the system; [`ErrorKind::InvalidInput`] for a folder, pipe, device or socket;
/// [`ErrorKind::FileTooLarge`] beyond `limit` bytes.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    // Opening a pipe without a writer would block, so the file type is checked first.
    let found = std::fs::metadata(path)?;
    if !found.is_file() {
        return Err(wrong_kind(found.file_type(), "expected a regular file"));
    }
    read_open(opened(path)?, found.len(), limit)
}

/// Opens a file that is an input from now on.
fn opened(path: &Path) -> io::Result<File> {
    File::open(path).inspect(inputs::note)
}

/// Reads a path that the user gave: a regular file, a pipe (such as a process substitution), or `-` for
/// standard input.
///
/// *Errors*: as [`read`], but pipes are read to their end.
pub fn read_argument(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    match open_argument(path)? {
        Opened::File(file, size) => read_open(file, size, limit),
        Opened::Stream(stream) => read_open(stream, 0, limit),
    }
}

/// An open input that the user gave.
pub enum Opened {
    /// A regular file and its size, bytes.
    File(File, u64),
    /// A pipe or standard input, which can be read only once.
    Stream(Box<dyn Read + Send>),
}

/// Opens a path that the user gave, as [`read_argument`] does.
///
/// *Errors*: as [`read_argument`].
pub fn open_argument(path: &Path) -> io::Result<Opened> {
    if path.to_str() == Some(STANDARD_INPUT) {
        return Ok(Opened::Stream(Box::new(io::stdin())));
    }
    let found = std::fs::metadata(path)?;
    if found.is_file() {
        return Ok(Opened::File(opened(path)?, found.len()));
    }
    if !is_pipe(found.file_type()) {
        return Err(wrong_kind(found.file_type(), "expected a file, a pipe, or - for standard input"));
    }
    Ok(Opened::Stream(Box::new(File::open(path)?)))
}

/// The first bytes of a regular file, at most `length`.
///
/// *Errors*: those of the system; [`ErrorKind::InvalidInput`] for a folder, pipe, device or socket.
pub fn read_start(path: &Path, length: u64) -> io::Result<Vec<u8>> {
    let found = std::fs::metadata(path)?;
    if !found.is_file() {
        return Err(wrong_kind(found.file_type(), "expected a regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// [`read`] for text.
///
/// *Errors*: as [`read`], and [`ErrorKind::InvalidData`] for text that is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    text(read(path, limit)?)
}

/// [`read_argument`] for text.
///
/// *Errors*: as [`read_argument`], and [`ErrorKind::InvalidData`] for text that is not UTF-8.
pub fn read_argument_text(path: &Path, limit: u64) -> io::Result<String> {
    text(read_argument(path, limit)?)
}

fn text(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|_| io::Error::new(ErrorKind::InvalidData, "the text is not UTF-8"))
}

/// All bytes of an open source of about `size` bytes.
///
/// *Errors*: those of the system; [`ErrorKind::FileTooLarge`] beyond `limit` bytes.
pub fn read_open(source: impl Read, size: u64, limit: u64) -> io::Result<Vec<u8>> {
    if size > limit {
        return Err(too_large(limit));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(size).unwrap_or(0));
    // The size of a pipe is unknown and a file may grow, so the limit also applies to the read itself.
    source.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_large(limit)) } else { Ok(bytes) }
}

/// A file is larger than a limit of ours.
#[derive(Debug, thiserror::Error)]
#[error("it holds more than {0} bytes, the most that is read")]
pub(super) struct TooLarge(u64);

fn too_large(limit: u64) -> io::Error {
    io::Error::new(ErrorKind::FileTooLarge, TooLarge(limit))
}

fn wrong_kind(found: FileType, expected: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, format!("it is {}; {expected}", kind(found)))
}

#[cfg(unix)]
fn is_pipe(found: FileType) -> bool {
    use std::os::unix::fs::FileTypeExt;
    found.is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_: FileType) -> bool {
    false
}

#[cfg(unix)]
fn kind(found: FileType) -> &'static str {
    use std::os::unix::fs::FileTypeExt;
    if found.is_dir() {
        "a folder"
    } else if found.is_fifo() {
        "a pipe"
    } else if found.is_socket() {
        "a socket"
    } else {
        "a device"
    }
}

#[cfg(not(unix))]
fn kind(found: FileType) -> &'static str {
    if found.is_dir() { "a folder" } else { "no regular file" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_above_the_limit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("five");
        std::fs::write(&path, "12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        assert_eq!(read(&path, 4).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_text(&path, 5).unwrap(), "12345");
        std::fs::write(&path, [0xff]).unwrap();
        assert_eq!(read_text(&path, 5).unwrap_err().kind(), ErrorKind::InvalidData);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_was_read_is_known_by_all_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, other] = ["a", "b", "c"].map(|name| folder.path().join(name));
        std::fs::write(&file, "x").unwrap();
        std::fs::write(&other, "x").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert!(!inputs::was_read(&file));
        read(&file, 10).unwrap();
        assert_eq!([&file, &link, &other].map(|path| inputs::was_read(path)), [true, true, false]);
    }

    #[cfg(unix)]
    #[test]
    fn errors_name_the_file_type_of_folders_and_devices() {
        let folder = tempfile::tempdir().unwrap();
        for (path, kind) in [(folder.path(), "a folder"), (Path::new("/dev/zero"), "a device")] {
            for read in [read, read_argument] {
                assert!(read(path, 10).unwrap_err().to_string().contains(kind), "{}", path.display());
            }
        }
    }
}
