//! Output folders and files of commands. One run at a time writes to them, existing content is protected, and
//! files are written atomically.

mod command_line;
mod dataset_run;
mod extent;
mod inputs;
mod manifest;
mod manifests;
mod run;
mod shards;

use std::{
    collections::HashSet,
    io::{self, Write},
    path::{Path, PathBuf},
};

use advsage::{WithContext as _, ego::Ego};
use sage_core::files::{self, Existing, OutputLock};
use sage_data::{ReadOptions, dataset::Shard};
use serde::Serialize;

use crate::{AnyError, Error, Result, io_causes, terminal};

pub use command_line::{command, command_with, command_without, identify_by, program, quoted, stand_for};
pub use dataset_run::{DatasetRun, Ended, run_hash};
pub use extent::Extent;
pub use inputs::Inputs;
pub use manifest::{Counts, FileRecord, MANIFEST, SceneRecord, State, has_shards};
pub use manifests::{Manifests, ShardState, ranges};
pub use run::{RECORD, Run, RunState, record_of};

/// Folder of what planners that are programs write to their standard error, in the output folder.
pub const PLANNER_LOGS: &str = "planner-logs";

/// The program that makes the files of a run, in its identity.
#[derive(Clone, Debug, Serialize)]
pub struct Producer {
    version: &'static str,
    program: String,
}

impl Producer {
    /// This program.
    pub fn own() -> Self {
        Self { version: env!("CARGO_PKG_VERSION"), program: program() }
    }
}

/// The options that scenes are read with, in the identity of a run; `None` for the default.
pub fn reading_identity(options: ReadOptions) -> Option<ReadOptions> {
    Some(options).filter(|options| *options != ReadOptions::default())
}

/// The folder for the logs of planners. Each shard has its own.
///
/// *Errors*: it cannot be created.
pub fn log_folder(folder: &Folder, extent: Extent) -> Result<PathBuf> {
    let logs = PathBuf::from(PLANNER_LOGS);
    folder.inner(&match extent {
        Extent::Shard(Shard { number, of }) => logs.join(format!("{number}-of-{of}")),
        Extent::Whole | Extent::Join => logs,
    })
}

/// Lets drivers that are programs keep their logs in a folder of the run.
///
/// *Errors*: the folder cannot be created.
pub fn keep_planner_logs(folder: &Folder, extent: Extent, egos: &[Ego]) -> Result<()> {
    if egos.iter().any(|ego| ego.is_program) && extent != Extent::Join {
        let logs = log_folder(folder, extent)?;
        egos.iter().for_each(|ego| ego.policy.write_logs_to(&logs));
    }
    Ok(())
}

/// File of a folder that is being written, with the command.
const UNFINISHED: &str = ".sage-unfinished";
/// Size limit of that file, bytes.
const MARK_LIMIT: u64 = 1 << 20;

/// An output folder that only this run writes to.
///
/// ```
/// use sage_run::output::Folder;
///
/// let parent = tempfile::tempdir()?;
/// let path = parent.path().join("results");
/// let folder = Folder::make(&path, false)?;
/// folder.write("table.md", b"| driver |")?;
/// assert_eq!(std::fs::read(path.join("table.md"))?, b"| driver |");
/// // One run at a time writes to it, and a folder with results is refused unless it is asked for.
/// assert!(Folder::make(&path, true).is_err(), "in use");
/// folder.finish()?;
/// drop(folder);
/// assert!(Folder::make(&path, false).is_err(), "not empty");
/// assert!(Folder::make(&path, true).is_ok());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Folder {
    path: PathBuf,
    claim: OutputLock,
    /// Whether the same command began before.
    is_begun: bool,
}

impl Folder {
    /// Creates an output folder and claims it.
    ///
    /// *Errors*: the folder is not empty and `force` is not given, it holds an input, another run holds it, or a system
    /// error.
    pub fn make(path: &Path, force: bool) -> Result<Self> {
        Self::make_beside(&Inputs::of_command_line(), path, force)
    }

