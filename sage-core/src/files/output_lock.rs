//! Locks that give one run at a time the right to write to an output folder or file.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{self, ErrorKind, Read, Write},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use super::write::{Registered, ignore_missing, is_at, is_unfinished, remove_stale, says_no_locks};

/// Name of the lock file of a folder.
const LOCK: &str = ".sage-lock";
/// Prefix of the names of lock files of shards.
const SHARD_LOCK: &str = ".sage-lock-shard-";
/// Start of the holder text of a run that claims a whole folder only to begin or to end a shard.
const SHORTLY: &str = "[begins or ends a shard]";
/// Holder text if the holder has not written its name yet.
const UNNAMED: &str = "name unknown";
/// Holder text if the holder changed during every attempt.
const CHANGING: &str = "several runs, one after another";
/// Maximum number of attempts to take a lock while its holder changes.
const ATTEMPTS: usize = 100;
/// Time between two attempts while waiting for a lock.
const PAUSE: Duration = Duration::from_millis(20);
/// Maximum time to wait for a lock that other runs hold only to begin or to end a shard.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Size limit of a holder text, bytes.
const HOLDER_LIMIT: u64 = 2048;

/// The right to write into a folder or to one file, held by one run at a time.
///
/// It is a lock of the operating system on a separate file, which is removed on drop: one on the output would be lost when it
/// is renamed over. The system releases the lock of a killed process, so a lock file that remains does not block later runs.
///
/// Shards write the same bytes however often they are run, so a shard needs no lock to be right. On a file system without
/// locks it therefore takes none: what a killed one left there would block its next try.
#[derive(Debug)]
pub struct OutputLock {
    /// `None` for a shard on a file system without locks.
    _held: Option<Held>,
    /// True for a shard. It removes no temporary files, because the file system may not show it the locks of other hosts.
    is_shard: bool,
}

/// A lock file and the lock on it.
#[derive(Debug)]
struct Held {
    lock: PathBuf,
    // Closed, and so unlocked, only after `drop` has removed the file.
    _file: File,
    _entry: Registered,
}

/// Why a folder or a file cannot be claimed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LockError {
    /// Another run holds it.
    #[error("`{}` is in use by another run ({holder}); wait for its end or name another output", path.display())]
    Held {
        /// Folder or file.
        path: PathBuf,
        /// Holder text of the other run: process id and command.
        holder: String,
    },
    /// It cannot be written to.
    #[error("cannot write into `{}`", folder.display())]
    Io {
        /// The folder.
        folder: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}

impl OutputLock {
    /// Claims a folder, which must exist, and removes the temporary files that killed runs left in it.
    /// Other runs print `holder` in their errors.
    ///
    /// *Errors*: [`LockError`], also if another run holds a shard of the folder.
    pub fn folder(folder: &Path, holder: &str) -> Result<Self, LockError> {
        let claim = Self::lock(folder, folder.join(LOCK), folder, holder)?;
        claim.refuse_shards(folder, |_| false)?;
        claim.clean(folder).map_err(|source| LockError::Io { folder: folder.to_owned(), source })?;
        Ok(claim)
    }

    /// Claims one shard of a folder, `number` of `of`, and the whole folder. The caller drops the second
    /// claim when the shard has begun. Meanwhile other runs can claim only other shards with the same `of`.
    ///
    /// *Errors*: [`LockError`], if this shard, the whole folder, or a shard with another `of` is claimed.
    pub fn shard(folder: &Path, number: u32, of: u32, holder: &str) -> Result<(Self, Self), LockError> {
        if !has_locks(folder).map_err(|source| LockError::Io { folder: folder.to_owned(), source })? {
            let none = || Self { _held: None, is_shard: true };
            return Ok((none(), none()));
        }
        let whole = Self::folder_shortly(folder, holder)?;
        let own = shard_lock(number, of);
        let same_count = format!("-of-{of}");
        whole.refuse_shards(folder, |name| name.ends_with(&same_count) && name != own)?;
        let own = Self::lock(folder, folder.join(own), folder, holder)?;
        Ok((Self { is_shard: true, ..own }, Self { is_shard: true, ..whole }))
    }

