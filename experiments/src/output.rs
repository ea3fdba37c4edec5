//! Files that commands leave behind: never over what is there, never half written.

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};

use crate::progress;

/// Makes a folder for output.
///
/// *Errors*: it holds something and `force` is not given, or the system refuses.
pub(crate) fn make_folder(path: &Path, force: bool) -> Result<()> {
    std::fs::create_dir_all(path).with_context(|| format!("cannot make `{}`", path.display()))?;
    let mut entries = std::fs::read_dir(path).with_context(|| format!("cannot read `{}`", path.display()))?;
    if entries.next().is_some() && !force {
        bail!("`{}` is not empty; give --force to write into it all the same", path.display());
    }
    Ok(())
}

/// Writes a file under a temporary name and renames it; `-` is standard output.
///
/// *Errors*: the file exists and `force` is not given, or the system refuses.
pub(crate) fn write_file(path: &Path, bytes: &[u8], force: bool) -> Result<()> {
    if path.to_str() == Some("-") {
        return Ok(std::io::stdout().lock().write_all(bytes)?);
    }
    if path.exists() && !force {
        bail!("`{}` exists; give --force to write over it", path.display());
    }
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    let part = PathBuf::from(name);
    std::fs::write(&part, bytes).with_context(|| format!("cannot write `{}`", part.display()))?;
    std::fs::rename(&part, path).with_context(|| format!("cannot write `{}`", path.display()))
}

/// Makes the folder of a run that can be gone on with; `record` tells it from others. Whether the
/// folder holds the same run, unfinished; with `force` it starts anew.
///
/// *Errors*: it holds something else and `force` is not given, or the system refuses.
pub(crate) fn start_run(folder: &Path, record: &Value, force: bool) -> Result<bool> {
    if force {
        begin(folder, record, force)?;
        return Ok(false);
    }
    let before = std::fs::read_to_string(folder.join(RUN)).ok();
    let before = before.and_then(|text| serde_json::from_str::<Value>(&text).ok());
    if before.is_some_and(|before| before["run"] == *record && before["seconds"].is_null()) {
        progress::say(&format!("note: `{}` holds this run unfinished; it goes on", folder.display()));
        return Ok(true);
    }
    begin(folder, record, force)?;
    Ok(false)
}

fn begin(folder: &Path, record: &Value, force: bool) -> Result<()> {
    make_folder(folder, force)?;
    let text = json!({"command": command(), "run": record, "seconds": null});
    write_file(&folder.join(RUN), format!("{text:#}\n").as_bytes(), true)
}

/// What tells this build of the program from others: a run is gone on with by the same one only.
pub(crate) fn program() -> String {
    let bytes = std::env::current_exe().and_then(std::fs::read);
    bytes.map_or_else(
        |_| env!("CARGO_PKG_VERSION").to_owned(),
        |bytes| blake3::hash(&bytes).to_hex()[..16].to_owned(),
    )
}

/// Refuses an output file that cannot be written, before the work for it is done.
///
/// *Errors*: it exists and `force` is not given, or its folder is not there.
pub(crate) fn check_file(path: &Path, force: bool) -> Result<()> {
    if path.exists() && !force {
        bail!("`{}` exists; name another file or give --force to write over it", path.display());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder.filter(|folder| !folder.is_dir()) {
        Some(folder) => bail!("the folder `{}` is not there; make it first", folder.display()),
        None => Ok(()),
    }
}

/// Writes `run.json` of a run that is done.
///
/// *Errors*: the system refuses.
pub(crate) fn finish_run(folder: &Path, record: &Value, results: &Value, seconds: f64) -> Result<()> {
    let text = json!({"command": command(), "run": record, "results": results, "seconds": seconds});
    write_file(&folder.join(RUN), format!("{text:#}\n").as_bytes(), true)
}

/// What a run was and how long it took.
const RUN: &str = "run.json";

/// The command as it was typed, without the path of the program.
pub(crate) fn command() -> String {
    let quoted = |argument: String| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+".contains(c);
        if !argument.is_empty() && argument.chars().all(plain) {
            argument
        } else {
            format!("'{}'", argument.replace('\'', r"'\''"))
        }
    };
    let arguments: Vec<String> = std::env::args().skip(1).map(quoted).collect();
    format!("sage {}", arguments.join(" "))
}

/// Writes to standard output.
///
/// *Errors*: it is closed or full.
pub(crate) fn print(text: &str) -> Result<()> {
    use std::io::Write;
    Ok(std::io::stdout().lock().write_all(text.as_bytes())?)
}
