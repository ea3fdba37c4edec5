//! Formats with a file per scene.

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, anyhow};
use sage_core::files::{self, Existing};
use sage_data::{
    Recording, dataset, folder,
    openscenario::{Export, Options},
    repairs,
    stream::{Inputs, Item, map_in_order},
    womd::VERSION,
};

use super::{Tally, file_name, with_suffix};
use crate::{
    cli::{ConvertArgs, ConvertFormat},
    output::{self, DatasetRun},
    progress::{self, Progress},
    scenario_files,
};

/// A scene, and the name of its file; or why it has none.
enum Job {
    Convert(Item, PathBuf),
    Refused(anyhow::Error),
}

/// What became of a scene.
enum Done {
    Written(Vec<String>),
    /// An earlier run wrote it.
    Found,
    Failed(anyhow::Error),
}

/// Converts all scenes.
///
/// *Errors*: a full disk.
pub(super) fn convert(
    args: &ConvertArgs,
    inputs: &Inputs,
    run: &DatasetRun,
    progress: &mut Progress,
    tally: &mut Tally,
) -> Result<()> {
    let root = run.folder().path().canonicalize().unwrap_or_else(|_| run.folder().path().to_owned());
    let given = inputs.files().filter_map(|file| file.canonicalize().ok()).collect();
    let mut names = Names { args, run, taken: HashSet::new(), inputs: given, root, folders: HashSet::new() };
    let jobs = inputs.items().filter_map(|item| names.job(item).transpose());
    let jobs = jobs.map(|job| job.unwrap_or_else(Job::Refused));
    let size = |job: &Job| if let Job::Convert(item, _) = job { item.size() } else { 0 };
    let folder = run.folder().path();
    map_in_order(
        jobs,
        size,
        |job| one(args, folder, job),
        |done| match done {
            Done::Written(notes) => {
                tally.whole += 1;
                tally.add_notes(notes.into_iter().map(|note| (note, 1)));
                progress.step();
                Ok(())
            }
            Done::Found => {
                tally.whole += 1;
                progress.step_found();
                Ok(())
            }
            Done::Failed(error) if output::is_disk_full(&error) => Err(error),
            Done::Failed(error) => {
                tally.failed += 1;
                progress.step();
                progress.say(&format!("error: {error:#}"));
                Ok(())
            }
        },
    )
}

/// Names of the outputs.
struct Names<'r> {
    args: &'r ConvertArgs,
    run: &'r DatasetRun,
    /// Names that scenes have.
    taken: HashSet<PathBuf>,
    /// The input files and the output folder, links resolved.
    inputs: HashSet<PathBuf>,
    root: PathBuf,
    /// Folders that exist in the output folder.
    folders: HashSet<PathBuf>,
}

impl Names<'_> {
    /// The work on a scene; `None` if it belongs to another part.
    fn job(&mut self, item: Item) -> Result<Option<Job>> {
        let path = item.path().to_owned();
        let (name, dataset) = match item.name() {
            Ok((name, dataset)) => (with_suffix(&name, &self.args.reading.options().suffix()), dataset),
            Err(error) => return Ok(Some(Job::Refused(error.into()))),
        };
        if self.args.shard.is_some_and(|shard| !shard.holds(&name.to_string_lossy())) {
            return Ok(None);
        }
        let file = |name: &Path| match &dataset {
            Some(dataset) if self.args.to == ConvertFormat::Pickle => {
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
        if self.inputs.contains(&self.root.join(&name)) {
            let error = anyhow!("`{}` would take the place of an input; name another --out", name.display());
            return Ok(Some(Job::Refused(error)));
        }
        self.taken.insert(name.clone());
        if let Some(parent) = name.parent().filter(|parent| !parent.as_os_str().is_empty())
            && self.folders.insert(parent.to_owned())
        {
            self.run.folder().inner(parent)?;
        }
        Ok(Some(Job::Convert(item, name)))
    }
}

/// Converts one scene.
fn one(args: &ConvertArgs, folder: &Path, job: Job) -> Done {
    let (item, name) = match job {
        Job::Convert(item, name) => (item, name),
        Job::Refused(error) => return Done::Failed(error),
    };
    let target = folder.join(&name);
    // No scene file is empty, and a file under its final name is complete.
    let is_found = std::fs::metadata(&target).is_ok_and(|found| found.is_file() && found.len() > 0);
    if is_found && !args.folder.force {
        return Done::Found;
    }
    let written =
        item.read(&args.reading.options()).map_err(anyhow::Error::from).and_then(|recording| match args.to {
            ConvertFormat::Openscenario => write_scenario(args, &recording, &target),
            _ => Ok(recording.write(&target).map(|()| repairs::notes_of(&recording).collect())?),
        });
    written.map_or_else(Done::Failed, Done::Written)
}

/// Writes a scenario and its map. Returns what they lack.
fn write_scenario(args: &ConvertArgs, recording: &Recording, target: &Path) -> Result<Vec<String>> {
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
    if !map.is_file() || args.folder.force {
        write(&map, &export.network().xml)?;
    }
    write(target, &scenario)?;
    let notes = export.notes().map(|note| format!("`{}`: {note}", recording.path.display()));
    Ok(repairs::notes_of(recording).chain(notes).collect())
}