    /// Holder text of any claimed shard of a folder other than `number` of `of`; `None` if there is none.
    ///
    /// *Errors*: [`LockError::Io`].
    pub fn other_shard(folder: &Path, number: u32, of: u32) -> Result<Option<String>, LockError> {
        let own = shard_lock(number, of);
        let fail = |source| LockError::Io { folder: folder.to_owned(), source };
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let entry = entry.map_err(fail)?;
            let name = entry.file_name();
            let is_other = name.to_str().is_some_and(|name| is_shard_lock(name) && name != own);
            if is_other && let Some(holder) = remove_if_stale(&entry.path()).map_err(fail)? {
                return Ok(Some(holder));
            }
        }
        Ok(None)
    }

    /// Claims a whole folder for the short time in which a shard begins or ends. Waits while other shards
    /// begin or end.
    ///
    /// *Errors*: as [`OutputLock::folder`]: at once if a run holds the whole folder; after a minute if nobody can tell
    /// whether the holder is alive.
    fn folder_shortly(folder: &Path, holder: &str) -> Result<Self, LockError> {
        let start = Instant::now();
        let holder = format!("{SHORTLY} {holder}");
        // A live shard ends its short claim by itself. Everything else may be left over.
        let waits = |holder: &str| {
            let is_short = holder.contains(SHORTLY) && !holder.ends_with(UNKNOWN_STATE);
            let is_unclear = holder.contains(SHORTLY) || [UNNAMED, CHANGING].contains(&holder);
            is_short || (is_unclear && start.elapsed() < TIMEOUT)
        };
        loop {
            match Self::lock(folder, folder.join(LOCK), folder, &holder) {
                Err(LockError::Held { holder, .. }) if waits(&holder) => std::thread::sleep(PAUSE),
                outcome => return outcome,
            }
        }
    }

    /// Shards of a folder whose lock files are there, each as its number and the number of all: a process holds them, or was
    /// killed. No lock is tried, because that would hold it for a moment.
    ///
    /// *Errors*: [`LockError::Io`].
    pub fn begun_shards(folder: &Path) -> Result<Vec<[u32; 2]>, LockError> {
        let fail = |source| LockError::Io { folder: folder.to_owned(), source };
        let mut all = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let name = entry.map_err(fail)?.file_name();
            let parts = name.to_str().and_then(|name| name.strip_prefix(SHARD_LOCK)?.split_once("-of-"));
            all.extend(parts.and_then(|(number, of)| Some([number.parse().ok()?, of.parse().ok()?])));
        }
        Ok(all)
    }

    /// Refuses a folder if another run holds a shard that is not `allowed`.
    fn refuse_shards(&self, folder: &Path, allowed: impl Fn(&str) -> bool) -> Result<(), LockError> {
        let fail = |source| LockError::Io { folder: folder.to_owned(), source };
        for entry in std::fs::read_dir(folder).map_err(fail)? {
            let entry = entry.map_err(fail)?;
            let name = entry.file_name();
            let is_shard = name.to_str().is_some_and(is_shard_lock);
            if !is_shard || name.to_str().is_some_and(&allowed) {
                continue;
            }
            if let Some(holder) = remove_if_stale(&entry.path()).map_err(fail)? {
                return Err(LockError::Held { path: folder.to_owned(), holder });
            }
        }
        Ok(())
    }

    /// Claims one output file, which need not exist. Other files of its folder stay free.
    ///
    /// *Errors*: [`LockError`].
    pub fn file(path: &Path, holder: &str) -> Result<Self, LockError> {
        let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let fail = |source| LockError::Io { folder: folder.to_owned(), source };
        // A hash, because the file name may have the maximum length of a name already.
        let name = path.file_name().unwrap_or_default().as_encoded_bytes();
        let name = format!("{LOCK}-{}", &blake3::hash(name).to_hex()[..16]);
        let claim = Self::lock(path, folder.join(name), folder, holder)?;
        claim.clean(folder).map_err(fail)?;
        Ok(claim)
    }

    /// Removes the temporary files that killed runs left in a folder inside the claimed folder. A shard removes none.
    ///
    /// *Errors*: those of the system.
    pub fn clean(&self, folder: &Path) -> io::Result<()> {
        if self.is_shard { Ok(()) } else { remove_stale(folder) }
    }

    /// True if a file name is that of a lock or of an unfinished file, which are no content of a folder.
    pub fn is_passing(name: &std::ffi::OsStr) -> bool {
        name.to_str().is_some_and(|name| name.starts_with(LOCK) || is_unfinished(name))
    }

    fn lock(claimed: &Path, lock: PathBuf, folder: &Path, holder: &str) -> Result<Self, LockError> {
        let fail = |source| LockError::Io { folder: folder.to_owned(), source };
        let held = |holder| LockError::Held { path: claimed.to_owned(), holder };
        for _ in 0..ATTEMPTS {
            match OpenOptions::new().write(true).create_new(true).open(&lock) {
                Ok(file) => {
                    match file.try_lock() {
                        Ok(()) => {}
                        Err(TryLockError::WouldBlock) => return Err(held(read_holder(&lock))),
                        // A file system without locks: only exclusive creation protects the file.
                        Err(TryLockError::Error(error)) if says_no_locks(&error) => {}
                        Err(TryLockError::Error(error)) => return Err(fail(error)),
                    }
                    // Another run may have removed the new file as stale before it was locked.
                    if !is_at(&file, &lock) {
                        continue;
                    }
                    let entry = Registered::new(&lock);
                    let held = Held { lock, _file: file, _entry: entry };
                    let text = format!("process {}: {holder}\n", std::process::id());
                    // This also tests whether the folder is writable.
                    (&held._file).write_all(text.as_bytes()).map_err(fail)?;
                    return Ok(Self { _held: Some(held), is_shard: false });
                }
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                    remove_if_stale(&lock).map_err(fail)?.map_or(Ok(()), |holder| Err(held(holder)))?;
                }
                Err(error) => return Err(fail(error)),
            }
        }
        Err(held(CHANGING.to_owned()))
    }
}

