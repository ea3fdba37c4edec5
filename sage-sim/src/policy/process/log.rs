//! What a planner writes to its standard error: a file of the run, or a temporary one.

use std::{
    fs::{File, OpenOptions},
    io::{self, Write as _},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
};

/// Size above which a log is emptied between two drives, and a planner fails within one, bytes.
pub(super) const LARGEST: u64 = 64 << 20;
/// Lines and bytes of a log that a message shows.
const SHOWN_LINES: usize = 6;
const SHOWN_BYTES: u64 = 4096;
/// Most names that are tried for a file.
const MOST_NAMES: usize = 10_000;

/// A log from an offset on, which may not grow beyond its size.
#[derive(Clone, Copy)]
pub(super) struct Watched<'l> {
    pub(super) log: &'l Log,
    pub(super) since: u64,
}

impl Watched<'_> {
    /// True if too much was written.
    pub(super) fn is_full(self) -> bool {
        self.log.length() > self.since.saturating_add(LARGEST)
    }
}

/// The log of the programs that one worker starts.
pub(super) struct Log {
    file: File,
    path: Option<PathBuf>,
}

impl Log {
    /// A new file `planner-N.log` in a folder, or a temporary one without a name.
    ///
    /// *Errors*: it cannot be created.
    pub(super) fn create(folder: Option<&Path>) -> io::Result<Self> {
        let Some(folder) = folder else { return Ok(Self { file: tempfile::tempfile()?, path: None }) };
        std::fs::create_dir_all(folder)?;
        for number in 1..=MOST_NAMES {
            let path = folder.join(format!("planner-{number}.log"));
            match OpenOptions::new().create_new(true).read(true).append(true).open(&path) {
                Ok(file) => return Ok(Self { file, path: Some(path) }),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other(format!("`{}` holds {MOST_NAMES} logs; remove them", folder.display())))
    }

    /// The file, for the standard error of a program.
    pub(super) fn file(&self) -> &File {
        &self.file
    }

    /// Its path, if it has one.
    pub(super) fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// Adds a line that the program wrote elsewhere.
    pub(super) fn note(&self, line: &[u8]) {
        // A log that cannot be written is no reason to end a drive.
        let _ = (&self.file).write_all(line).and_then(|()| (&self.file).write_all(b"\n"));
    }

    /// Number of bytes so far.
    pub(super) fn length(&self) -> u64 {
        self.file.metadata().map_or(0, |found| found.len())
    }

    /// Empties a log that has grown too large.
    pub(super) fn limit(&self) {
        if self.length() > LARGEST {
            // If it cannot be emptied, the next drive fails by its size.
            let _ = self.file.set_len(0);
        }
    }

    /// The last lines since an offset.
    pub(super) fn last_lines(&self, since: u64) -> Vec<String> {
        let end = self.length();
        let from = since.max(end.saturating_sub(SHOWN_BYTES)).min(end);
        let mut bytes = vec![0; (end - from) as usize];
        if self.file.read_exact_at(&mut bytes, from).is_err() {
            return Vec::new();
        }
        let text = String::from_utf8_lossy(&bytes);
        // Lines that only underline the one before say nothing in a message.
        let says_something = |line: &&str| line.contains(char::is_alphanumeric);
        let lines: Vec<&str> = text.lines().filter(says_something).collect();
        let printable = |line: &&str| -> String {
            line.chars().map(|c| if c.is_control() { '?' } else { c }).take(300).collect()
        };
        lines[lines.len().saturating_sub(SHOWN_LINES)..].iter().map(printable).collect()
    }
}
