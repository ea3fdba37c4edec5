//! A run that writes a data set into a folder: as a whole, as one of several concurrent shards, or as the join of shards.

use std::{collections::BTreeSet, path::Path, time::Instant};

use advsage::WithContext as _;
use sage_core::files::OutputLock;
use sage_data::{
    dataset::{self, Shard},
    folder,
};
use serde_json::{Value, json};

use super::{
    Extent, Folder, command,
    command_line::full_command,
    manifest::{MANIFEST, Manifest, SHARDS, SceneRecord, shard_files},
    manifests::ShardState,
    run::{self, RECORD, read_record},
};
use crate::{Error, Result, progress};

/// A run and its folder. The files of a finished scene stay, so the same command resumes the run.
pub struct DatasetRun {
    pub(super) folder: Folder,
    identity: Value,
    /// Hash of the identity, which marks the rows of the run.
    pub(super) hash: String,
    pub(super) extent: Extent,
    /// Files that a finished run has.
    results: &'static [&'static str],
    pub(super) clock: Instant,
}

/// How a run ended, for its record.
pub struct Ended<'r> {
    /// What became of the scenes.
    pub records: &'r [SceneRecord],
    /// The shards that it joins.
    pub shards: &'r [ShardState],
    /// Counts over all scenes.
    pub results: Value,
    /// Median time of an attack in this process.
    pub seconds_per_attack: Option<f64>,
    /// True if the folder is a data set of pickles.
    pub has_pickles: bool,
    /// True if nothing is left to do; else the same command tries the scenes that failed again.
    pub is_done: bool,
}

/// Hash of what identifies a run, as its rows begin with it.
pub fn run_hash(identity: &Value) -> String {
    blake3::hash(identity.to_string().as_bytes()).to_hex()[..16].to_owned()
}

