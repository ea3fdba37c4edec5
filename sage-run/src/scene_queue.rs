//! A queue of scene files that are worked on in parallel. Each scene has rows of its own on the disk, so an
//! interrupted run resumes, and a scene that fails does not stop the others.

mod job;
mod report;
mod row_file;

use std::{
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

use advsage::in_one_line;
use rayon::prelude::*;
use sage_core::{defect, statistics};
use sage_data::{ReadOptions, folder};
use serde_json::{Value, json};

use crate::{
    Error, Outcome, Result, WorkError, input,
    outcome::{may_pass, may_succeed_later},
    output::{self, Counts, DatasetRun, Extent, FileRecord, Inputs, SceneRecord, ShardState, State},
    progress,
};

pub use job::{FoundRow, SceneFile, SceneJob, work_on};
pub use report::{Line, Report, ReportWords, SceneReport};
pub use row_file::is_row_of;

/// A scene file with the name of its outputs.
pub struct Input {
    /// The file.
    pub file: PathBuf,
    /// Name of the file without its ending, or the id of a record.
    pub scene: String,
}

/// The scenes of a command that writes a data set, alone or as a shard.
pub struct Scenes {
    root: PathBuf,
    /// All scene files.
    pub files: Vec<PathBuf>,
    /// All scenes, of this shard and of the others.
    pub all: Vec<Input>,
}

impl Scenes {
    /// Finds the scenes of a file or folder.
    ///
    /// *Errors*: there are none, or they cannot be listed.
    pub fn find(root: &Path, options: &ReadOptions) -> Result<Self> {
        let files = folder::scene_files(root)?;
        input::check_single(&files)?;
        let all = inputs(root, &files, options)?;
        Ok(Self { root: root.to_owned(), files, all })
    }

    /// The scenes with some of the names.
    pub fn only(mut self, is_wanted: impl Fn(&str) -> bool) -> Self {
        self.all.retain(|input| is_wanted(&input.scene));
        self
    }

    /// The scenes that a part of the run works on.
    pub fn of_part(&self, extent: Extent) -> Vec<&Input> {
        self.all.iter().filter(|input| extent.holds(&input.scene)).collect()
    }

    /// The scenes that a part of the run reports on: its own, or all.
    pub fn reported_by(&self, extent: Extent) -> Vec<&Input> {
        if extent == Extent::Join { self.all.iter().collect() } else { self.of_part(extent) }
    }

    /// Names of all scenes.
    pub fn names(&self) -> Vec<&str> {
        self.all.iter().map(|input| &*input.scene).collect()
    }

    /// Refuses an output folder that holds inputs, even if no output has the name of one; `further` are other inputs.
    ///
    /// *Errors*: it does.
    pub fn protect(&self, out: &Path, further: Vec<PathBuf>) -> Result<()> {
        let both = self.files.iter().flat_map(|file| [Some(file.clone()), file.canonicalize().ok()]);
        let names: Vec<PathBuf> =
            both.flatten().filter_map(|file| file.file_name().map(PathBuf::from)).collect();
        let mut read = self.files.clone();
        read.extend(further);
        output::protect_inputs(std::slice::from_ref(&self.root), &read, out, &names)?;
        Inputs::of_command_line().refuse_folder(out)
    }
}

/// What helps after the cause of a failure is removed.
pub const AGAIN: &str = "run the same command again";

/// How a command ends after its scenes; `done` is what it does to a scene, a participle, and `again` what to do when the
/// cause of a failure is removed.
pub fn outcome(records: &[SceneRecord], extent: Extent, out: &Path, done: &str, again: &str) -> Outcome {
    let counts = Counts::of(records);
    let (all, failed) = (counts.scenes, counts.failure_count());
    let is_shard = matches!(extent, Extent::Shard(_));
    if failed == 0 {
        // A shard may be small, so that it has no other scenes.
        if counts.left_out < all || all == 0 || is_shard {
            return Outcome::Done;
        }
        progress::say(&format!("error: no scene could be {done}: all are left out"));
        return Outcome::BadScenes;
    }
    let has_results = counts.done > 0 || records.iter().any(|record| !record.files.is_empty());
    match all {
        1 if !has_results => progress::say(&format!("error: the scene could not be {done}")),
        _ if !has_results => progress::say(&format!("error: no scene of {all} could be {done}")),
        _ => progress::say(&format!(
            "{failed} of {all} scenes failed; the others are in `{}`; remove the cause and {}",
            out.display(),
            if extent == Extent::Join { "run their shards again" } else { again }
        )),
    }
    if counts.retry > 0 { Outcome::Retry } else { Outcome::BadScenes }
}

/// What a whole run did, for its record.
pub fn results(records: &[SceneRecord]) -> Value {
    let counts = Counts::of(records);
    let mut results = json!({"scenes": counts.scenes, "done": counts.done});
    for (name, count) in [("left_out", counts.left_out), ("failed", counts.failure_count())] {
        if count > 0 {
            results[name] = json!(count);
        }
    }
    results
}

/// Extent of a failure.
pub enum Failure<E> {
    /// Ends the scene; the others continue.
    Scene(E),
    /// Ends the scene, which counts as left out and not as failed: what is asked cannot be measured in it.
    LeftOut {
        /// Why.
        reason: String,
        /// What is printed for it.
        lines: Vec<Line>,
    },
}

impl<E: WorkError> From<Error> for Failure<E> {
    fn from(error: Error) -> Self {
        Self::Scene(error.into())
    }
}

/// Scene files with the names of their outputs, which say which part of a recording is read. `root` is the path that the
/// user gave.
///
/// *Errors*: the system refuses to read a record, whose name is in it.
fn inputs(root: &Path, files: &[PathBuf], options: &ReadOptions) -> Result<Vec<Input>> {
    let name = |file: &PathBuf| {
        // A record that cannot be named fails when it is read.
        let unnamed = || file.file_name().unwrap_or_default().to_string_lossy().replace('#', "-record-");
        match input::scene_name(file).map_err(Error::from) {
            Err(error) if may_succeed_later(&error) => Err(error),
            name => Ok(name.unwrap_or_else(|_| unnamed())),
        }
    };
    let names: Vec<String> = files.par_iter().map(name).collect::<Result<_>>()?;
    let (names, apart) = folder::output_names(root, files, &names);
    let input =
        |(file, name): (&PathBuf, String)| Input { file: file.clone(), scene: name + &options.suffix() };
    let inputs = files.iter().zip(names).map(input).collect();
    if apart > 0 {
        progress::say(&format!(
            "note: outputs of {} have names with a hash of the path, because their own are not unique or cannot be those of outputs",
            progress::count(apart, "scene")
        ));
    }
    Ok(inputs)
}

/// Most failed scenes that a join names; its manifest names all.
const MOST_TOLD: usize = 20;

/// What became of the scenes of a part.
pub struct Worked {
    /// In the order of the scenes.
    pub records: Vec<SceneRecord>,
    /// The shards that are joined.
    pub shards: Vec<ShardState>,
    /// Seconds per line of each scene that this process worked on.
    seconds: Vec<f64>,
}

impl Worked {
    /// Does a part of a run: works on its scenes, or takes what the shards of a run did. `report` makes the report for a
    /// number of scenes.
    ///
    /// *Errors*: the first failure that ends the run; as [`DatasetRun::joined`].
    pub fn on<E: WorkError>(
        scenes: &Scenes,
        extent: Extent,
        run: &DatasetRun,
        report: impl FnOnce(usize) -> Report,
        one: impl Fn(&Input) -> Result<SceneReport, Failure<E>> + Sync,
    ) -> Result<Self, E> {
        run.agree_on_scenes(&scenes.names())?;
        if extent == Extent::Join {
            let (records, shards) = run.joined(&scenes.names())?;
            let failed = records.iter().filter(|record| [State::Bad, State::Retry].contains(&record.state));
            failed.take(MOST_TOLD).for_each(|record| progress::say(&format!("error: {}", record.reason)));
            return Ok(Self { records, shards, seconds: Vec::new() });
        }
        let own = scenes.of_part(extent);
        let report = report(own.len());
        let worked = work(&own, run, &report, one)?;
        report.finish(run.folder().path());
        Ok(worked)
    }

    /// True if there is any result.
    pub fn has_results(&self) -> bool {
        self.records.iter().any(|record| !record.files.is_empty())
    }

    /// Median of the seconds per line; `None` if nothing was worked on.
    pub fn median_seconds(&self) -> Option<f64> {
        statistics::median(&self.seconds)
    }
}

/// Works on scenes on all threads; each thread takes the next scene.
///
/// *Errors*: the first failure that ends the run.
fn work<E: WorkError>(
    inputs: &[&Input],
    run: &DatasetRun,
    report: &Report,
    one: impl Fn(&Input) -> Result<SceneReport, Failure<E>> + Sync,
) -> Result<Worked, E> {
    let (next, known) = (AtomicUsize::new(0), run.known_files());
    let folder = run.folder().path();
    let (stopped, times) = (Mutex::new(None), Mutex::new(Vec::new()));
    let records: Mutex<Vec<Option<SceneRecord>>> = Mutex::new(vec![None; inputs.len()]);
    let locked_stop = || stopped.lock().unwrap_or_else(PoisonError::into_inner);
    // A defect that one scene brings about costs that scene.
    let one = |input: &Input| {
        defect::caught(|| one(input)).unwrap_or_else(|defect| Err(Error::Defect(defect).into()))
    };
    rayon::broadcast(|_| {
        while locked_stop().is_none() {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(input) = inputs.get(number) else { break };
            let outcome = one(input).and_then(|scene| {
                let record = recorded(folder, input, &scene)?;
                let is_changed = |files: &Vec<FileRecord>| !files.is_empty() && *files != record.files;
                if scene.seconds.is_some() || !known.get(&input.scene).is_some_and(is_changed) {
                    return Ok((scene, record));
                }
                report.say(&format!("note: files of `{}` were changed; it is done again", input.scene));
                let mut names = record.files.iter().map(|file| &file.name);
                names.try_for_each(|name| run.folder().remove(name))?;
                let scene = one(input)?;
                let record = recorded(folder, input, &scene)?;
                Ok((scene, record))
            });
            let (outcome, record) = match outcome {
                Ok((scene, record)) => {
                    times.lock().unwrap_or_else(PoisonError::into_inner).extend(scene.seconds);
                    (report.done(number, &input.scene, scene), record)
                }
                Err(Failure::Scene(error)) if output::is_disk_full(error.as_ref()) => {
                    let full = format!(
                        "the disk is full; {} of {} scenes are finished in `{}`; free space and run the same command again: {}",
                        report.finished_count(),
                        inputs.len(),
                        folder.display(),
                        in_one_line(error.as_ref())
                    );
                    locked_stop().get_or_insert(Error::Retry(Box::new(Error::Refused(full))).into());
                    break;
                }
                Err(Failure::Scene(error)) => {
                    let state = if may_pass(error.as_ref()) { State::Retry } else { State::Bad };
                    let record =
                        SceneRecord::new(&input.scene, state, report::named(&input.file, error.as_ref()));
                    (report.report_failure(number, &input.file, error.as_ref()), record)
                }
                Err(Failure::LeftOut { reason, lines }) => {
                    let rows: Vec<String> = lines.iter().map(|line| line.row.clone()).collect();
                    let record = SceneRecord::new(&input.scene, State::LeftOut, reason.clone());
                    let record = record.with_files(folder, rows.iter().map(String::as_str));
                    let outcome = report.left_out(number, &input.scene, &reason, lines);
                    match record {
                        Ok(record) => (outcome, record),
                        Err(error) => {
                            locked_stop().get_or_insert(error.into());
                            break;
                        }
                    }
                }
            };
            records.lock().unwrap_or_else(PoisonError::into_inner)[number] = Some(record);
            if let Err(error) = outcome {
                locked_stop().get_or_insert(error.into());
            }
        }
    });
    match stopped.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(Worked {
            shards: Vec::new(),
            records: records
                .into_inner()
                .unwrap_or_else(PoisonError::into_inner)
                .into_iter()
                .flatten()
                .collect(),
            seconds: times.into_inner().unwrap_or_else(PoisonError::into_inner),
        }),
    }
}

/// The record of a scene that was worked on, with the files that are on the disk.
fn recorded(folder: &Path, input: &Input, scene: &SceneReport) -> Result<SceneRecord> {
    let state = if scene.failures.is_empty() { State::Done } else { State::Bad };
    let rows = scene.lines.iter().map(|line| &*line.row);
    SceneRecord::new(&input.scene, state, scene.failures.join("; "))
        .with_files(folder, rows.chain(scene.files.iter().map(String::as_str)))
}
