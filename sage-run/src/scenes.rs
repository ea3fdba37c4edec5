//! Lists of scenes. A scene is read when it is needed (2 ms), not kept (3 MB), so memory holds one scene per thread, however
//! long the list is. Measurements stop if a scene changed; training keeps scenes.

mod egos;
mod entry;
mod failed;
mod recording;
mod roles;
mod split;

use std::{
    collections::{BTreeMap, HashSet},
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use advsage::in_one_line;
use rayon::prelude::*;
use sage_core::{
    motion::NOW,
    objective::{Context, ContextOptions},
    scene::SceneData,
};
use sage_data::{ReadOptions, checks, folder, womd};

use crate::{
    AnyError, Error, Outcome, Result, WorkError,
    outcome::caught,
    output,
    progress::{self, Progress, count},
};

pub use egos::with_other_egos;
use entry::{Entry, Origin, read};
pub use failed::{Failed, outcome_without};
pub use roles::with_other_roles;
pub use split::Filter;

/// Scenes processed in parallel before their results are returned in order.
const WINDOW: usize = 64;
/// Memory limit for the scenes of a training run, bytes. A recorded scene takes about 3 MB.
const MEMORY_LIMIT: usize = 8 << 30;

/// Kind under which files that are no scene are counted.
const UNREADABLE: &str = "unreadable";

/// A list of scenes.
#[derive(Default)]
pub struct Scenes {
    entries: Vec<Entry>,
    /// How files are read.
    options: ReadOptions,
    /// Number of scenes with each important warning; filled when all scenes have been read once.
    warnings: BTreeMap<&'static str, usize>,
    /// Why scenes could not be read or worked on, by name.
    failed: Arc<Mutex<BTreeMap<String, Failed>>>,
    /// Why scenes were not kept, by their number in the whole list.
    not_kept: BTreeMap<usize, String>,
}

/// A scene or why it is not kept, and its important warnings with their kinds.
type Checked = (Result<Entry, &'static str>, Vec<(&'static str, String)>);

/// Why scenes are not kept.
const NO_SUCH: &str = "there is no procedural scene of this number";
const NOT_ATTACKABLE: &str = "it has no ego path, less than 1 s of recording after now, or no adversary that is valid now apart from the ego";

impl Scenes {
    /// Scenes under the given paths, filtered by a splits file and by names. Without paths, this many
    /// procedural scenes of a seed, the kinds in turn.
    ///
    /// *Errors*: a folder cannot be listed; there is no such split or no such scene.
    pub fn of(paths: &[PathBuf], split: &Filter, procedural: u64, seed: u64) -> Result<Self> {
        if paths.is_empty() {
            if split.splits.is_some() || !split.scenes.is_empty() {
                let problem = "--splits and --scenes select among recorded scenes; give their folder as PATH";
                return Err(Error::Refused(problem.to_owned()));
            }
            return Ok(Self::procedural(procedural, seed));
        }
        let mut files = Vec::new();
        for path in paths {
            files.extend(folder::scene_files(path)?);
        }
        Self::of_files(split::selected(files, split)?, split.reading.clone())
    }

    /// All scenes under the given paths.
    ///
    /// *Errors*: a folder cannot be listed.
    pub fn under(paths: &[PathBuf]) -> Result<Self> {
        let files = paths.iter().map(|path| folder::scene_files(path)).collect::<Result<Vec<_>, _>>()?;
        Self::of_files(files.concat(), ReadOptions::default())
    }

    /// Procedural scenes, the kinds in turn. A number for which no scene can be generated is skipped later.
    pub fn procedural(count: u64, seed: u64) -> Self {
        let entry = |number| Entry {
            origin: Origin::Procedural(number, seed),
            content: None,
            number: number as usize,
        };
        Self { entries: (0..count).map(entry).collect(), ..Self::default() }
    }

    fn of_files(files: Vec<PathBuf>, options: ReadOptions) -> Result<Self> {
        // A file that is given twice counts once.
        let mut seen = HashSet::new();
        let mut entries = Vec::with_capacity(files.len());
        for file in files {
            if !seen.insert(file.canonicalize().unwrap_or_else(|_| file.clone())) {
                continue;
            }
            let origin = if file.is_file() || womd::is_record_path(&file) {
                Origin::File(file)
            } else {
                Origin::InMemory(Arc::new(read(&file, &options)?))
            };
            entries.push(Entry { origin, content: None, number: entries.len() });
        }
        Ok(Self { entries, options, ..Self::default() })
    }