/// Name of the lock file of a shard.
fn shard_lock(number: u32, of: u32) -> String {
    format!("{SHARD_LOCK}{number}-of-{of}")
}

fn is_shard_lock(name: &str) -> bool {
    let parts = name.strip_prefix(SHARD_LOCK).and_then(|rest| rest.split_once("-of-"));
    let is_number = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    parts.is_some_and(|(number, of)| is_number(number) && is_number(of))
}

/// True if the file system of a folder has locks. Also tests whether the folder is writable.
fn has_locks(folder: &Path) -> io::Result<bool> {
    // Named as a lock, so that a folder with it counts as empty, and as a temporary file, so that it is cleaned up.
    let prefix = format!("{LOCK}-");
    let probe = tempfile::Builder::new().prefix(&prefix).suffix(".part").tempfile_in(folder)?;
    match probe.as_file().try_lock() {
        Err(TryLockError::Error(error)) if says_no_locks(&error) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
        Ok(()) | Err(TryLockError::WouldBlock) => Ok(true),
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        // If the removal fails, the next run finds the file unlocked.
        let _ = std::fs::remove_file(&self.lock);
    }
}

/// End of the holder text if the file system cannot tell whether the holder is alive.
const UNKNOWN_STATE: &str = " (this file system has no locks)";

/// Removes the lock file of a killed run. Returns the holder text if a live process holds the lock.
fn remove_if_stale(lock: &Path) -> io::Result<Option<String>> {
    let found = match std::fs::symlink_metadata(lock) {
        Ok(found) => found,
        Err(error) => return ignore_missing(Err(error)).map(|()| None),
    };
    if !found.is_file() {
        let problem = format!("`{}` is no regular file; remove it", lock.display());
        return Err(io::Error::new(ErrorKind::InvalidInput, problem));
    }
    // Some network file systems lock only files that are open for writing.
    let file = match OpenOptions::new().read(true).write(true).open(lock) {
        Ok(file) => file,
        Err(error) => return ignore_missing(Err(error)).map(|()| None),
    };
    match file.try_lock() {
        Ok(()) if is_at(&file, lock) => ignore_missing(std::fs::remove_file(lock)).map(|()| None),
        Ok(()) => Ok(None),
        Err(TryLockError::WouldBlock) => Ok(Some(read_holder(lock))),
        // A file system without locks cannot tell whether the holder is alive.
        Err(TryLockError::Error(_)) => {
            let (holder, lock) = (read_holder(lock), lock.display());
            Ok(Some(format!("{holder}; if no run is active, remove `{lock}`{UNKNOWN_STATE}")))
        }
    }
}

