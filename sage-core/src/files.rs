//! File input and output: reads with a size limit, atomic writes, and exclusive claims on output folders.
//!
//! All crates and commands use these functions, so three properties hold everywhere. Every read has a size
//! limit. A file under its final name is complete, and no link is followed to write or to remove one. A run that
//! fails leaves no temporary files.

mod inputs;
mod inside;
mod output_lock;
mod read;
mod write;

pub use inputs::was_read;
pub use inside::{check_folders, create_inside, remove_inside};
pub use output_lock::{LockError, OutputLock};
pub use read::{
    Opened, open_argument, read, read_argument, read_argument_text, read_open, read_start, read_text,
};
pub use write::{Existing, discard_unfinished, write, write_all, write_with};

use std::io::ErrorKind;

/// True if an error means that nothing more can be written: the disk or the quota is full, or the file has
/// its maximum size. A file that is larger than a limit of ours is no such error.
pub fn is_disk_full(error: &std::io::Error) -> bool {
    match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => true,
        ErrorKind::FileTooLarge => !error.get_ref().is_some_and(|inner| inner.is::<read::TooLarge>()),
        _ => false,
    }
}