    /// Names of the scenes, as in results.
    pub fn names(&self) -> Vec<String> {
        self.entries.iter().map(Entry::name).collect()
    }

    /// Number of a scene in the whole list.
    pub fn number_in_list(&self, number: usize) -> usize {
        self.entries[number].number
    }

    /// The scenes of the whole list whose numbers are `wanted`.
    pub fn only(mut self, wanted: impl Fn(usize) -> bool) -> Self {
        self.entries.retain(|entry| wanted(entry.number));
        self
    }

    /// Why scenes were not kept, by their number in the whole list.
    pub fn not_kept(&self) -> &BTreeMap<usize, String> {
        &self.not_kept
    }

    /// Why a scene could not be read or worked on; `None` if it could.
    pub fn failure(&self, name: &str) -> Option<Failed> {
        self.failures().get(name).cloned()
    }

    /// Hash of a scene's content. Only valid after [`Scenes::attackable`] or [`Scenes::only_readable`].
    pub fn content(&self, number: usize) -> String {
        let hex = |byte: &u8| format!("{byte:02x}");
        self.entries[number].content.unwrap_or_default().iter().map(hex).collect()
    }

    /// Number of scenes.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The scenes in groups of `size`.
    pub fn windows(&self, size: usize) -> impl Iterator<Item = Self> {
        self.entries.chunks(size).map(|entries| Self {
            entries: entries.to_vec(),
            options: self.options.clone(),
            warnings: BTreeMap::new(),
            failed: self.failed.clone(),
            not_kept: BTreeMap::new(),
        })
    }

    /// Reads a scene; `None` if its number gives no procedural scene.
    ///
    /// *Errors*: it cannot be read, or it changed since it was checked.
    pub fn load(&self, number: usize) -> Result<Option<Arc<SceneData>>> {
        self.entries[number].load(&self.options)
    }

    /// Prints why a scene failed, and counts it.
    pub fn fail(&self, name: &str, error: &AnyError) {
        progress::say(&format!("error: `{name}`: {}", in_one_line(error)));
        self.failures().entry(name.to_owned()).or_default().add(error);
    }

    fn failures(&self) -> MutexGuard<'_, BTreeMap<String, Failed>> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of scenes that failed.
    pub fn failure_count(&self) -> usize {
        self.failures().len()
    }

    /// Outcome of a command that did its work on the scenes that did not fail.
    pub fn outcome(&self) -> Outcome {
        let may_pass = self.failures().values().any(|failed| failed.may_pass);
        match outcome_without(self.failure_count()) {
            Outcome::BadScenes if may_pass => Outcome::Retry,
            outcome => outcome,
        }
    }

    fn none_usable(&self) -> Error {
        Error::BadScenes(Box::new(Error::Refused(format!("no scene of {} can be used", self.len()))))
    }

    /// As [`Scenes::map_each`].
    ///
    /// *Errors*: every scene fails, or the disk is full.
    pub fn map<T: Send, E: WorkError>(
        &self,
        work: impl Fn(&SceneData) -> Result<T, E> + Sync,
        done: impl FnMut(),
    ) -> Result<Vec<T>, E> {
        let before = self.failure_count();
        let all = self.map_each(work, done)?;
        if all.is_empty() && self.failure_count() > before {
            return Err(self.none_usable().into());
        }
        Ok(all)
    }

    /// Applies `work` to every scene in parallel and returns the results in the order of the scenes. A scene that
    /// cannot be read, or for which `work` fails, is named, counted and left out. Calls `done` after each scene, in
    /// order.
    ///
    /// *Errors*: the disk is full.
    pub fn map_each<T: Send, E: WorkError>(
        &self,
        work: impl Fn(&SceneData) -> Result<T, E> + Sync,
        mut done: impl FnMut(),
    ) -> Result<Vec<T>, E> {
        let mut all = Vec::with_capacity(self.len());
        for window in self.entries.chunks(WINDOW) {
            let results: Vec<Result<Option<T>, E>> = window
                .par_iter()
                .with_max_len(1)
                .map(|entry| caught(|| entry.load(&self.options)?.map(|data| work(&data)).transpose()))
                .collect();
            for (entry, result) in window.iter().zip(results) {
                match result {
                    Ok(result) => all.extend(result),
                    Err(error) if output::is_disk_full(error.as_ref()) => return Err(error),
                    Err(error) => self.fail(&entry.name(), error.as_ref()),
                }
                done();
            }
        }
        Ok(all)
    }

