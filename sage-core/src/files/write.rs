//! Atomic writes: a file under its final name is complete, or it does not exist.
//!
//! Temporary files are locked too. A run that locks a folder removes temporary files of killed runs; a locked one belongs to a
//! live run and stays.

use std::{
    collections::BTreeSet,
    fs::{File, OpenOptions, TryLockError},
    io::{self, ErrorKind, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use tempfile::{Builder, NamedTempFile};

/// Prefix and suffix of the names of unfinished files. Random letters are between them.
const PREFIX: &str = ".sage-";
const SUFFIX: &str = ".part";

/// What to do if a file of the name exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Replace it.
    Replace,
    /// Refuse to write.
    Keep,
}

/// Writes a file under a temporary name in the same folder, waits until it is on the disk, and renames it.
///
/// The temporary file is created exclusively, so no link is followed. It is removed if anything
/// fails. A link with the final name is replaced, not followed.
///
/// *Errors*: those of the system; [`ErrorKind::AlreadyExists`] with [`Existing::Keep`];
/// [`ErrorKind::InvalidInput`] if the path names a folder, a pipe or a device.
///
/// ```
/// use sage_core::files::{self, Existing};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("row.json");
/// files::write(&path, b"{}", Existing::Keep)?;
/// // A second writer does not replace the file unless it says so.
/// assert!(files::write(&path, b"[]", Existing::Keep).is_err());
/// assert_eq!(files::read_text(&path, 1024)?, "{}");
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn write(path: &Path, bytes: &[u8], existing: Existing) -> io::Result<()> {
    write_with(path, existing, |out| out.write_all(bytes))
}

/// [`write()`] for content that is produced in parts. The whole content need not fit in memory.
///
/// *Errors*: as [`write()`], and those of `content`.
pub fn write_with(
    path: &Path,
    existing: Existing,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    refuse_irregular(path)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let unfinished = Unfinished::create(folder)?;
    let mut out = io::BufWriter::new(&unfinished.file);
    content(&mut out)?;
    out.flush()?;
    drop(out);
    unfinished.file.as_file().sync_all()?;
    unfinished.rename(path, existing)?;
    sync_folder(folder)
}

/// Writes several files of one folder as [`write()`] does, replaces existing ones, and syncs the folder once.
///
/// First all contents are written to the disk. Then the files are renamed in the given order.
///
/// *Errors*: as [`write()`]. The files before the failed one may exist under their final names.
pub fn write_all<'n>(
    folder: &Path,
    files: impl IntoIterator<Item = (&'n str, &'n [u8])>,
) -> Result<(), (PathBuf, io::Error)> {
    let mut unfinished = Vec::new();
    for (name, bytes) in files {
        let path = folder.join(name);
        let temporary = refuse_irregular(&path).and_then(|()| {
            let file = Unfinished::create(folder)?;
            (&file.file).write_all(bytes)?;
            Ok(file)
        });
        match temporary {
            Ok(file) => unfinished.push((path, file)),
            Err(error) => return Err((path, error)),
        }
    }
    for (path, file) in &unfinished {
        file.file.as_file().sync_all().map_err(|error| (path.clone(), error))?;
    }
    for (path, file) in unfinished {
        file.rename(&path, Existing::Replace).map_err(|error| (path, error))?;
    }
    sync_folder(folder).map_err(|error| (folder.to_owned(), error))
}

/// Refuses to replace a folder, a pipe or a device.
fn refuse_irregular(path: &Path) -> io::Result<()> {
    if std::fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        let problem = "it is no regular file; name a file, or - where the command takes it";
        return Err(io::Error::new(ErrorKind::InvalidInput, problem));
    }
    Ok(())
}

/// A temporary file that is removed if a signal stops the process.
struct Unfinished {
    file: NamedTempFile,
    _entry: Registered,
}

impl Unfinished {
    fn create(folder: &Path) -> io::Result<Self> {
        let mut builder = Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX);
        // The permissions of any new file, by the user's umask. The default would let only the owner read it.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        loop {
            // Held, so that no signal finds a file that is created and not registered yet.
            let mut all = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
            let file = builder.tempfile_in(folder)?;
            // Another run does not remove a locked temporary file.
            match file.as_file().try_lock() {
                Err(TryLockError::Error(error)) if !says_no_locks(&error) => return Err(error),
                Err(TryLockError::WouldBlock) => continue,
                _ => {}
            }
            // Another run may have removed the file as stale before it was locked.
            if is_at(file.as_file(), file.path()) {
                let entry = Registered::among(&mut all, file.path());
                return Ok(Self { file, _entry: entry });
            }
        }
    }

    fn rename(self, path: &Path, existing: Existing) -> io::Result<()> {
        match existing {
            Existing::Replace => self.file.persist(path),
            Existing::Keep => self.file.persist_noclobber(path),
        }
        .map(drop)
        .map_err(|error| error.error)
    }
}

