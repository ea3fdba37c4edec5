//! Folders of scenes, with or without ScenarioNet's summary, read in parallel and in order.

use std::{
    collections::{HashMap, HashSet},
    path::{Component, Path, PathBuf},
};

use sage_core::text::natural_order;

use crate::{
    Error, gpudrive,
    map_in_order::map_in_order,
    parquet_files,
    pickle::{Document, PickleProblem},
    recording, womd,
};

/// File name endings of scene files.
const ENDINGS: [&str; 2] = [".pkl", ".safetensors"];

/// Levels of folders below the given one at most.
const MAX_LEVELS: usize = 64;

/// Scenes under a path, in natural order: files, and records of shards such as `SHARD#3`.
///
/// A path that is not a folder is the only file; a shard is the list of its records. In a folder they are the
/// files that `dataset_summary.pkl` lists, in the folders that `dataset_mapping.pkl` gives. Without a summary they
/// are all `.pkl` and `.safetensors` files below the folder, the shards by their names, and the `.json` and `.json.gz` files
/// that are scenes, and the scenarios of Argoverse 2 (`scenario_….parquet`).
///
/// *Errors*: [`Error::Read`] for a folder that cannot be listed, [`Error::NoScenes`] for a folder without
/// scenes, [`Error::Field`] for a summary whose names are not file names, [`Error::Shard`] for a shard without
/// records that is named itself. Such a shard in a folder is listed as a file, which cannot be read.
///
/// ```
/// use sage_data::{Recording, folder::scene_files, procedural};
///
/// let folder = tempfile::tempdir()?;
/// let scene = procedural::generate(procedural::Kind::Straight, 1, 0).ok_or("no scene for this seed")?;
/// for name in ["scene-10.pkl", "scene-9.pkl", "notes.txt"] {
///     Recording::procedural(scene.clone()).write(&folder.path().join(name))?;
/// }
/// // Scene files alone, in natural order: 9 comes before 10.
/// let found = scene_files(folder.path())?;
/// assert_eq!(found, ["scene-9.pkl", "scene-10.pkl"].map(|name| folder.path().join(name)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn scene_files(path: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut scenes = Vec::new();
    let is_folder = path.is_dir();
    for file in files(path)? {
        if !womd::is_shard(&file) {
            scenes.push(womd::numbered(&file)?);
            continue;
        }
        match womd::record_paths(&file) {
            Ok(records) => scenes.extend(records),
            // Who reads it is told what is wrong; the other files of the folder go on.
            Err(_) if is_folder => scenes.push(file),
            Err(error) => return Err(error),
        }
    }
    Ok(scenes)
}

/// Name of a scene for its outputs: that of its file without the ending, or the id of a record such as `SHARD#3`.
///
/// *Errors*: a record that cannot be read, or that is no scene.
pub fn scene_name(path: &Path) -> Result<String, Error> {
    if womd::is_record_path(path) {
        return Ok(womd::heading_of(path, &womd::read_framed(path)?)?.name);
    }
    Ok(without_ending(path).file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned())
}

/// Files under a path, as [`scene_files`] lists them, shards as they are.
pub(crate) fn files(path: &Path) -> Result<Vec<PathBuf>, Error> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let summary = path.join("dataset_summary.pkl");
    let mut files = if summary.is_file() { from_summary(path, &summary)? } else { walk(path)? };
    if files.is_empty() {
        return Err(Error::NoScenes { path: path.to_owned() });
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(files)
}

/// Applies `read` to every file in parallel and passes the results to `take` in the order of the files. Stops
/// at the first `Err` of `take` and returns it.
pub fn in_order<T: Send, E>(
    files: &[PathBuf],
    read: impl Fn(&Path) -> T + Sync,
    mut take: impl FnMut(&Path, T) -> Result<(), E>,
) -> Result<(), E> {
    map_in_order(files.iter(), |_| 0, |file| (file, read(file)), |(file, result)| take(file, result))
}