    /// Reads each scene once, stores the hash of its content, and leaves out scenes for which `keep` gives a
    /// reason and files that are no scene, with a message.
    ///
    /// *Errors*: no file is a scene, if it `needs_any`.
    fn checked(
        self,
        needs_any: bool,
        keep: impl Fn(&SceneData) -> Result<(), &'static str> + Sync,
    ) -> Result<Self> {
        let mut progress = Progress::new("read", self.len());
        let mut entries = Vec::with_capacity(self.len());
        let (mut warnings, mut first_error) = (BTreeMap::new(), None);
        let (mut unreadable, mut not_kept) = (BTreeMap::<String, Failed>::new(), BTreeMap::new());
        for window in self.entries.chunks(WINDOW) {
            let check = |entry: &Entry| -> Result<Checked> {
                let Some(data) = entry.load(&self.options)? else { return Ok((Err(NO_SUCH), Vec::new())) };
                let content = Some(data.scene.content_hash());
                let found = checks::important(&data.scene);
                let said =
                    found.into_iter().map(|warning| (warning.kind, format!("`{}`: {warning}", data.name)));
                let kept = keep(&data).map(|()| Entry { content, ..entry.clone() });
                Ok((kept, said.collect()))
            };
            let checked: Vec<Result<Checked>> =
                window.par_iter().with_max_len(1).map(|entry| caught(|| check(entry))).collect();
            for (entry, found) in window.iter().zip(checked) {
                progress.step();
                let (kept, said) = match found {
                    Ok(found) => found,
                    // A folder goes on without a file that is no scene.
                    Err(error) => {
                        progress.say(&format!("error: {}", in_one_line(&error)));
                        unreadable.entry(entry.name()).or_default().add(&error);
                        *warnings.entry(UNREADABLE).or_default() += 1;
                        first_error.get_or_insert(error);
                        continue;
                    }
                };
                match kept {
                    Ok(kept) => entries.push(kept),
                    Err(reason) => drop(not_kept.insert(entry.number, reason.to_owned())),
                }
                for (kind, text) in said {
                    progress.say(&format!("warning: {text}"));
                    *warnings.entry(kind).or_default() += 1;
                }
            }
        }
        if let Some(error) = first_error.filter(|_| needs_any && unreadable.len() == self.len()) {
            self.failures().extend(unreadable);
            return Err(Error::BadScenes(Box::new(error)));
        }
        progress.finish(&format!("read {}", count(self.len() - unreadable.len(), "scene")));
        self.failures().extend(unreadable);
        Ok(Self { entries, warnings, not_kept, ..self })
    }

    /// All scenes that can be read, each read once so that its content is known.
    ///
    /// *Errors*: no file is a scene.
    pub fn only_readable(self) -> Result<Self> {
        self.checked(true, |_| Ok(()))
    }

    /// The scenes of a part of a list that can be read, or those of them that can be attacked. They may be none.
    ///
    /// *Errors*: none.
    pub fn some(self, needs_adversary: bool) -> Result<Self> {
        if needs_adversary { self.only_attackable(false) } else { self.checked(false, |_| Ok(())) }
    }

    /// Numbers of scenes with important warnings as a paragraph of a report; empty without any.
    pub fn warnings_as_markdown(&self) -> String {
        if self.warnings.is_empty() {
            return String::new();
        }
        let counts = self.warnings.iter().map(|(kind, number)| format!("{} {kind}", count(*number, "scene")));
        format!(
            "\nWarnings about the scenes given (`sage inspect` explains them): {}.\n",
            counts.collect::<Vec<_>>().join(", ")
        )
    }