    /// As [`Folder::make`], for a command with inputs that its command line does not name.
    ///
    /// *Errors*: as [`Folder::make`].
    pub fn make_beside(inputs: &Inputs, path: &Path, force: bool) -> Result<Self> {
        let mut folder = Self::claim(inputs, path)?;
        let mark = folder.path.join(UNFINISHED);
        folder.is_begun = files::read_text(&mark, MARK_LIMIT).is_ok_and(|begun| begun == command());
        if !force && !folder.is_begun && !folder.holds_at_most(&[UNFINISHED])? {
            let problem = format!("`{}` is not empty; give --force to write into it anyway", path.display());
            return Err(Error::Refused(problem));
        }
        // If this run is killed, the same command may begin again.
        folder.write(UNFINISHED, command().as_bytes())?;
        Ok(folder)
    }

    /// True if the same command began to write into the folder and did not end.
    pub fn is_begun(&self) -> bool {
        self.is_begun
    }

    /// Says that all files are written.
    ///
    /// *Errors*: a system error.
    pub fn finish(&self) -> Result<()> {
        self.remove(UNFINISHED)
    }

    /// As [`Folder::make`], for a folder that may have content.
    fn claim(inputs: &Inputs, path: &Path) -> Result<Self> {
        inputs.refuse_folder(path)?;
        create_folder(path)?;
        let claim = OutputLock::folder(path, &command()).map_err(Error::Lock)?;
        Ok(Self { path: path.to_owned(), claim, is_begun: false })
    }

    /// True if the folder contains nothing except locks, unfinished files and some of the given files.
    fn holds_at_most(&self, files: &[&str]) -> Result<bool> {
        let entries = std::fs::read_dir(&self.path);
        for entry in entries.with_context(|| format!("cannot read `{}`", self.path.display()))? {
            let name = entry?.file_name();
            if !OutputLock::is_passing(&name) && !files.iter().any(|file| name == *file) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a file of the folder and replaces an existing one.
    ///
    /// *Errors*: a folder of the name is a link; a system error.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path.join(name);
        let written = files::check_folders(&self.path, name.as_ref())
            .and_then(|()| files::write(&path, bytes, Existing::Replace));
        Ok(written.with_context(|| format!("cannot write `{}`", path.display()))?)
    }

    /// Writes several files of the folder, one after the other.
    ///
    /// *Errors*: as [`Folder::write`], with the file.
    pub fn write_all(&self, all: &[(String, Vec<u8>)]) -> Result<()> {
        let all = all.iter().map(|(name, bytes)| (&name[..], &bytes[..]));
        files::write_all(&self.path, all)
            .map_err(|(path, error)| Error::from(error).within(format!("cannot write `{}`", path.display())))
    }

    /// Removes a file or a folder of the folder, if it is there. A link is removed, never followed.
    ///
    /// *Errors*: a folder of the name is a link; a system error.
    pub fn remove(&self, name: &str) -> Result<()> {
        let removed = files::remove_inside(&self.path, name.as_ref());
        Ok(removed.with_context(|| format!("cannot remove `{}`", self.path.join(name).display()))?)
    }

    /// Creates a folder inside this folder.
    ///
    /// *Errors*: the name leads out of the folder, a part of it is a link, or a system error.
    pub fn inner(&self, name: &Path) -> Result<PathBuf> {
        let fail = || format!("cannot create `{}`", self.path.join(name).display());
        let path = files::create_inside(&self.path, name).with_context(fail)?;
        self.claim.clean(&path).with_context(fail)?;
        Ok(path)
    }
}

/// An output file that only this run writes; `-` is standard output.
pub struct OutputFile {
    path: PathBuf,
    existing: Existing,
    claim: Option<OutputLock>,
}

impl OutputFile {
    /// Claims a file before its content is computed.
    ///
    /// *Errors*: the file exists and `force` is not given, it is an input, another run writes it, or its folder does not
    /// exist or is not writable.
    pub fn claim(path: &Path, force: bool) -> Result<Self> {
        let existing = if force { Existing::Replace } else { Existing::Keep };
        if path.to_str() == Some("-") {
            return Ok(Self { path: path.to_owned(), existing, claim: None });
        }
        refuse_link(path)?;
        refuse_existing(path, force)?;
        Inputs::of_command_line().refuse_file(path)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            let problem = format!("the folder `{}` does not exist; create it first", folder.display());
            return Err(Error::Refused(problem));
        }
        let claim = OutputLock::file(path, &command()).map_err(Error::Lock)?;
        Ok(Self { path: path.to_owned(), existing, claim: Some(claim) })
    }