fn read_holder(lock: &Path) -> String {
    let mut text = String::new();
    let read = File::open(lock).and_then(|file| file.take(HOLDER_LIMIT).read_to_string(&mut text));
    // Only the first line, because any process may have written the file.
    match text.lines().next().filter(|line| read.is_ok() && !line.trim().is_empty()) {
        Some(line) => line.to_owned(),
        None => UNNAMED.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_holder_at_a_time_and_no_lock_file_afterwards() {
        let folder = tempfile::tempdir().unwrap();
        let first = OutputLock::folder(folder.path(), "sage first").unwrap();
        let error = OutputLock::folder(folder.path(), "sage second").unwrap_err().to_string();
        assert!(error.contains(&format!("process {}: sage first", std::process::id())), "{error}");
        drop(first);
        drop(OutputLock::folder(folder.path(), "sage third").unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn files_of_one_folder_are_claimed_separately() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
        let first = OutputLock::file(&a, "a").unwrap();
        assert!(OutputLock::file(&a, "a again").is_err());
        let second = OutputLock::file(&b, "b").unwrap();
        drop((first, second));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn shards_of_one_folder_are_claimed_together_and_exclude_other_claims() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        let first = OutputLock::shard(path, 1, 2, "first").unwrap().0;
        assert_eq!(OutputLock::other_shard(path, 1, 2).unwrap(), None);
        let second = OutputLock::shard(path, 2, 2, "second").unwrap().0;
        assert!(OutputLock::other_shard(path, 1, 2).unwrap().unwrap().ends_with("second"));
        for refused in [
            OutputLock::shard(path, 1, 2, "first again").map(|(own, _)| own),
            OutputLock::shard(path, 1, 3, "another number").map(|(own, _)| own),
            OutputLock::folder(path, "all of it"),
        ] {
            let error = refused.unwrap_err().to_string();
            assert!(error.contains("first") || error.contains("second"), "{error}");
        }
        drop(OutputLock::folder_shortly(path, "the end of a shard").unwrap());
        drop((first, second));
        let whole = OutputLock::folder(path, "all of it").unwrap();
        assert!(OutputLock::shard(path, 1, 2, "first").unwrap_err().to_string().contains("all of it"));
        drop(whole);
        std::fs::write(path.join(shard_lock(7, 9)), "process 1: gone").unwrap();
        drop(OutputLock::folder(path, "all of it").unwrap());
        assert_eq!(std::fs::read_dir(path).unwrap().count(), 0);
    }

    #[test]
    fn files_of_a_killed_run_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        for name in [LOCK, ".sage-x.part"] {
            std::fs::write(folder.path().join(name), "process 1: gone").unwrap();
        }
        drop(OutputLock::folder(folder.path(), "next").unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_in_its_place_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let victim = folder.path().join("victim");
        std::fs::write(&victim, "mine").unwrap();
        std::os::unix::fs::symlink(&victim, folder.path().join(LOCK)).unwrap();
        assert!(OutputLock::folder(folder.path(), "me").unwrap_err().to_string().contains("cannot write"));
        assert_eq!(std::fs::read(&victim).unwrap(), b"mine");
    }

    #[test]
    fn concurrent_claims_exclude_each_other() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let folder = tempfile::tempdir().unwrap();
        let (inside, claimed) = (AtomicUsize::new(0), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..200 {
                        let Ok(claim) = OutputLock::folder(folder.path(), "one of many") else { continue };
                        assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0);
                        claimed.fetch_add(1, Ordering::SeqCst);
                        inside.fetch_sub(1, Ordering::SeqCst);
                        drop(claim);
                    }
                });
            }
        });
        assert!(claimed.load(Ordering::SeqCst) > 0);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