/// True if an open file still has that name.
pub(super) fn is_at(file: &File, path: &Path) -> bool {
    let same = || {
        let open = same_file::Handle::from_file(file.try_clone()?)?;
        Ok::<_, io::Error>(open == same_file::Handle::from_path(path)?)
    };
    same().unwrap_or(false)
}

/// Makes a rename durable. On Unix a folder is a file of names, which must reach the disk as well.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder)?.sync_all() {
        // Some file systems do not support this call for folders.
        Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        done => done,
    }
}

#[cfg(not(unix))]
fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

/// True if an error of a lock says that the file system has none.
pub(super) fn says_no_locks(error: &io::Error) -> bool {
    /// `ENOLCK`: NFS without a lock daemon.
    #[cfg(target_os = "linux")]
    const NO_DAEMON: i32 = 37;
    #[cfg(not(target_os = "linux"))]
    const NO_DAEMON: i32 = 77;
    error.kind() == ErrorKind::Unsupported || (cfg!(unix) && error.raw_os_error() == Some(NO_DAEMON))
}

/// True if a file name is that of an unfinished file.
pub(super) fn is_unfinished(name: &str) -> bool {
    name.starts_with(PREFIX) && name.ends_with(SUFFIX)
}

/// Removes temporary files that killed runs left in a folder. Those of live runs stay.
pub(super) fn remove_stale(folder: &Path) -> io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let is_ours = name.to_str().is_some_and(is_unfinished);
        if !is_ours || !entry.file_type()?.is_file() {
            continue;
        }
        let path = entry.path();
        // Removed while locked, so the process that created it detects the removal.
        let Ok(file) = OpenOptions::new().read(true).write(true).open(&path) else { continue };
        // Only with the lock is it certain that no live run writes the file.
        if file.try_lock().is_ok() {
            ignore_missing(std::fs::remove_file(&path))?;
        }
    }
    Ok(())
}

pub(super) fn ignore_missing(outcome: io::Result<()>) -> io::Result<()> {
    match outcome {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

/// Files to remove if a signal stops the process. It is global because a signal handler is global.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// An entry of [`UNFINISHED`].
#[derive(Debug)]
pub(super) struct Registered(PathBuf);

impl Registered {
    pub(super) fn new(path: &Path) -> Self {
        Self::among(&mut UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner), path)
    }

    fn among(all: &mut BTreeSet<PathBuf>, path: &Path) -> Self {
        all.insert(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for Registered {
    fn drop(&mut self) {
        UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.0);
    }
}

/// Removes all unfinished files and locks of this process. It is for a signal handler that then ends the
/// process. From then on a thread that creates a new file blocks until the process ends.
pub fn discard_unfinished() {
    let all = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
    for path in all.iter() {
        // The next run removes files that cannot be removed here.
        let _ = std::fs::remove_file(path);
    }
    std::mem::forget(all);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_complete_and_no_temporary_file_remains() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        write(&path, b"one", Existing::Keep).unwrap();
        let refused = write(&path, b"two", Existing::Keep).unwrap_err();
        assert_eq!(refused.kind(), ErrorKind::AlreadyExists);
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        write(&path, b"two", Existing::Replace).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        assert!(write(&folder.path().join("no/a"), b"", Existing::Replace).is_err());
        assert_eq!(names(folder.path()), ["a"]);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_replaced_and_a_device_refused() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let [victim, link] = ["victim", "link"].map(|name| folder.path().join(name));
        std::fs::write(&victim, "mine").unwrap();
        symlink(&victim, &link).unwrap();
        write(&link, b"new", Existing::Replace).unwrap();
        assert_eq!(
            (std::fs::read(&victim).unwrap(), std::fs::read(&link).unwrap()),
            (b"mine".into(), b"new".into())
        );
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&link), mode(&victim), "the permissions of any new file");
        symlink("/dev/null", folder.path().join("null")).unwrap();
        let error = write(&folder.path().join("null"), b"", Existing::Replace).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidInput);
    }

    #[test]
    fn only_stale_temporary_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        for name in [".sage-abc.part", "mine.part", ".sage-notes"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let live = Unfinished::create(folder.path()).unwrap();
        remove_stale(folder.path()).unwrap();
        assert!(live.file.path().exists());
        drop(live);
        assert_eq!(names(folder.path()), [".sage-notes", "mine.part"]);
    }
}
