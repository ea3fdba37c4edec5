//! What commands leave behind: folders and files that one run at a time writes, never over what is
//! there, never half written.

mod command_line;
mod dataset_run;
mod run;

use std::{
    collections::HashSet,
    io::{self, Write},
    path::{Component, Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use sage_core::files::{self, Claim, Existing};

use crate::terminal;

pub(crate) use command_line::{command, program};
pub(crate) use dataset_run::DatasetRun;
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
        make_folder(path)?;
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
        let root = self.path.canonicalize().with_context(fail)?;
        let mut made = self.path.clone();
        for part in name.components() {
            made.push(part);
            match std::fs::create_dir(&made) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                done => done.with_context(fail)?,
            }
            // Looked at before anything is made below it.
            if !made.canonicalize().with_context(fail)?.starts_with(&root) {
                bail!("`{}` is a link that leads out of `{}`", made.display(), self.path.display());
            }
        }
        self.claim.clean(&path).with_context(fail)?;
        Ok(path)
    }
}

/// One output file that this run alone writes; `-` is standard output.
pub(crate) struct OutputFile {
    path: PathBuf,
    existing: Existing,
    claim: Option<Claim>,
}

impl OutputFile {
    /// Claims a file before the work for it is done.
    ///
    /// *Errors*: it exists and `force` is not given, another run writes it, or its folder is not there or
    /// cannot be written to.
    pub(crate) fn claim(path: &Path, force: bool) -> Result<Self> {
        let existing = if force { Existing::Replace } else { Existing::Keep };
        if path.to_str() == Some("-") {
            return Ok(Self { path: path.to_owned(), existing, claim: None });
        }
        refuse_link(path)?;
        refuse_existing(path, force)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            bail!("the folder `{}` is not there; make it first", folder.display());
        }
        let claim = Claim::file(path, &command())?;
        Ok(Self { path: path.to_owned(), existing, claim: Some(claim) })
    }

    /// Whether it is standard output.
    pub(crate) fn is_stdout(&self) -> bool {
        self.claim.is_none()
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

/// Refuses a link, such as /dev/stdout: what would be written is unclear, the link or what it leads to.
fn refuse_link(path: &Path) -> Result<()> {
    if path.is_symlink() {
        bail!("`{}` is a link; name the file itself, or - for standard output", path.display());
    }
    Ok(())
}

fn refuse_existing(path: &Path, force: bool) -> Result<()> {
    if !force && path.symlink_metadata().is_ok() {
        bail!("`{}` exists; give --force to write over it, or name another file", path.display());
    }
    Ok(())
}

fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make `{}`", path.display()))
}

/// Refuses an output folder in which an input lies, by its own name or by what a link leads to, or that lies
/// in a folder of inputs, where the next run would read what this one wrote.
///
/// *Errors*: the first such input.
pub(crate) fn keep_inputs(
    given: &[PathBuf],
    files: &[PathBuf],
    out: &Path,
    outputs: &[PathBuf],
) -> Result<()> {
    make_folder(out)?;
    let root = out.canonicalize()?;
    let place = |file: &Path| -> Option<PathBuf> {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some(folder.canonicalize().ok()?.join(file.file_name()?))
    };
    let inputs: HashSet<PathBuf> =
        files.iter().flat_map(|file| [place(file), file.canonicalize().ok()]).flatten().collect();
    if let Some(output) = outputs.iter().find(|output| inputs.contains(&root.join(output))) {
        let path = out.join(output);
        bail!("`{}` would take the place of an input; name another --out", path.display());
    }
    let is_around = |path: &&PathBuf| path.is_dir() && path.canonicalize().is_ok_and(|p| root.starts_with(p));
    match given.iter().find(is_around) {
        Some(path) => {
            bail!("`{}` lies in the input folder `{}`; name another --out", out.display(), path.display())
        }
        None => Ok(()),
    }
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
    Ok(io::stdout().lock().write_all(terminal::escaped(text).as_bytes())?)
}
