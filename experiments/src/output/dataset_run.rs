//! A run that writes a data set into a folder, alone or as one of several concurrent shards.

use std::path::Path;

use anyhow::{Context, Result, bail};
use sage_core::files::OutputLock;
use sage_data::{
    dataset::{self, Shard},
    folder,
};
use serde_json::{Value, json};

use super::{
    Folder, command,
    run::{RECORD, read_record},
};
use crate::progress;

/// A run and its folder. The files of a finished scene stay, so the same command resumes the run.
pub(crate) struct DatasetRun {
    folder: Folder,
    identity: Value,
    /// Hash of the identity, which marks the rows of the run.
    hash: String,
    shard: Option<Shard>,
}

/// Hash of what identifies a run, as its rows begin with it.
pub(crate) fn run_hash(identity: &Value) -> String {
    blake3::hash(identity.to_string().as_bytes()).to_hex()[..16].to_owned()
}

impl DatasetRun {
    /// Creates or opens the folder of a run. With `force` the run starts again: files named `outdated` are
    /// removed, and the others stay.
    ///
    /// *Errors*: the folder has other content and `force` is not given; another run holds it; a system error.
    pub(crate) fn start(
        path: &Path,
        identity: Value,
        force: bool,
        shard: Option<Shard>,
        outdated: impl FnOnce() -> Vec<String>,
    ) -> Result<Self> {
        super::create_folder(path)?;
        // A shard also holds the whole folder until the record is written.
        let (claim, whole_folder) = match shard {
            None => (OutputLock::folder(path, &command())?, None),
            Some(Shard { number, of }) => {
                let (own, whole) = OutputLock::shard(path, number, of, &command())?;
                (own, Some(whole))
            }
        };
        let hash = run_hash(&identity);
        let run = Self { folder: Folder { path: path.to_owned(), claim }, identity, hash, shard };
        let record = read_record(&run.folder);
        let is_same = record.as_ref().is_some_and(|record| record["run"] == run.identity);
        if !is_same && let Some(holder) = run.other_shard()? {
            bail!(
                "`{}` is in use by a shard with other options ({holder}); wait for its end",
                path.display()
            );
        }
        if force {
            run.refuse_other_data_set()?;
            // The record goes first, so that a folder with rows of two runs never has the record of one run.
            run.folder.remove(RECORD)?;
            outdated().iter().try_for_each(|name| run.folder.remove(name))?;
            run.record(&Value::Null, None, None)?;
        } else if !is_same {
            let is_unused = record.as_ref().is_some_and(|r| r["run"].is_object() && r["seconds"].is_null());
            if !run.folder.holds_at_most(if is_unused { &[RECORD] } else { &[] })? {
                bail!(
                    "`{}` is not empty and holds no run of the same command, inputs and program; give --force to write into it anyway",
                    path.display()
                );
            }
            run.record(&Value::Null, None, None)?;
        } else if record.is_some_and(|record| !record["seconds"].is_null()) {
            progress::say(&format!("note: `{}` holds this run, and it is done", path.display()));
        } else if !run.folder.holds_at_most(&[RECORD])? {
            progress::say(&format!("note: `{}` holds this run unfinished; it resumes", path.display()));
        }
        drop(whole_folder);
        Ok(run)
    }

    /// Hash of what identifies the run.
    pub(crate) fn hash(&self) -> &str {
        &self.hash
    }

    /// Folder of the run.
    pub(crate) fn folder(&self) -> &Folder {
        &self.folder
    }

    /// Writes the summary and the mapping for all pickles of the folder, and the record. The record holds
    /// `results`, the median time of an attack in this process, and the time of the whole run if it is done.
    /// Returns the results and the number of pickles in the summary.
    ///
    /// *Errors*: a pickle in the folder is not a scene; a system error.
    pub(crate) fn finish(
        self,
        has_pickles: bool,
        results: impl FnOnce() -> Value,
        seconds_per_attack: Option<f64>,
        seconds: impl FnOnce(&Value) -> Option<f64>,
    ) -> Result<(Value, usize)> {
        // Shards that end at the same time wait for each other.
        let path = self.folder.path();
        let _whole = self.shard.map(|_| OutputLock::folder_shortly(path, &command())).transpose()?;
        // Counted first: a scene that another shard finishes now may be missing in the tables.
        let results = results();
        let mut listed = 0;
        if has_pickles || path.join(dataset::SUMMARY).is_file() {
            listed = dataset::write_tables(path).context(
                "the summary of the data set was not written; remove the cause and run the same command again",
            )?;
        }
        let seconds = seconds(&results);
        // A rerun that found everything done keeps the times of the run that did it.
        let record = read_record(&self.folder).unwrap_or_default();
        let keeps =
            seconds_per_attack.is_none() && record["results"] == results && !record["seconds"].is_null();
        if !keeps {
            self.record(&results, seconds_per_attack, seconds)?;
        }
        Ok((results, listed))
    }

    /// Refuses a folder whose tables list scenes of other folders: they would be lost.
    fn refuse_other_data_set(&self) -> Result<()> {
        let path = self.folder.path();
        if !path.join(dataset::SUMMARY).is_file() {
            return Ok(());
        }
        // A summary that cannot be read lists nothing that could be lost.
        let listed = folder::scene_files(path).unwrap_or_default();
        match listed.iter().find(|file| file.parent() != Some(path)) {
            Some(other) => bail!(
                "`{}` is a data set that lists `{}`; name another --out",
                path.display(),
                other.display()
            ),
            None => Ok(()),
        }
    }

    fn other_shard(&self) -> Result<Option<String>> {
        let Some(Shard { number, of }) = self.shard else { return Ok(None) };
        Ok(OutputLock::other_shard(self.folder.path(), number, of)?)
    }

    fn record(&self, results: &Value, per_attack: Option<f64>, seconds: Option<f64>) -> Result<()> {
        let record = json!({
            "command": command(), "run": self.identity, "results": results,
            "per_attack": {"seconds": per_attack}, "seconds": seconds,
        });
        self.folder.write(RECORD, format!("{record:#}\n").as_bytes())
    }
}
