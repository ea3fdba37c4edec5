//! Files in and out: bounded reads, atomic writes, and one run at a time in an output folder.
//!
//! Every crate and command reads and writes through these functions, so that what they promise holds
//! everywhere: no read without a limit, no half-written file under its final name, no leftover of a
//! run that failed.

mod claim;
mod read;
mod write;

pub use claim::{Claim, ClaimError};
pub use read::{read, read_argument, read_argument_text, read_text};
pub use write::{Existing, discard_unfinished, write, write_all, write_with};

use std::io::ErrorKind;

/// Whether an error means that nothing more can be written there: the disk or the quota is full, or the
/// file may not grow further.
pub fn is_disk_full(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge)
}