/// Scene files below a folder. Links are followed, each folder once. Pipes, sockets and devices are skipped.
fn walk(root: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    let mut open = vec![(root.to_owned(), 0)];
    let mut seen = HashSet::new();
    while let Some((folder, level)) = open.pop() {
        let fail = |source| Error::Read { path: folder.clone(), source };
        if level > MAX_LEVELS {
            return Err(Error::Field {
                path: root.to_owned(),
                field: String::new(),
                found: format!("a folder with folders in more than {MAX_LEVELS} levels"),
                expected: "fewer; name the folder of the scenes".to_owned(),
            });
        }
        if !seen.insert(folder.canonicalize().map_err(fail)?) {
            continue;
        }
        for entry in std::fs::read_dir(&folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let found = match std::fs::metadata(&path) {
                Ok(found) => found,
                // A link that leads nowhere.
                Err(_) if path.is_symlink() => continue,
                // Left out without a word, its scenes would be missing.
                Err(source) => return Err(Error::Read { path, source }),
            };
            if found.is_dir() {
                open.push((path, level + 1));
            } else if found.is_file() && (is_scene_file(&name, &path) || gpudrive::is_damaged(&path)) {
                files.push(path);
            }
        }
    }
    Ok(files)
}

/// Pickles below a folder with a summary; native files beside them hold the same scenes.
fn pickles_below(root: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut files = walk(root)?;
    if files.iter().any(|file| file.extension().is_some_and(|ending| ending == "pkl")) {
        files.retain(|file| file.extension().is_some_and(|ending| ending == "pkl"));
    }
    Ok(files)
}

fn is_scene_file(name: &str, path: &Path) -> bool {
    let is_named = ENDINGS.iter().any(|ending| name.ends_with(ending)) && !name.starts_with("dataset_");
    is_named
        || womd::is_shard_name(path)
        || parquet_files::is_scenario_name(name)
        || gpudrive::is_scene_file(path)
}

/// A path without the ending of its file.
pub(crate) fn without_ending(path: &Path) -> PathBuf {
    if let Some(plain) = parquet_files::plain_path(path).filter(|plain| plain.file_name().is_some()) {
        return plain;
    }
    let plain = path.with_extension("");
    let plain = if gpudrive::is_compressed_name(path) { plain.with_extension("") } else { plain };
    // As attacked scenes are named.
    if plain.extension().is_some_and(|ending| ending == "gpudrive") {
        plain.with_extension("")
    } else {
        plain
    }
}

fn from_summary(root: &Path, summary: &Path) -> Result<Vec<PathBuf>, Error> {
    let table =
        |path: &Path| -> Result<Document, Error> { recording::parse(path, recording::read_inside(path)?) };
    let field = |path: &Path, field: String, found: String, expected: &str| Error::Field {
        path: path.to_owned(),
        field,
        found,
        expected: expected.to_owned(),
    };
    let listed = match table(summary) {
        Ok(listed) => listed,
        // The summary of a very large data set exceeds the size limit, so the folder is searched instead.
        Err(Error::TooLarge { .. }) => return pickles_below(root),
        Err(Error::Pickle { problem, .. }) if matches!(problem.kind, PickleProblem::TooMuch(_)) => {
            return pickles_below(root);
        }
        Err(error) => return Err(error),
    };
    let mapping_path = root.join("dataset_mapping.pkl");
    let mapping = if mapping_path.is_file() { Some(table(&mapping_path)?) } else { None };
    let folders: Option<HashMap<&str, &str>> = mapping.as_ref().map(|mapping| {
        let entries = mapping.entries(mapping.root()).unwrap_or_default();
        entries
            .iter()
            .filter_map(|(name, folder)| Some((mapping.text(*name)?, mapping.text(*folder)?)))
            .collect()
    });
    let entries = listed.entries(listed.root()).ok_or_else(|| {
        field(summary, String::new(), listed.describe(listed.root()), "a dict of file name to description")
    })?;
    let mut inside = Inside::of(root)?;
    let mut files = Vec::with_capacity(entries.len());
    for (key, _) in entries {
        let name = listed
            .text(*key)
            .ok_or_else(|| field(summary, String::new(), listed.describe(*key), "a file name"))?;
        let folder = match &folders {
            Some(folders) => folders.get(name).copied().ok_or_else(|| {
                field(&mapping_path, name.to_owned(), "missing".to_owned(), "the folder of this file")
            })?,
            None => "",
        };
        let wrong =
            |found: String, expected| field(summary, name.escape_debug().to_string(), found, expected);
        if !is_plain_name(name) {
            return Err(wrong(format!("`{}`", name.escape_debug()), "a file name without a folder"));
        }
        let file = root.join(folder).join(name);
        if !inside.holds(folder, &file) {
            let found = format!("in `{}`", folder.escape_debug());
            return Err(wrong(found, "a file inside the data set, links resolved; copy the files into it"));
        }
        if std::fs::metadata(&file).is_ok_and(|found| !found.is_file()) {
            return Err(wrong("a folder, pipe or device".to_owned(), "a regular file"));
        }
        files.push(file);
    }
    Ok(files)
}