    /// Scenes that have an ego path and an adversary that is valid *now* and does not overlap the ego. Prints how many
    /// have not.
    ///
    /// *Errors*: no file is a scene, or no scene is left.
    pub fn attackable(self) -> Result<Self> {
        let all = self.len();
        let attackable = self.only_attackable(true)?;
        if attackable.is_empty() {
            return Err(Error::BadScenes(Box::new(Error::Refused(format!(
                "no scene of {all} has an ego path, 1 s of recording after frame {NOW}, and an adversary that is valid there apart from the ego"
            )))));
        }
        Ok(attackable)
    }

    fn only_attackable(self, needs_any: bool) -> Result<Self> {
        let all = self.len();
        let attackable = self.checked(needs_any, |data| {
            let is_attackable = data.scene.adversary().is_ok_and(|adversary| adversary.is_valid(NOW))
                && Context::new(&data.scene, &data.index, &ContextOptions::default())
                    .is_ok_and(|ctx| !ctx.is_in_contact_now());
            if is_attackable { Ok(()) } else { Err(NOT_ATTACKABLE) }
        })?;
        if (1..all).contains(&attackable.len()) {
            progress::say(&format!(
                "note: {} of {all} scenes left out: unreadable, or without an ego path, 1 s after frame {NOW}, or an adversary that is valid there and does not overlap the ego",
                all - attackable.len()
            ));
        }
        Ok(attackable)
    }

    /// Reads all scenes into memory, for training, which reads them repeatedly in random order. Files that are no
    /// scene are named, counted and left out.
    ///
    /// *Errors*: no file is a scene; the scenes exceed 8 GiB.
    pub fn read_all(&self) -> Result<Vec<SceneData>> {
        let mut progress = Progress::new("read", self.len());
        let mut loaded = Vec::with_capacity(self.len());
        let mut size = 0;
        for window in self.entries.chunks(WINDOW) {
            let scenes: Vec<Result<Option<Arc<SceneData>>>> =
                window.par_iter().with_max_len(1).map(|entry| caught(|| entry.load(&self.options))).collect();
            for (entry, data) in window.iter().zip(scenes) {
                progress.step();
                let data = match data {
                    Ok(Some(data)) => data,
                    Ok(None) => continue,
                    Err(error) => {
                        self.fail(&entry.name(), &error);
                        continue;
                    }
                };
                size += memory_size(&data);
                if size > MEMORY_LIMIT {
                    return Err(Error::Refused(format!(
                        "the first {} of {} scenes exceed {} GiB of memory, the limit of training; use fewer scenes",
                        loaded.len() + 1,
                        self.len(),
                        MEMORY_LIMIT >> 30
                    )));
                }
                // Only a scene from a pipe is shared.
                loaded.push(
                    Arc::try_unwrap(data)
                        .unwrap_or_else(|data| SceneData::new(data.name.clone(), (*data.scene).clone())),
                );
            }
        }
        if loaded.is_empty() && self.failure_count() > 0 {
            return Err(self.none_usable());
        }
        progress.finish(&format!("read {}", count(loaded.len(), "scene")));
        Ok(loaded)
    }

    /// Number of scenes that did not fail, and a hash of their contents in order. Only valid after
    /// [`Scenes::attackable`] or [`Scenes::only_readable`].
    pub fn describe(&self) -> String {
        let failed = self.failures();
        let entries = self.entries.iter().filter(|entry| !failed.contains_key(&entry.name()));
        let contents: Vec<_> = entries.map(|entry| entry.content.unwrap_or_default()).collect();
        description(contents.into_iter())
    }
}

/// Approximate memory of a scene with its search trees, bytes.
fn memory_size(data: &SceneData) -> usize {
    /// A frame of a track: position, heading, velocity, size, validity.
    const FRAME: usize = 73;
    /// A point of the map, its segment, and its share of the trees.
    const POINT: usize = 200;
    data.scene.tracks.len() * data.scene.frames * FRAME + data.scene.map.points.len() * POINT
}

/// Number of scenes and a hash of their contents in order.
pub fn describe(scenes: &[SceneData]) -> String {
    description(scenes.iter().map(|data| data.scene.content_hash()))
}

fn description(contents: impl ExactSizeIterator<Item = [u8; 16]>) -> String {
    let count = contents.len();
    let mut hasher = blake3::Hasher::new();
    for content in contents {
        hasher.update(&content);
    }
    format!("{count} scenes ({})", &hasher.finalize().to_hex()[..16])
}
