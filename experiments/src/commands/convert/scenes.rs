//! Formats with a file per scene.

use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
};

use advsage::scenario_files;
use anyhow::{Context as _, Result, anyhow};
use sage_core::files::{self, Existing};
use sage_data::{
    EncodedGpuDrive, Format, Recording, dataset, folder,
    openscenario::{Export, Options},
    repairs,
    stream::{Inputs, Item, map_in_order},
    womd::VERSION,
};
use sage_run::{
    Error,
    outcome::{caught, is_defect, may_pass, may_succeed_later},
    output::{self, DatasetRun, Extent, FileRecord, SceneRecord, State},
    progress::{self, Progress},
};

use super::{Tally, file_name, with_suffix};
use crate::cli::ConvertArgs;

/// Size limit of a scenario, bytes.
const SCENARIO_LIMIT: u64 = 1 << 30;

/// A scene, and the name of its file; or its path, and why it has no name.
enum Job {
    Convert(Item, PathBuf),
    Refused(PathBuf, anyhow::Error),
}

/// What became of a scene.
struct Done {
    /// Name of its file, or its path if it has none.
    name: String,
    result: Result<Converted>,
}

struct Converted {
    record: SceneRecord,
    notes: Vec<String>,
    /// True if an earlier run wrote it.
    is_found: bool,
}

/// Converts all scenes.
///
/// *Errors*: a full disk.
pub(super) fn convert(
    args: &ConvertArgs,
    extent: Extent,
    inputs: &Inputs,
    run: &DatasetRun,
    progress: &mut Progress,
    tally: &mut Tally,
) -> Result<()> {
    let root = run.folder().path().canonicalize().unwrap_or_else(|_| run.folder().path().to_owned());
    let given = inputs.files().filter_map(|file| file.canonicalize().ok()).collect();
    let mut names = Names {
        args,
        extent,
        run,
        taken: HashSet::new(),
        inputs: given,
        root,
        folders: HashSet::new(),
        all: Vec::new(),
        refused: None,
    };
    let jobs = inputs.items().filter_map(|item| names.job(item).transpose());
    let jobs = jobs.map(|job| job.unwrap_or_else(|(path, error)| Job::Refused(path, error)));
    let size = |job: &Job| if let Job::Convert(item, _) = job { item.size() } else { 0 };
    let (folder, known) = (run.folder().path(), run.known_files());
    map_in_order(
        jobs,
        size,
        |job| one(args, folder, job, &known),
        |Done { name, result }| {
            match result {
                Ok(Converted { record, notes, is_found }) => {
                    tally.whole += 1;
                    tally.add_notes(notes.into_iter().map(|note| (note, 1)));
                    tally.records.push(record);
                    if is_found { progress.step_found() } else { progress.step() }
                }
                Err(error) if output::is_disk_full(error.as_ref()) => return Err(error),
                Err(error) => {
                    let state = if may_pass(error.as_ref()) { State::Retry } else { State::Bad };
                    tally.failed += 1;
                    tally.records.push(SceneRecord::new(&name, state, format!("{error:#}")));
                    progress.step();
                    progress.say(&format!("error: {error:#}"));
                }
            }
            Ok(())
        },
    )?;
    // The shards could not agree on the names.
    if let Some(problem) = names.refused {
        return Err(Error::Retry(Box::new(Error::Refused(problem))).into());
    }
    tally.names = names.all;
    Ok(())
}

/// Names of the outputs.
struct Names<'r> {
    args: &'r ConvertArgs,
    extent: Extent,
    run: &'r DatasetRun,
    /// Names that scenes have.
    taken: HashSet<PathBuf>,
    /// The input files and the output folder, links resolved.
    inputs: HashSet<PathBuf>,
    root: PathBuf,
    /// Folders that exist in the output folder.
    folders: HashSet<PathBuf>,
    /// Names of the outputs of all parts.
    all: Vec<String>,
    /// Why the system refused to read the name of a scene.
    refused: Option<String>,
}

impl Names<'_> {
    /// The work on a scene; `None` if it belongs to another part.
    ///
    /// *Errors*: the path of a scene without a name, and why it has none.
    fn job(&mut self, item: Item) -> Result<Option<Job>, (PathBuf, anyhow::Error)> {
        let path = item.path().to_owned();
        let (name, dataset) = match item.name() {
            Ok((name, dataset)) => (
                with_suffix(&apart_from_options(name, &path), &self.args.reading.options().suffix()),
                dataset,
            ),
            Err(error) => {
                let is_of_the_system = may_succeed_later(&error);
                let error = anyhow::Error::from(error);
                if is_of_the_system {
                    self.refused.get_or_insert_with(|| format!("{error:#}"));
                }
                let own = path.to_string_lossy().into_owned();
                self.all.push(own.clone());
                return if self.extent.holds(&own) { Err((path, error)) } else { Ok(None) };
            }
        };
        let file = |name: &Path| match &dataset {
            Some(dataset) if self.args.to == Format::Pickle => {
                dataset::file_name(dataset, VERSION, &name.to_string_lossy()).into()
            }
            _ => file_name(name, self.args.to),
        };
        let mut output = file(&name);
        if self.taken.contains(&output) {
            // Another scene has this name.
            let apart = folder::name_apart(&name.file_name().unwrap_or_default().to_string_lossy(), &path);
            output = file(&name.with_file_name(apart));
            progress::say(&format!(
                "note: a scene before `{}` has its name; it becomes `{}`",
                path.display(),
                output.display()
            ));
        }
        let name = output;
        self.all.push(name.to_string_lossy().into_owned());
        self.taken.insert(name.clone());
        if !self.extent.holds(&name.to_string_lossy()) {
            return Ok(None);
        }
        if self.inputs.contains(&self.root.join(&name)) {
            let error = anyhow!("`{}` would take the place of an input; name another --out", name.display());
            return Err((name, error));
        }
        if let Some(parent) = name.parent().filter(|parent| !parent.as_os_str().is_empty())
            && self.folders.insert(parent.to_owned())
        {
            self.run.folder().inner(parent).map_err(|error| (name.clone(), error.into()))?;
        }
        Ok(Some(Job::Convert(item, name)))
    }
}