/// What lies inside a folder, links resolved. A data set could otherwise name any file of the machine.
struct Inside {
    root: PathBuf,
    /// Folders that were asked for.
    folders: HashMap<String, bool>,
}

impl Inside {
    fn of(root: &Path) -> Result<Self, Error> {
        let fail = |source| Error::Read { path: root.to_owned(), source };
        Ok(Self { root: root.canonicalize().map_err(fail)?, folders: HashMap::new() })
    }

    /// Whether a file of a folder, which is relative to the root, lies inside the root. What does not exist is left to
    /// the reader, unless its path leads out by `..`.
    fn holds(&mut self, folder: &str, file: &Path) -> bool {
        let is_inside = |path: &Path| path.canonicalize().is_ok_and(|path| path.starts_with(&self.root));
        let is_down = |part| matches!(part, Component::Normal(_) | Component::CurDir);
        let parent = file.parent().unwrap_or(file);
        let holds = *self.folders.entry(folder.to_owned()).or_insert_with(|| {
            if parent.exists() { is_inside(parent) } else { Path::new(folder).components().all(is_down) }
        });
        holds && (!file.is_symlink() || is_inside(file) || !file.exists())
    }
}

/// True if a name is a plain file name, which cannot lead into another folder on any system.
fn is_plain_name(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None))
        && !name.contains(['/', '\\', '\0'])
}

/// Path of a file relative to a folder; its bare name if the file is not below the folder. The result never
/// leads out of a folder that it is joined to.
pub fn name_below(root: &Path, file: &Path) -> PathBuf {
    let is_down = |below: &&Path| below.components().all(|part| matches!(part, Component::Normal(_)));
    let below = file.strip_prefix(root).ok().filter(is_down);
    below.map_or_else(|| file.file_name().map(PathBuf::from).unwrap_or_default(), Path::to_owned)
}

/// Name of the page that lists all scenes.
const RESERVED: &str = "index";

/// Names for the outputs of scenes, from their files below `root` and their own names ([`scene_name`]), and how many of them are
/// named apart.
///
/// Scenes with one name, and scenes whose name cannot be that of an output, are named apart by their paths: all of them,
/// so that a scene that is added later does not take the outputs of another.
pub fn output_names(root: &Path, files: &[PathBuf], names: &[String]) -> (Vec<String>, usize) {
    let mut counts: HashMap<&str, usize> = HashMap::new();
    names.iter().for_each(|name| *counts.entry(name).or_default() += 1);
    let mut apart = 0;
    let all = files.iter().zip(names).map(|(file, name)| {
        let is_usable = !name.contains('\\') && !name.starts_with('-') && name != RESERVED;
        if is_usable && counts[&name[..]] == 1 {
            return name.clone();
        }
        apart += 1;
        name_apart(name, &name_below(root, file))
    });
    (all.collect(), apart)
}

/// Name for the outputs of a scene whose own name another scene has too, or cannot be that of a file: the name with a
/// hash of the scene's path.
pub fn name_apart(name: &str, path: &Path) -> String {
    let plain: String = name.chars().map(|c| if matches!(c, '\\' | '/') { '-' } else { c }).collect();
    let hash = blake3::hash(path.as_os_str().as_encoded_bytes()).to_hex();
    format!("{}-{}", plain.trim_start_matches('-'), &hash[..8])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_their_folder() {
        for bad in ["", ".", "..", "../a.pkl", "a/b.pkl", "/a.pkl", "a\\b.pkl", "a/", "./a.pkl"] {
            assert!(!is_plain_name(bad), "{bad}");
        }
        assert!(is_plain_name("sd_a..b.pkl"));
        let below = |file: &str| name_below(Path::new("in"), Path::new(file));
        assert_eq!(below("in/part/a.pkl"), Path::new("part/a.pkl"));
        for elsewhere in ["in/../other/a.pkl", "in/part/../../a.pkl", "/a.pkl", "other/a.pkl"] {
            assert_eq!(below(elsewhere), Path::new("a.pkl"), "{elsewhere}");
        }
    }
}