    /// True for standard output.
    pub fn is_stdout(&self) -> bool {
        self.claim.is_none()
    }

    /// Writes the file.
    ///
    /// *Errors*: the file exists now and `force` was not given, or a system error.
    pub fn write(&self, bytes: &[u8]) -> Result<()> {
        if self.is_stdout() {
            return Ok(io::stdout().lock().write_all(bytes)?);
        }
        if files::was_read(&self.path) {
            let problem = format!("`{}` is an input of this command; name another file", self.path.display());
            return Err(Error::Refused(problem));
        }
        match files::write(&self.path, bytes, self.existing) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => refuse_existing(&self.path, false),
            done => Ok(done.with_context(|| format!("cannot write `{}`", self.path.display()))?),
        }
    }
}

/// Refuses a link, such as /dev/stdout, because the target of the write is ambiguous: the link or its target.
fn refuse_link(path: &Path) -> Result<()> {
    if path.is_symlink() {
        let problem =
            format!("`{}` is a link; name the file itself, or - for standard output", path.display());
        return Err(Error::Refused(problem));
    }
    Ok(())
}

fn refuse_existing(path: &Path, force: bool) -> Result<()> {
    if !force && path.symlink_metadata().is_ok() {
        let problem =
            format!("`{}` exists; give --force to write over it, or name another file", path.display());
        return Err(Error::Refused(problem));
    }
    Ok(())
}

fn create_folder(path: &Path) -> Result<()> {
    Ok(std::fs::create_dir_all(path).with_context(|| format!("cannot create `{}`", path.display()))?)
}

/// Where a folder is, links resolved; also one that does not exist yet.
fn resolved_folder(folder: &Path) -> Result<PathBuf> {
    if let Ok(found) = folder.canonicalize() {
        return Ok(found);
    }
    let name = folder.file_name().with_context(|| format!("cannot create `{}`", folder.display()))?;
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok(resolved_folder(parent)?.join(name))
}

/// Refuses an output folder in which an output would replace an input, by the name of the input or by the
/// target of a link. Also refuses an output folder inside an input folder, because the next run would read
/// its files.
///
/// *Errors*: the first such input.
pub fn protect_inputs(given: &[PathBuf], files: &[PathBuf], out: &Path, outputs: &[PathBuf]) -> Result<()> {
    let root = resolved_folder(out)?;
    let resolved = |file: &Path| -> Option<PathBuf> {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(file.file_name()?))
    };
    let inputs: HashSet<PathBuf> =
        files.iter().flat_map(|file| [resolved(file), file.canonicalize().ok()]).flatten().collect();
    if let Some(output) = outputs.iter().find(|output| inputs.contains(&root.join(output))) {
        let path = out.join(output);
        let problem = format!("`{}` would take the place of an input; name another --out", path.display());
        return Err(Error::Refused(problem));
    }
    let contains_output =
        |path: &&PathBuf| path.is_dir() && path.canonicalize().is_ok_and(|p| root.starts_with(p));
    match given.iter().find(contains_output) {
        Some(path) => Err(Error::Refused(format!(
            "`{}` lies in the input folder `{}`; name another --out",
            out.display(),
            path.display()
        ))),
        None => Ok(()),
    }
}

/// True if an error means that nothing more can be written, so the command must stop.
pub fn is_disk_full(error: &AnyError) -> bool {
    io_causes(error).any(files::is_disk_full)
}

/// Writes text for the user to standard output.
///
/// *Errors*: standard output is closed or full.
pub fn print(text: &str) -> Result<()> {
    Ok(io::stdout().lock().write_all(terminal::escaped(text).as_bytes())?)
}
