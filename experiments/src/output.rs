//! What commands leave behind: folders and files that one run at a time writes, never over what is
//! there, never half written.

mod command_line;
mod run;

use std::{
    io::{self, Write},
    path::{Component, Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use sage_core::files::{self, Claim, Existing};

use crate::terminal;

pub(crate) use command_line::{command, program};
pub(crate) use run::{Run, State};

/// A folder that this run alone writes into.
pub(crate) struct Folder {
    path: PathBuf,
    claim: Claim,
}

impl Folder {
    /// Makes a folder for output and claims it.
    ///
    /// *Errors*: it holds something and `force` is not given, another run has it, or the system refuses.
    pub(crate) fn make(path: &Path, force: bool) -> Result<Self> {
        let folder = Self::claim(path)?;
        if !force && !folder.holds_at_most(&[])? {
            bail!("`{}` is not empty; give --force to write into it all the same", path.display());
        }
        Ok(folder)
    }

    /// The same for a folder that may hold something.
    fn claim(path: &Path) -> Result<Self> {
        std::fs::create_dir_all(path).with_context(|| format!("cannot make `{}`", path.display()))?;
        Ok(Self { path: path.to_owned(), claim: Claim::folder(path, &command())? })
    }

    /// Whether there is nothing in it but its lock and some files.
    fn holds_at_most(&self, files: &[&str]) -> Result<bool> {
        let entries = std::fs::read_dir(&self.path);
        for entry in entries.with_context(|| format!("cannot read `{}`", self.path.display()))? {
            let name = entry?.file_name();
            if !Claim::is_lock(&name) && !files.iter().any(|file| name == *file) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Where it is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a file of it, over what is there.
    ///
    /// *Errors*: the system refuses.
    pub(crate) fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path.join(name);
        files::write(&path, bytes, Existing::Replace)
            .with_context(|| format!("cannot write `{}`", path.display()))
    }

    /// Makes a folder inside it. A link there that leads out of it is refused.
    ///
    /// *Errors*: the name leads out of the folder, or the system refuses.
    pub(crate) fn inner(&self, name: &Path) -> Result<PathBuf> {
        let path = self.path.join(name);
        let fail = || format!("cannot make `{}`", path.display());
        if !name.components().all(|part| matches!(part, Component::Normal(_))) {
            bail!("`{}` does not lie in `{}`", path.display(), self.path.display());
        }
        std::fs::create_dir_all(&path).with_context(fail)?;
        let [outer, inner] = [&self.path, &path].map(|path| path.canonicalize());
        if !inner.with_context(fail)?.starts_with(outer.with_context(fail)?) {
            bail!("`{}` is a link that leads out of `{}`", path.display(), self.path.display());
        }
        self.claim.clean(&path).with_context(fail)?;
        Ok(path)
    }
}

/// One output file that this run alone writes; `-` is standard output.
pub(crate) struct OutputFile {
    path: PathBuf,
    existing: Existing,
    _claim: Option<Claim>,
}

impl OutputFile {
    /// Claims a file before the work for it is done.
    ///
    /// *Errors*: it exists and `force` is not given, another run writes it, or its folder is not there or
    /// cannot be written to.
    pub(crate) fn claim(path: &Path, force: bool) -> Result<Self> {
        let existing = if force { Existing::Replace } else { Existing::Keep };
        if path.to_str() == Some("-") {
            return Ok(Self { path: path.to_owned(), existing, _claim: None });
        }
        refuse_existing(path, force)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            bail!("the folder `{}` is not there; make it first", folder.display());
        }
        let claim = Claim::file(path, &command())?;
        Ok(Self { path: path.to_owned(), existing, _claim: Some(claim) })
    }

    /// Whether it is standard output.
    pub(crate) fn is_stdout(&self) -> bool {
        self._claim.is_none()
    }

    /// Writes it.
    ///
    /// *Errors*: it exists by now and `force` was not given, or the system refuses.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<()> {
        if self.is_stdout() {
            return Ok(io::stdout().lock().write_all(bytes)?);
        }
        match files::write(&self.path, bytes, self.existing) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => refuse_existing(&self.path, false),
            done => done.with_context(|| format!("cannot write `{}`", self.path.display())),
        }
    }
}

fn refuse_existing(path: &Path, force: bool) -> Result<()> {
    if !force && path.symlink_metadata().is_ok() {
        bail!("`{}` exists; give --force to write over it, or name another file", path.display());
    }
    Ok(())
}

/// A scene's file as output is named after it: standard input has a name of its own.
pub(crate) fn scene_name(file: &Path) -> PathBuf {
    if file.to_str() == Some("-") { PathBuf::from("stdin") } else { file.to_owned() }
}

/// Largest file of options that is read, bytes.
const CONFIG_LIMIT: u64 = 1 << 20;

/// Text of a file of options that the user named.
///
/// *Errors*: it cannot be read, or is larger than any.
pub(crate) fn read_config(path: &Path) -> Result<String> {
    files::read_argument_text(path, CONFIG_LIMIT).with_context(|| format!("cannot read `{}`", path.display()))
}

/// Whether an error says that nothing more can be written: then there is no point in going on.
pub(crate) fn is_disk_full(error: &anyhow::Error) -> bool {
    let causes = error.chain().filter_map(|cause| cause.downcast_ref::<io::Error>());
    causes.into_iter().any(files::is_disk_full)
}

/// Writes text for people to standard output.
///
/// *Errors*: it is closed or full.
pub(crate) fn print(text: &str) -> Result<()> {
    Ok(io::stdout().lock().write_all(terminal::harmless(text).as_bytes())?)
}