impl DatasetRun {
    /// Creates or opens the folder of a run, which has `results` when it is done. With `force` the run starts again: files
    /// named `outdated` are removed, and the others stay.
    ///
    /// *Errors*: the folder has other content and `force` is not given; another run holds it; there are no shards to join;
    /// a system error.
    pub fn start(
        path: &Path,
        identity: Value,
        force: bool,
        extent: Extent,
        results: &'static [&'static str],
        outdated: impl FnOnce() -> Vec<String>,
    ) -> Result<Self> {
        if extent != Extent::Join {
            super::create_folder(path)?;
        }
        // A shard also holds the whole folder until the record is written.
        let (claim, whole_folder) = match extent {
            Extent::Whole | Extent::Join => {
                (OutputLock::folder(path, &command()).map_err(Error::Lock)?, None)
            }
            Extent::Shard(Shard { number, of }) => {
                let (own, whole) = OutputLock::shard(path, number, of, &command()).map_err(Error::Lock)?;
                (own, Some(whole))
            }
        };
        let hash = run_hash(&identity);
        let folder = Folder { path: path.to_owned(), claim, is_begun: false };
        let run = Self { folder, identity, hash, extent, results, clock: Instant::now() };
        // A damaged record does not keep a run from beginning again.
        let record = if force { read_record(&run.folder).unwrap_or(None) } else { read_record(&run.folder)? };
        let is_same = record.as_ref().is_some_and(|record| record["run"] == run.identity);
        if !is_same && let Some(holder) = run.other_shard()? {
            return Err(Error::Refused(format!(
                "`{}` is in use by a shard with other options ({holder}); wait for its end",
                path.display()
            )));
        }
        if force {
            run.refuse_other_data_set()?;
            // The record goes first, so that a folder with rows of two runs never has the record of one run.
            run.folder.remove(RECORD)?;
            outdated().iter().try_for_each(|name| run.folder.remove(name))?;
            run.remove_shards()?;
            run.record(&Value::Null, None, None, None)?;
        } else if !is_same {
            match run.refuse_other_run(record.as_ref()) {
                // Without locks another shard may have begun the same run meanwhile.
                Err(_) if matches!(extent, Extent::Shard(_)) && run.is_recorded() => {}
                outcome => {
                    outcome?;
                    if record.is_some() {
                        run.folder.remove(MANIFEST)?;
                        run.remove_shards()?;
                    }
                    run.record(&Value::Null, None, None, None)?;
                }
            }
        } else if run.is_done() {
            progress::say(&format!("note: `{}` holds this run, and it is done", path.display()));
        } else if extent == Extent::Whole && !run.folder.holds_at_most(&[RECORD, SHARDS])? {
            progress::say(&format!("note: `{}` holds this run unfinished; it resumes", path.display()));
        }
        drop(whole_folder);
        Ok(run)
    }

    /// Hash of what identifies the run.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Folder of the run.
    pub fn folder(&self) -> &Folder {
        &self.folder
    }

    /// True if the record of the folder is of this run.
    fn is_recorded(&self) -> bool {
        self.recorded()["run"] == self.identity
    }

    /// The record of the folder; null without one.
    fn recorded(&self) -> Value {
        read_record(&self.folder).ok().flatten().unwrap_or_default()
    }

    /// True if the record says that all is done, and the results are there.
    pub fn is_done(&self) -> bool {
        !self.recorded()["seconds"].is_null()
            && self.results.iter().all(|name| self.folder.path().join(name).is_file())
    }

    /// What the record says that the run did.
    pub fn recorded_results(&self) -> Value {
        self.recorded()["results"].clone()
    }

    /// Writes the summary and the mapping for all pickles of the folder, the manifest and the record. Returns the number of
    /// pickles in the summary.
    ///
    /// *Errors*: a pickle in the folder is not a scene; a system error.
    pub fn finish(&self, ended: Ended) -> Result<usize> {
        let path = self.folder.path();
        let Ended { records, shards, results, seconds_per_attack, has_pickles, is_done } = ended;
        let mut listed = 0;
        if has_pickles || path.join(dataset::SUMMARY).is_file() {
            listed = dataset::write_tables(path).with_context(|| {
                "the summary of the data set was not written; remove the cause and run the same command again"
            })?;
        }
        if self.extent == Extent::Join {
            // Killed shards leave temporary files.
            let files = records.iter().flat_map(|record| &record.files);
            let parents = files.filter_map(|file| Path::new(&file.name).parent());
            let inner: BTreeSet<&Path> = parents.filter(|parent| !parent.as_os_str().is_empty()).collect();
            inner.into_iter().try_for_each(|inner| self.folder.inner(inner).map(drop))?;
        }
        Manifest::write(&path.join(MANIFEST), &self.hash, None, records)?;
        let own_seconds = self.clock.elapsed().as_secs_f64();
        let (seconds, core_seconds) = match shards.is_empty() {
            true => (own_seconds, own_seconds * rayon::current_num_threads() as f64),
            false => (
                shards.iter().map(|shard| shard.seconds).sum(),
                shards.iter().map(|shard| shard.seconds * shard.threads as f64).sum(),
            ),
        };
        // A rerun that found everything done keeps the times of the run that did it.
        let record = self.recorded();
        let keeps = seconds_per_attack.is_none()
            && shards.is_empty()
            && record["results"] == results
            && !record["seconds"].is_null();
        if !keeps {
            self.record(&results, seconds_per_attack, is_done.then_some(seconds), Some(core_seconds))?;
        }
        self.remove_shards()?;
        Ok(listed)
    }

    /// Refuses a folder that holds something else than the run, unless that is a run that failed before it wrote anything.
    fn refuse_other_run(&self, record: Option<&Value>) -> Result<()> {
        let path = self.folder.path();
        let run = record.map(|record| &record["run"]).filter(|run| run.is_object());
        let has_ended = record.is_some_and(|record| !record["seconds"].is_null());
        if let Some(recorded) = run {
            let is_unused = !has_ended
                && self.folder.holds_at_most(&[RECORD, MANIFEST, SHARDS])?
                && shard_files(path)?.is_empty()
                && self.extent != Extent::Join;
            if !is_unused {
                return Err(Error::Refused(format!(
                    "`{}` holds another run: {}; {}",
                    path.display(),
                    run::difference(recorded, &self.identity),
                    match self.extent {
                        Extent::Whole => "name another --out, or give --force to write into it anyway",
                        Extent::Shard(_) =>
                            "run all shards with the same command and program, or name another --out",
                        Extent::Join => "join it with the program that ran the shards",
                    }
                )));
            }
        } else if !self.folder.holds_at_most(&[])? || self.extent == Extent::Join {
            return Err(Error::Refused(format!(
                "`{}` is not empty and holds no run of the same command, inputs and program; give --force to write into it anyway",
                path.display()
            )));
        }
        Ok(())
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
            Some(other) => Err(Error::Refused(format!(
                "`{}` is a data set that lists `{}`; name another --out",
                path.display(),
                other.display()
            ))),
            None => Ok(()),
        }
    }

    fn other_shard(&self) -> Result<Option<String>> {
        let Extent::Shard(Shard { number, of }) = self.extent else { return Ok(None) };
        OutputLock::other_shard(self.folder.path(), number, of).map_err(Error::Lock)
    }

    fn record(
        &self,
        results: &Value,
        per_attack: Option<f64>,
        seconds: Option<f64>,
        core_seconds: Option<f64>,
    ) -> Result<()> {
        let record = json!({
            "command": command(), "full_command": full_command(), "run": self.identity, "results": results,
            "per_attack": {"seconds": per_attack}, "seconds": seconds, "core_seconds": core_seconds,
        });
        self.folder.write(RECORD, format!("{record:#}\n").as_bytes())
    }
}
