//! Many scenes, read when they are needed: memory holds as many as there are threads, however many
//! there are.

use std::{
    collections::{BTreeMap, HashSet},
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context as _, Result, bail};
use rayon::prelude::*;
use sage_backbones::training::SceneData;
use sage_core::{
    motion::NOW,
    objective::{Context, ContextOptions},
};
use sage_data::{
    Recording, folder,
    procedural::{self, Kind},
};

use crate::{
    cli::SplitArgs,
    progress::{self, Progress},
};

/// Scenes worked on between two hand-overs of results.
const WINDOW: usize = 64;
/// Most memory for scenes that training holds at once, bytes. A recorded scene takes about 3 MB.
const HELD_LIMIT: usize = 8 << 30;

/// A list of scenes.
pub(crate) struct Scenes {
    entries: Vec<Entry>,
}

/// One scene, and what it held when it was first read.
#[derive(Clone)]
struct Entry {
    origin: Origin,
    content: Option<[u8; 16]>,
}

/// Where a scene comes from each time it is needed.
#[derive(Clone)]
enum Origin {
    File(PathBuf),
    /// Number and seed of a procedural scene.
    Procedural(u64, u64),
    /// A pipe can be read once.
    Held(Arc<SceneData>),
}

impl Scenes {
    /// Scenes under some paths, of which a splits file or names may take some; without any path,
    /// `procedural` scenes of a seed, all kinds in turn.
    ///
    /// *Errors*: a folder that cannot be listed; no such split, or a scene that is not there.
    pub(crate) fn of(paths: &[PathBuf], split: &SplitArgs, procedural: u64, seed: u64) -> Result<Self> {
        if paths.is_empty() {
            if split.splits.is_some() || !split.scenes.is_empty() {
                bail!("--splits and --scenes choose among recorded scenes; name their folder");
            }
            return Ok(Self::procedural(procedural, seed));
        }
        let mut files = Vec::new();
        for path in paths {
            files.extend(folder::scene_files(path)?);
        }
        Self::of_files(chosen(files, split)?)
    }

    /// All scenes under some paths.
    ///
    /// *Errors*: a folder that cannot be listed.
    pub(crate) fn under(paths: &[PathBuf]) -> Result<Self> {
        let files = paths.iter().map(|path| folder::scene_files(path)).collect::<Result<Vec<_>, _>>()?;
        Self::of_files(files.concat())
    }

    /// Procedural scenes of all kinds in turn. A number that gives no scene is passed over.
    pub(crate) fn procedural(count: u64, seed: u64) -> Self {
        let entry = |number| Entry { origin: Origin::Procedural(number, seed), content: None };
        Self { entries: (0..count).map(entry).collect() }
    }

    fn of_files(files: Vec<PathBuf>) -> Result<Self> {
        // A file named twice is one scene.
        let mut seen = HashSet::new();
        let mut entries = Vec::with_capacity(files.len());
        for file in files {
            if !seen.insert(file.canonicalize().unwrap_or_else(|_| file.clone())) {
                continue;
            }
            let origin =
                if file.is_file() { Origin::File(file) } else { Origin::Held(Arc::new(read(&file)?)) };
            entries.push(Entry { origin, content: None });
        }
        Ok(Self { entries })
    }

    /// Names, as results tell them.
    pub(crate) fn names(&self) -> Vec<String> {
        self.entries.iter().map(Entry::name).collect()
    }

