//! A queue of scene files that are worked on in parallel. Each scene has rows of its own on the disk, so an
//! interrupted run resumes, and a scene that fails does not stop the others.

mod report;

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
};

use anyhow::{Result, bail};
use sage_core::files;
use sage_data::{ReadOptions, dataset::Shard, folder};

use crate::{
    Outcome, input,
    output::{self, DatasetRun, Inputs},
    progress, terminal,
};

pub(crate) use report::{Line, Report, SceneReport};

/// Size limit of a row, bytes. A thousand candidates take 4 MB.
pub(crate) const ROW_LIMIT: u64 = 1 << 30;

/// A scene file with the name of its outputs.
pub(crate) struct Input {
    pub(crate) file: PathBuf,
    /// Name of the file without its ending, or the id of a record.
    pub(crate) scene: String,
}

/// The scenes of a command that writes a data set, alone or as a shard.
pub(crate) struct Scenes {
    root: PathBuf,
    /// All scene files.
    pub(crate) files: Vec<PathBuf>,
    /// All scenes, of this shard and of the others.
    pub(crate) all: Vec<Input>,
}

impl Scenes {
    /// Finds the scenes of a file or folder.
    ///
    /// *Errors*: there are none, or they cannot be listed.
    pub(crate) fn find(root: &Path, options: &ReadOptions) -> Result<Self> {
        let files = folder::scene_files(root)?;
        input::check_single(&files)?;
        let all = inputs(root, &files, options);
        Ok(Self { root: root.to_owned(), files, all })
    }

    /// The scenes of a shard; all without one.
    pub(crate) fn of_shard(&self, shard: Option<Shard>) -> Vec<&Input> {
        self.all.iter().filter(|input| shard.is_none_or(|shard| shard.holds(&input.scene))).collect()
    }

    /// Refuses an output folder that holds inputs, even if no output has the name of one; `further` are other inputs.
    ///
    /// *Errors*: it does.
    pub(crate) fn protect(&self, out: &Path, further: Vec<PathBuf>) -> Result<()> {
        let both = self.files.iter().flat_map(|file| [Some(file.clone()), file.canonicalize().ok()]);
        let names: Vec<PathBuf> =
            both.flatten().filter_map(|file| file.file_name().map(PathBuf::from)).collect();
        let mut read = self.files.clone();
        read.extend(further);
        output::protect_inputs(std::slice::from_ref(&self.root), &read, out, &names)?;
        Inputs::of_command_line().refuse_folder(out)
    }
}

/// How a command ends that worked on some scenes. `done` is what it does to a scene, a participle.
///
/// *Errors*: it could be done to none.
pub(crate) fn outcome([failed, left_out]: [usize; 2], own: usize, out: &Path, done: &str) -> Result<Outcome> {
    match failed {
        0 if left_out == own && left_out > 0 => bail!("no scene could be {done}: all are left out"),
        0 => Ok(Outcome::Done),
        1 if own == 1 => bail!("the scene could not be {done}"),
        all if all == own => bail!("no scene of {all} could be {done}"),
        some => {
            progress::say(&format!(
                "{some} of {own} scenes failed; the others are in `{}`; remove the cause and run the same command again",
                out.display()
            ));
            Ok(Outcome::Partial)
        }
    }
}

/// Extent of a failure.
pub(crate) enum Failure {
    /// Ends the scene; the others continue.
    Scene(anyhow::Error),
    /// Ends the scene, which counts as left out and not as failed: what is asked cannot be measured in it.
    LeftOut {
        reason: String,
        /// What is printed for it.
        lines: Vec<Line>,
    },
}

/// Name of the page that lists all scenes.
const RESERVED: &str = "index";