/// The name of a scene; one that begins with `-`, which a program would take for an option, gets another name.
fn apart_from_options(name: PathBuf, path: &Path) -> PathBuf {
    let last = name.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if last.starts_with('-') { name.with_file_name(folder::name_apart(&last, path)) } else { name }
}

/// Converts one scene.
fn one(args: &ConvertArgs, folder: &Path, job: Job, known: &HashMap<String, Vec<FileRecord>>) -> Done {
    match job {
        Job::Convert(item, file) => {
            let name = file.to_string_lossy().into_owned();
            let known = known.get(&name).map_or(&[][..], |files| files);
            let path = item.path().display().to_string();
            let result = caught(|| converted(args, folder, item, &name, known));
            let named = |error: anyhow::Error| {
                if is_defect(error.as_ref()) { error.context(format!("`{path}`")) } else { error }
            };
            Done { result: result.map_err(named), name }
        }
        Job::Refused(path, error) => Done { name: path.to_string_lossy().into_owned(), result: Err(error) },
    }
}

fn converted(
    args: &ConvertArgs,
    folder: &Path,
    item: Item,
    name: &str,
    known: &[FileRecord],
) -> Result<Converted> {
    let target = folder.join(name);
    // No scene file is empty, and a file under its final name is complete.
    let is_whole = || std::fs::metadata(&target).is_ok_and(|found| found.is_file() && found.len() > 0);
    let is_changed = || known.iter().any(|file| !file.holds(folder));
    let is_found = !args.folder.force && is_whole() && !is_changed();
    let notes = if is_found {
        Vec::new()
    } else {
        let recording = item.read(&args.reading.options())?;
        match args.to {
            Format::OpenScenario => write_scenario(args, &recording, &target, !known.is_empty())?,
            Format::GpuDrive => {
                let EncodedGpuDrive { json, notes } = recording.to_gpudrive()?;
                files::write(&target, &json, Existing::Replace)
                    .with_context(|| format!("cannot write `{}`", target.display()))?;
                repairs::notes_of(&recording).chain(notes.into_keys()).collect()
            }
            Format::Native | Format::Pickle | Format::TfRecord | Format::Parquet => {
                recording.write(&target)?;
                repairs::notes_of(&recording).collect()
            }
        }
    };
    let map = if args.to == Format::OpenScenario { map_of(&target)? } else { None };
    let files = std::iter::once(name.to_owned()).chain(map.map(|map| beside(name, &map)));
    let files: Vec<String> = files.collect();
    let record = SceneRecord::new(name, State::Done, String::new());
    let record = record.with_files(folder, files.iter().map(String::as_str))?;
    Ok(Converted { record, notes, is_found })
}

/// Name of the map of a scenario; `None` if it names none.
fn map_of(scenario: &Path) -> Result<Option<String>> {
    const START: &str = "<LogicFile filepath=\"";
    let text = files::read_text(scenario, SCENARIO_LIMIT)
        .with_context(|| format!("cannot read `{}`", scenario.display()))?;
    let name = text.split_once(START).and_then(|(_, rest)| rest.split_once('"'));
    Ok(name.map(|(name, _)| name.to_owned()))
}

/// Name of a file in the folder of another.
fn beside(name: &str, file: &str) -> String {
    name.rsplit_once('/').map_or(file.to_owned(), |(folder, _)| format!("{folder}/{file}"))
}

/// Writes a scenario and its map. Returns what they lack.
fn write_scenario(
    args: &ConvertArgs,
    recording: &Recording,
    target: &Path,
    is_changed: bool,
) -> Result<Vec<String>> {
    let options = Options {
        standard: args.standard.unwrap_or_default(),
        ego: args.ego.unwrap_or_default(),
        license: scenario_files::license(recording)?,
    };
    let export = Export::new(&recording.scene, options);
    let scenario = export.scenario(&recording.scene, &scenario_files::provenance(recording)?);
    let write = |path: &Path, text: &str| {
        files::write(path, text.as_bytes(), Existing::Replace)
            .with_context(|| format!("cannot write `{}`", path.display()))
    };
    // The scenario goes last, because its presence means that its map is there.
    let map = target.with_file_name(export.network().file_name());
    if !map.is_file() || args.folder.force || is_changed {
        write(&map, &export.network().xml)?;
    }
    write(target, &scenario)?;
    let notes = export.notes().map(|note| format!("`{}`: {note}", recording.path.display()));
    Ok(repairs::notes_of(recording).chain(notes).collect())
}