    /// Number of scenes.
    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }

    /// The scenes in groups of some size.
    pub(crate) fn windows(&self, size: usize) -> impl Iterator<Item = Self> {
        self.entries.chunks(size).map(|entries| Self { entries: entries.to_vec() })
    }

    /// Works on every scene in parallel; the results in the order of the scenes. `done` is called after
    /// each, in order.
    ///
    /// *Errors*: the first scene that cannot be read, or that the work fails for.
    pub(crate) fn map<T: Send>(
        &self,
        work: impl Fn(&SceneData) -> Result<T> + Sync,
        mut done: impl FnMut(),
    ) -> Result<Vec<T>> {
        let mut all = Vec::with_capacity(self.len());
        for window in self.entries.chunks(WINDOW) {
            let results: Vec<Result<Option<T>>> = window
                .par_iter()
                .with_max_len(1)
                .map(|entry| entry.load()?.map(|data| work(&data)).transpose())
                .collect();
            for result in results {
                all.extend(result?);
                done();
            }
        }
        Ok(all)
    }

    /// Reads each scene once: what it holds is remembered, and those that `keep` refuses are left out.
    ///
    /// *Errors*: the first file that is no scene.
    fn checked(self, what: &'static str, keep: impl Fn(&SceneData) -> bool + Sync) -> Result<Self> {
        let mut progress = Progress::new(what, self.len());
        let mut entries = Vec::with_capacity(self.len());
        for window in self.entries.chunks(WINDOW) {
            let check = |entry: &Entry| -> Result<Option<Entry>> {
                let Some(data) = entry.load()?.filter(|data| keep(data)) else { return Ok(None) };
                Ok(Some(Entry { origin: entry.origin.clone(), content: Some(data.scene.content_hash()) }))
            };
            let checked: Vec<Result<Option<Entry>>> = window.par_iter().with_max_len(1).map(check).collect();
            for entry in checked {
                entries.extend(entry?);
                progress.step();
            }
        }
        progress.finish(&format!("read {} scenes", self.len()));
        Ok(Self { entries })
    }

    /// Those that have an adversary in sight and an ego path; says how many have not.
    ///
    /// *Errors*: a file that is no scene; none has.
    pub(crate) fn attackable(self) -> Result<Self> {
        let all = self.len();
        let kept = self.checked("read", |data| {
            data.scene.adversary().is_ok_and(|adversary| adversary.is_valid(NOW))
                && Context::new(&data.scene, &data.index, &ContextOptions::default()).is_ok()
        })?;
        if kept.len() == 0 {
            bail!("none of {all} scenes has an adversary in sight at frame {NOW} and an ego path");
        }
        if kept.len() < all {
            progress::say(&format!(
                "note: {} of {all} scenes have no adversary in sight at frame {NOW} or no ego path, and are left out",
                all - kept.len()
            ));
        }
        Ok(kept)
    }

    /// All of them in memory, for training, which needs them in any order again and again.
    ///
    /// *Errors*: a file that is no scene; more than [`HELD_LIMIT`].
    pub(crate) fn hold(&self) -> Result<Vec<SceneData>> {
        let mut progress = Progress::new("read", self.len());
        let mut held = Vec::with_capacity(self.len());
        let mut size = 0;
        for window in self.entries.chunks(WINDOW) {
            let scenes: Vec<Result<Option<Arc<SceneData>>>> =
                window.par_iter().with_max_len(1).map(Entry::load).collect();
            for data in scenes {
                progress.step();
                let Some(data) = data? else { continue };
                size += held_size(&data);
                if size > HELD_LIMIT {
                    bail!(
                        "the first {} of {} scenes take {} GiB of memory, the most that training holds; take fewer",
                        held.len() + 1,
                        self.len(),
                        HELD_LIMIT >> 30
                    );
                }
                // Only a pipe's scene is shared.
                held.push(
                    Arc::try_unwrap(data)
                        .unwrap_or_else(|data| SceneData::new(data.name.clone(), (*data.scene).clone())),
                );
            }
        }
        progress.finish(&format!("read {} scenes", held.len()));
        Ok(held)
    }

    /// Some of the scenes by their names.
    ///
    /// *Errors*: one that cannot be read.
    pub(crate) fn by_name(&self, names: &HashSet<&str>) -> Result<BTreeMap<String, Arc<SceneData>>> {
        let mut found = BTreeMap::new();
        for entry in self.entries.iter().filter(|entry| names.contains(&entry.name()[..])) {
            found.extend(entry.load()?.map(|data| (data.name.clone(), data)));
        }
        Ok(found)
    }

    /// Number of scenes and a hash of what they show, order included, after [`Scenes::attackable`].
    pub(crate) fn describe(&self) -> String {
        description(self.entries.iter().map(|entry| entry.content.unwrap_or_default()))
    }
}

