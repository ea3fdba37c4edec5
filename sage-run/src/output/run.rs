//! Long runs that record their identity in the output folder. The same command resumes an interrupted run and
//! does not repeat a finished one.
//!
//! `run.json` stores options, hashes of data and weights, and the build of the program. A folder with the same record resumes
//! or is done; any other needs `--force`.

use std::{io::ErrorKind, path::Path};

use advsage::WithContext as _;
use sage_core::files;
use serde_json::{Value, json};

use super::{Folder, Inputs, command};
use crate::{Error, Result, progress};

/// File with the identity, results and duration of a run.
pub const RECORD: &str = "run.json";
/// Size limit of a record, bytes.
const RECORD_LIMIT: u64 = 4 << 20;

/// A run and its folder.
pub struct Run {
    folder: Folder,
    /// Inputs that distinguish the run from others.
    identity: Value,
    /// Files and folders that exist only until the run is done.
    temporary: Vec<String>,
}

/// State of a run in its folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// The folder holds no part of the run.
    New,
    /// The folder holds a part of the run, which resumes.
    Unfinished,
    /// The folder holds all results.
    Done,
}

/// The record of a folder; `None` if it has none.
///
/// *Errors*: it cannot be read, or is damaged.
pub fn record_of(folder: &Path) -> Result<Option<Value>> {
    let path = folder.join(RECORD);
    match files::read_text(&path, RECORD_LIMIT) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Error::from(error).within(format!("cannot read `{}`", path.display()))),
        Ok(text) => Ok(serde_json::from_str(&text).with_context(|| {
            format!("`{}` is damaged; copy it again, or begin in another folder", path.display())
        })?),
    }
}

/// The record of an output folder; `None` if it has none.
///
/// *Errors*: as [`record_of`].
pub(super) fn read_record(folder: &Folder) -> Result<Option<Value>> {
    record_of(folder.path())
}

/// Longest value that is shown where two runs differ.
const LONGEST_SHOWN: usize = 80;

/// The name of the first file whose hash differs between two values that hold `NAME HASH`.
fn changed_file<'v>(there: &'v Value, here: &'v Value) -> Option<&'v str> {
    match (there, here) {
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).find(|(a, b)| a != b).and_then(|(a, b)| changed_file(a, b))
        }
        (Value::String(a), Value::String(b)) => {
            let ((before, _), (now, _)) = (a.rsplit_once(' ')?, b.rsplit_once(' ')?);
            (before == now).then_some(now)
        }
        _ => None,
    }
}

/// In what the run of a folder differs from another, in words.
pub(super) fn difference(recorded: &Value, own: &Value) -> String {
    let both = |key: &str| [&recorded[key], &own[key]].map(|value| value.as_str().unwrap_or_default());
    if recorded["version"] != own["version"] {
        let [there, here] = both("version");
        return format!("it was begun by sage {there}, and this is sage {here}");
    }
    if recorded["program"] != own["program"] {
        return "it was begun by another build of this program".to_owned();
    }
    if recorded["command"] != own["command"] {
        let [there, _] = both("command");
        return format!("it is of `{there}`");
    }
    let mut keys = own.as_object().into_iter().chain(recorded.as_object()).flat_map(|object| object.keys());
    let other = keys.find(|key| recorded[&**key] != own[&**key]);
    let Some(key) = other else { return "it differs".to_owned() };
    if let Some(file) = changed_file(&recorded[&**key], &own[&**key]) {
        return format!("`{file}` has changed since");
    }
    let short = |value: &Value| Some(value.to_string()).filter(|text| text.len() <= LONGEST_SHOWN);
    match (short(&recorded[&**key]), short(&own[&**key])) {
        (Some(there), Some(here)) => format!("its `{key}` is {there}, and here it is {here}"),
        _ => format!("its `{key}` differs"),
    }
}

impl Run {
    /// Creates or opens the folder of a run. With `force` the run always starts again.
    ///
    /// `temporary` files exist only until the run is done. `outdated` files are removed before a new run.
    /// `results` exist after a finished run.
    ///
    /// *Errors*: the folder has other content and `force` is not given, another run holds it, or a system
    /// error.
    pub fn start(
        path: &Path,
        identity: Value,
        force: bool,
        temporary: &[&str],
        outdated: &[&str],
        results: &[&str],
    ) -> Result<(Self, RunState)> {
        let owned = temporary.iter().map(|name| (*name).to_owned()).collect();
        let run =
            Self { folder: Folder::claim(&Inputs::of_command_line(), path)?, identity, temporary: owned };
        let state = if force { RunState::New } else { run.state(results) };
        match state {
            RunState::New
                if !force && !run.folder.holds_at_most(if run.has_begun() { &[RECORD] } else { &[] })? =>
            {
                return Err(Error::Refused(format!(
                    "`{}` is not empty and holds no run of the same options, data and program; give --force to write into it anyway",
                    path.display()
                )));
            }
            RunState::New => {
                // The record goes first, so that it never marks a folder with missing results as done.
                run.folder.remove(RECORD)?;
                for name in temporary.iter().chain(outdated) {
                    run.folder.remove(name)?;
                }
                run.record(&Value::Null, None)?;
            }
            RunState::Unfinished => {
                progress::say(&format!("note: `{}` holds this run unfinished; it resumes", path.display()));
            }
            RunState::Done => {
                // The run may have been killed after it wrote the record and before it removed temporary
                // files.
                run.clear()?;
                progress::say(&format!("note: `{}` holds this run, and it is done", path.display()));
            }
        }
        Ok((run, state))
    }

    fn recorded(&self) -> Option<Value> {
        read_record(&self.folder).ok().flatten()
    }

    /// True if the record is of an unfinished run. If the folder holds nothing else, that run failed before
    /// it wrote any result, so a new run may replace it.
    fn has_begun(&self) -> bool {
        self.recorded().is_some_and(|record| record["run"].is_object() && record["seconds"].is_null())
    }

    fn state(&self, results: &[&str]) -> RunState {
        let are_there = results.iter().all(|name| self.folder.path().join(name).is_file());
        match self.recorded().filter(|record| record["run"] == self.identity) {
            None => RunState::New,
            Some(record) if record["seconds"].is_null() || !are_there => RunState::Unfinished,
            Some(_) => RunState::Done,
        }
    }

    /// Folder of the run.
    pub fn folder(&self) -> &Folder {
        &self.folder
    }

    /// Ends the run: records its results and duration, and removes temporary files.
    ///
    /// *Errors*: a system error.
    pub fn finish(&self, results: &Value, seconds: f64) -> Result<()> {
        self.record(results, Some(seconds))?;
        self.clear()
    }

    fn record(&self, results: &Value, seconds: Option<f64>) -> Result<()> {
        let text =
            json!({"command": command(), "run": self.identity, "results": results, "seconds": seconds});
        self.folder.write(RECORD, format!("{text:#}\n").as_bytes())
    }

    fn clear(&self) -> Result<()> {
        self.temporary.iter().try_for_each(|name| self.folder.remove(name))
    }
}
