//! The rows of a replay buffer on disk: a folder with a file for the rows between two checkpoints.
//!
//! A file is whole under its name and never changed. The checkpoint lists the files with their hashes, so a kill at any
//! time leaves a checkpoint and the rows that it needs.

use std::{
    io::{self, Write},
    path::Path,
};

use sage_core::files::{self, Existing};
use sage_sim::Error;
use serde::{Deserialize, Serialize};

use super::ReplayBuffer;

/// Folder of the files, in the folder of the run.
pub const BUFFER: &str = "buffer";

/// One file of rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RowFile {
    /// Number of the first row.
    first: u64,
    /// Number of rows.
    rows: u64,
    /// Hash of the file.
    hash: String,
}

impl RowFile {
    fn end(&self) -> u64 {
        self.first.saturating_add(self.rows)
    }

    fn name(&self) -> String {
        format!("{BUFFER}/{:012}.rows", self.first)
    }
}

/// The files that together hold a buffer, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct BufferLog(Vec<RowFile>);

impl BufferLog {
    /// Writes the rows that no file holds yet. Files whose rows the ring has lost are dropped from the list and stay on
    /// disk until [`BufferLog::remove_others`].
    ///
    /// *Errors*: as the system.
    pub fn append(&mut self, buffer: &ReplayBuffer, folder: &Path) -> io::Result<()> {
        self.0.retain(|file| file.end() > buffer.oldest());
        let first = self.0.last().map_or(buffer.oldest(), RowFile::end).max(buffer.oldest());
        let rows = buffer.written_count() - first;
        if rows == 0 {
            return Ok(());
        }
        files::create_inside(folder, BUFFER.as_ref())?;
        let mut file = RowFile { first, rows, hash: String::new() };
        let mut hasher = blake3::Hasher::new();
        files::write_with(&folder.join(file.name()), Existing::Replace, |to| {
            buffer.write_rows(first, &mut Hashing { to, hasher: &mut hasher })
        })?;
        file.hash = hasher.finalize().to_hex().to_string();
        self.0.push(file);
        Ok(())
    }

    /// Removes the files of a folder that are not in the list.
    ///
    /// *Errors*: as the system.
    pub fn remove_others(&self, folder: &Path) -> io::Result<()> {
        let entries = match std::fs::read_dir(folder.join(BUFFER)) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            entries => entries?,
        };
        for entry in entries {
            let name = Path::new(BUFFER).join(entry?.file_name());
            if !self.0.iter().any(|file| Path::new(&file.name()) == name) {
                files::remove_inside(folder, &name)?;
            }
        }
        Ok(())
    }

    /// Reads the newest rows of a buffer; `written` is the number of the row after the last.
    ///
    /// *Errors*: a message that names the file and what is wrong with it.
    pub fn read(&self, buffer: &mut ReplayBuffer, written: u64, folder: &Path) -> Result<(), Error> {
        let row_bytes = buffer.row_bytes() as u64;
        let kept = buffer.rows_kept(written);
        buffer.restart(written, kept);
        for file in &self.0 {
            let path = folder.join(file.name());
            let fail = |problem: String| Error::Value(format!("`{}`: {problem}", path.display()));
            let next = buffer.written_count();
            if file.first > next || file.end() <= next || file.end() > written {
                let [first, end] = [file.first, file.end()];
                return Err(fail(format!("it is listed with rows {first} to {end}; expected row {next}")));
            }
            let size = file.rows.saturating_mul(row_bytes);
            let bytes = files::read(&path, size).map_err(|error| fail(error.to_string()))?;
            if bytes.len() as u64 != size || blake3::hash(&bytes).to_hex().as_str() != file.hash {
                return Err(fail(
                    "its content does not match the hash in the checkpoint: it is damaged".to_owned(),
                ));
            }
            let mut rows = &bytes[((next - file.first) * row_bytes) as usize..];
            buffer.read_rows(file.end() - next, &mut rows).map_err(|error| fail(error.to_string()))?;
        }
        match buffer.written_count() {
            all if all == written => Ok(()),
            next => Err(Error::Value(format!(
                "`{}`: the rows from {next} to {written} are missing",
                folder.join(BUFFER).display()
            ))),
        }
    }
}

/// Passes bytes on and hashes them.
struct Hashing<'a> {
    to: &'a mut dyn Write,
    hasher: &'a mut blake3::Hasher,
}

impl Write for Hashing<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.to.write(bytes)?;
        self.hasher.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}
