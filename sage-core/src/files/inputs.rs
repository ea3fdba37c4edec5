//! Which files this process has read: no output may take the place of one, wherever its name came from.

use std::{
    collections::BTreeSet,
    fs::File,
    path::Path,
    sync::{Mutex, PoisonError},
    time::SystemTime,
};

/// Device, number and time of creation, where it is known: the number of a file that is gone is given to another one.
type Id = (u64, u64, Option<SystemTime>);

/// The files that were read.
static READ: Mutex<BTreeSet<Id>> = Mutex::new(BTreeSet::new());

/// Notes a file that is read.
pub(super) fn note(file: &File) {
    if let Some(id) = file.metadata().ok().and_then(|found| id(&found)) {
        READ.lock().unwrap_or_else(PoisonError::into_inner).insert(id);
    }
}

/// Whether this process has read the file at a path, by this or another name. Always false where files have no numbers.
pub fn was_read(path: &Path) -> bool {
    let id = std::fs::metadata(path).ok().and_then(|found| id(&found));
    id.is_some_and(|id| READ.lock().unwrap_or_else(PoisonError::into_inner).contains(&id))
}

#[cfg(unix)]
fn id(found: &std::fs::Metadata) -> Option<Id> {
    use std::os::unix::fs::MetadataExt;
    Some((found.dev(), found.ino(), found.created().ok()))
}

#[cfg(not(unix))]
fn id(_: &std::fs::Metadata) -> Option<Id> {
    None
}
