//! Long runs whose folder says what they are, so that the same command goes on with one that was broken
//! off and leaves one alone that is done.

use std::path::Path;

use anyhow::{Context, Result, bail};
use sage_core::files;
use serde_json::{Value, json};

use super::{Folder, command};
use crate::progress;

/// What a run was and how long it took.
pub(super) const RECORD: &str = "run.json";
/// Largest record that is read, bytes.
const RECORD_LIMIT: u64 = 4 << 20;

/// A run and its folder.
pub(crate) struct Run {
    folder: Folder,
    /// What tells it from others.
    identity: Value,
    /// Files and folders that are there only while it lasts.
    passing: Vec<String>,
}

/// What a folder holds of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    /// Nothing: it begins.
    New,
    /// A part: it goes on.
    Unfinished,
    /// All of it.
    Done,
}

/// The record of a folder, if it has one.
pub(super) fn read_record(folder: &Folder) -> Option<Value> {
    let text = files::read_text(&folder.path().join(RECORD), RECORD_LIMIT).ok()?;
    serde_json::from_str(&text).ok()
}

impl Run {
    /// Makes or finds the folder of a run. With `force` it begins anew, whatever is there. `passing` are
    /// files that are there only while it lasts, `outdated` others that a new run must not find, `results` what
    /// a run that is done has left.
    ///
    /// *Errors*: the folder holds something else and `force` is not given, another run has it, or the
    /// system refuses.
    pub(crate) fn start(
        path: &Path,
        identity: Value,
        force: bool,
        passing: &[&str],
        outdated: &[&str],
        results: &[&str],
    ) -> Result<(Self, State)> {
        let owned = passing.iter().map(|name| (*name).to_owned()).collect();
        let run = Self { folder: Folder::claim(path)?, identity, passing: owned };
        let state = if force { State::New } else { run.state(results) };
        match state {
            State::New
                if !force && !run.folder.holds_at_most(if run.has_begun() { &[RECORD] } else { &[] })? =>
            {
                bail!(
                    "`{}` is not empty and holds no run of the same options, data and program; give --force to write into it all the same",
                    path.display()
                );
            }
            State::New => {
                // First, so that a folder in which results are missing never says that it is done.
                run.remove(RECORD)?;
                for name in passing.iter().chain(outdated) {
                    run.remove(name)?;
                }
                run.record(&Value::Null, None)?;
            }
            State::Unfinished => {
                progress::say(&format!("note: `{}` holds this run unfinished; it goes on", path.display()));
            }
            State::Done => {
                // It may have been killed after its last word and before its last deed.
                run.clear()?;
                progress::say(&format!("note: `{}` holds this run, and it is done", path.display()));
            }
        }
        Ok((run, state))
    }

    /// Whether the record is that of a run that is not done. Alone in its folder it is of no use: that run
    /// failed before it made anything.
    fn has_begun(&self) -> bool {
        read_record(&self.folder)
            .is_some_and(|record| record["run"].is_object() && record["seconds"].is_null())
    }

    fn state(&self, results: &[&str]) -> State {
        let are_there = results.iter().all(|name| self.folder.path().join(name).is_file());
        match read_record(&self.folder).filter(|record| record["run"] == self.identity) {
            None => State::New,
            Some(record) if record["seconds"].is_null() || !are_there => State::Unfinished,
            Some(_) => State::Done,
        }
    }

    /// Its folder.
    pub(crate) fn folder(&self) -> &Folder {
        &self.folder
    }

    /// Ends it: keeps its results and how long it took, and drops what was there to go on from.
    ///
    /// *Errors*: the system refuses.
    pub(crate) fn finish(&self, results: &Value, seconds: f64) -> Result<()> {
        self.record(results, Some(seconds))?;
        self.clear()
    }

    fn record(&self, results: &Value, seconds: Option<f64>) -> Result<()> {
        let text =
            json!({"command": command(), "run": self.identity, "results": results, "seconds": seconds});
        self.folder.write(RECORD, format!("{text:#}\n").as_bytes())
    }

    fn clear(&self) -> Result<()> {
        self.passing.iter().try_for_each(|name| self.remove(name))
    }

    fn remove(&self, name: &str) -> Result<()> {
        let path = self.folder.path().join(name);
        let outcome = match path.symlink_metadata() {
            Err(_) => return Ok(()),
            Ok(found) if found.is_dir() => std::fs::remove_dir_all(&path),
            Ok(_) => std::fs::remove_file(&path),
        };
        outcome.with_context(|| format!("cannot remove `{}`", path.display()))
    }
}