impl Entry {
    /// The scene; `None` for a number that gives none.
    fn load(&self) -> Result<Option<Arc<SceneData>>> {
        let data = match &self.origin {
            Origin::File(file) => read(file)?,
            Origin::Held(data) => return Ok(Some(data.clone())),
            Origin::Procedural(number, seed) => {
                let Some(scene) = procedural::generate(kind_of(*number), *seed, *number) else {
                    return Ok(None);
                };
                SceneData::new(scene.id.clone(), scene)
            }
        };
        if self.content.is_some_and(|content| content != data.scene.content_hash()) {
            bail!("`{}` was changed while it was worked on; start again", data.name);
        }
        Ok(Some(Arc::new(data)))
    }

    /// Its name.
    fn name(&self) -> String {
        match &self.origin {
            Origin::File(file) => file.display().to_string(),
            Origin::Held(data) => data.name.clone(),
            Origin::Procedural(number, seed) => format!("{}-{seed}-{number}", kind_of(*number).name()),
        }
    }
}

/// Kind of a procedural scene by its number: they take turns.
fn kind_of(number: u64) -> Kind {
    Kind::ALL[(number % Kind::ALL.len() as u64) as usize]
}

/// About what a scene takes in memory with its search trees, bytes.
fn held_size(data: &SceneData) -> usize {
    /// A frame of a track: position, heading, velocity, size, validity.
    const FRAME: usize = 73;
    /// A point of the map, its segment, and its share of the trees.
    const POINT: usize = 200;
    data.scene.tracks.len() * data.scene.frames * FRAME + data.scene.map.points.len() * POINT
}

fn read(file: &Path) -> Result<SceneData> {
    Ok(SceneData::new(file.display().to_string(), Recording::read(file)?.scene))
}

/// The files that a splits file and names leave.
fn chosen(mut files: Vec<PathBuf>, split: &SplitArgs) -> Result<Vec<PathBuf>> {
    if split.splits.is_none() && split.scenes.is_empty() {
        return Ok(files);
    }
    let is_named = |file: &Path, name: &String| file.file_stem().is_some_and(|stem| stem == name.as_str());
    let among = |names: &[String], file: &Path| names.iter().any(|name| is_named(file, name));
    if let Some(missing) = split.scenes.iter().find(|name| !files.iter().any(|file| is_named(file, name))) {
        bail!("no scene `{missing}` among the {} given", files.len());
    }
    if let Some(file) = &split.splits {
        if split.split.is_none() && split.without_split.is_none() {
            bail!("--splits needs --split or --without-split to say which scenes count");
        }
        let with = names_in(file, split.split.as_deref())?;
        let without = names_in(file, split.without_split.as_deref())?;
        files.retain(|file| {
            with.as_ref().is_none_or(|names| among(names, file))
                && !without.as_ref().is_some_and(|names| among(names, file))
        });
    }
    if !split.scenes.is_empty() {
        files.retain(|file| among(&split.scenes, file));
    }
    if files.is_empty() {
        bail!("none of the scenes that --splits and --scenes leave is there");
    }
    Ok(files)
}

/// The scenes of a split, if one is named.
///
/// *Errors*: the file cannot be read or does not know it.
fn names_in(file: &Path, split: Option<&str>) -> Result<Option<Vec<String>>> {
    let Some(split) = split else { return Ok(None) };
    let mut known = sage_data::split::read_splits(file)?;
    let all = known.keys().cloned().collect::<Vec<_>>().join(", ");
    let found = known.remove(split);
    found.with_context(|| format!("`{}` has no split `{split}`; known: {all}", file.display())).map(Some)
}

/// Number of scenes and a hash of what they show, order included.
pub(crate) fn describe(scenes: &[SceneData]) -> String {
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