/// Scene files with the names of their outputs, which say which part of a recording is read. `root` is the path that the
/// user gave.
///
/// Scenes with one name, and scenes whose name cannot be that of an output, are named apart by their paths: all of them,
/// so that a scene that is added later does not take the outputs of another.
pub(crate) fn inputs(root: &Path, files: &[PathBuf], options: &ReadOptions) -> Vec<Input> {
    let name = |file: &PathBuf| {
        // A record that cannot be named fails when it is read.
        let unnamed = || file.file_name().unwrap_or_default().to_string_lossy().replace('#', "-record-");
        input::scene_name(file).unwrap_or_else(|_| unnamed())
    };
    let names: Vec<String> = files.iter().map(name).collect();
    let mut counts: HashMap<&str, usize> = HashMap::new();
    names.iter().for_each(|name| *counts.entry(name).or_default() += 1);
    let mut apart = 0;
    let mut inputs = Vec::with_capacity(files.len());
    for (file, name) in files.iter().zip(&names) {
        let is_usable = !name.contains('\\') && !name.starts_with('-') && name != RESERVED;
        let scene = if is_usable && counts[&name[..]] == 1 {
            name.clone()
        } else {
            apart += 1;
            folder::name_apart(name, &folder::name_below(root, file))
        };
        inputs.push(Input { file: file.clone(), scene: scene + &options.suffix() });
    }
    if apart > 0 {
        progress::say(&format!(
            "note: outputs of {} have names with a hash of the path, because their own are not unique or cannot be those of outputs",
            progress::count(apart, "scene")
        ));
    }
    inputs
}

/// Works on scenes on all threads; each thread takes the next scene. Returns the seconds per line of each
/// scene that this run worked on.
///
/// *Errors*: the first failure that ends the run.
pub(crate) fn work(
    inputs: &[&Input],
    run: &DatasetRun,
    report: &Report,
    one: impl Fn(&Input) -> Result<SceneReport, Failure> + Sync,
) -> Result<Vec<f64>> {
    let next = AtomicUsize::new(0);
    let (stopped, times) = (Mutex::new(None), Mutex::new(Vec::new()));
    let locked_stop = || stopped.lock().unwrap_or_else(PoisonError::into_inner);
    rayon::broadcast(|_| {
        while locked_stop().is_none() {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(input) = inputs.get(number) else { break };
            let outcome = match one(input) {
                Ok(scene) => {
                    times.lock().unwrap_or_else(PoisonError::into_inner).extend(scene.seconds);
                    report.done(number, &input.scene, scene)
                }
                Err(Failure::Scene(error)) if output::is_disk_full(&error) => Err(error.context(format!(
                    "the disk is full; {} of {} scenes are finished in `{}`; free space and run the same command again",
                    report.finished(),
                    inputs.len(),
                    run.folder().path().display()
                ))),
                Err(Failure::Scene(error)) => report.failed(number, &input.file, &error),
                Err(Failure::LeftOut { reason, lines }) => {
                    report.left_out(number, &input.scene, &reason, lines)
                }
            };
            if let Err(error) = outcome {
                locked_stop().get_or_insert(error);
            }
        }
    });
    match stopped.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(times.into_inner().unwrap_or_else(PoisonError::into_inner)),
    }
}

/// True if a file is a row of the run with a hash. A row is a JSON object whose first field is `run_hash`.
pub(crate) fn is_row_of(path: &Path, run_hash: &str) -> bool {
    let start = format!("{{\"run_hash\":\"{run_hash}\"");
    files::read_start(path, start.len() as u64).is_ok_and(|bytes| bytes == start.as_bytes())
}

/// The JSON line of a row's file, with the time of the work if this run did it.
///
/// *Errors*: the file cannot be read, or it is not a row.
fn json_line(path: &Path, seconds: Option<f64>) -> Result<Vec<u8>> {
    let text = files::read_text(path, ROW_LIMIT)?;
    let seconds = serde_json::to_string(&seconds)?;
    let open = text.trim_end().strip_suffix('}').ok_or_else(|| anyhow::anyhow!("it is no JSON object"))?;
    let mut line = Vec::with_capacity(text.len() + 32);
    terminal::write_json_line(&mut line, &format!("{open},\"seconds\":{seconds}}}"))?;
    Ok(line)
}
