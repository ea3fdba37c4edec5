//! Manifests: what became of every scene of a run or of a shard, with the hashes of its files.
//!
//! A manifest is a text file of JSON lines. The first line holds the counts and a hash of all further lines, which are one
//! a scene. It is written last, so its presence says that the shard has ended.

use std::{
    collections::BTreeSet,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

use advsage::WithContext as _;
use sage_core::files::{self, Existing};
use sage_data::dataset::Shard;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Manifest of a whole run.
pub const MANIFEST: &str = "manifest.jsonl";
/// Folder of the manifests of shards, until they are joined.
pub const SHARDS: &str = "shards";
/// Names of all scenes of a run, in their order.
pub(super) const SCENES: &str = "scenes.json";
/// Size limit of a file with the names of all scenes, bytes.
const SCENES_LIMIT: u64 = 1 << 30;
/// Length limit of a line of a manifest, bytes: a scene may have very many files.
const LINE_LIMIT: u64 = 1 << 28;

/// What became of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// All its files are there.
    Done,
    /// What is asked cannot be measured in it.
    LeftOut,
    /// It is bad: another try changes nothing.
    Bad,
    /// The system refused to read or write it.
    Retry,
}

/// A file of a scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Name within the folder of the run.
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
    /// The first 32 digits of BLAKE3.
    pub blake3: String,
}

/// What became of a scene, and its files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// Name of the scene, as in the names of its files.
    pub scene: String,
    /// What became of it.
    pub state: State,
    /// Why it is not done.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// In the order of their names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileRecord>,
}

impl SceneRecord {
    /// A record without files.
    pub fn new(scene: &str, state: State, reason: String) -> Self {
        Self { scene: scene.to_owned(), state, reason, files: Vec::new() }
    }

    /// The same with the files of the scene as they are on the disk.
    ///
    /// *Errors*: one cannot be read.
    pub fn with_files<'n>(mut self, folder: &Path, names: impl IntoIterator<Item = &'n str>) -> Result<Self> {
        let names: BTreeSet<&str> = names.into_iter().collect();
        self.files = names.into_iter().map(|name| FileRecord::of(folder, name)).collect::<Result<_>>()?;
        Ok(self)
    }
}

impl FileRecord {
    /// True if the file is still as it was recorded.
    pub fn holds(&self, folder: &Path) -> bool {
        Self::of(folder, &self.name).is_ok_and(|found| found == *self)
    }

    /// Size and hash of a file.
    ///
    /// *Errors*: it cannot be read.
    pub fn of(folder: &Path, name: &str) -> Result<Self> {
        let (path, mut hasher) = (folder.join(name), blake3::Hasher::new());
        let hashed = std::fs::File::open(&path).and_then(|file| hasher.update_reader(file).map(|_| ()));
        hashed.with_context(|| format!("cannot read `{}`", path.display()))?;
        Ok(Self {
            name: name.to_owned(),
            bytes: hasher.count(),
            blake3: hasher.finalize().to_hex()[..32].to_owned(),
        })
    }
}

/// Numbers of scenes by what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// All scenes.
    pub scenes: usize,
    /// Those that are done.
    pub done: usize,
    /// Those in which what is asked cannot be measured.
    pub left_out: usize,
    /// Bad ones.
    pub bad: usize,
    /// Those that another try may do.
    pub retry: usize,
}

impl Counts {
    /// Counts records.
    pub fn of<'r>(records: impl IntoIterator<Item = &'r SceneRecord>) -> Self {
        let mut counts = Self::default();
        records.into_iter().for_each(|record| counts.add(record.state));
        counts
    }

    /// Counts one more scene.
    pub fn add(&mut self, state: State) {
        self.scenes += 1;
        *match state {
            State::Done => &mut self.done,
            State::LeftOut => &mut self.left_out,
            State::Bad => &mut self.bad,
            State::Retry => &mut self.retry,
        } += 1;
    }

    /// Scenes that are not done and not left out.
    pub fn failure_count(&self) -> usize {
        self.bad + self.retry
    }
}

/// What only the manifest of a shard says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShardRecord {
    pub number: u32,
    pub of: u32,
    /// Time of the process that wrote the manifest.
    pub seconds: f64,
    pub threads: usize,
}

/// First line of a manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// Hash of the run's identity, `run` of `run.json`.
    pub run_hash: String,
    #[serde(flatten)]
    pub counts: Counts,
    /// Size of all files.
    pub bytes: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<ShardRecord>,
    /// BLAKE3 of all further lines, the first 32 digits.
    pub blake3: String,
}

/// A manifest that is read back.
#[derive(Debug)]
pub struct Manifest {
    pub head: Head,
    pub records: Vec<SceneRecord>,
}

impl Manifest {
    /// Writes a manifest.
    ///
    /// *Errors*: those of the system.
    pub fn write(
        path: &Path,
        run_hash: &str,
        shard: Option<ShardRecord>,
        records: &[SceneRecord],
    ) -> Result<()> {
        let mut hasher = blake3::Hasher::new();
        for record in records {
            hasher.update(line(record)?.as_bytes());
        }
        let head = Head {
            run_hash: run_hash.to_owned(),
            counts: Counts::of(records),
            bytes: records.iter().flat_map(|record| &record.files).map(|file| file.bytes).sum(),
            shard,
            blake3: hasher.finalize().to_hex()[..32].to_owned(),
        };
        let head = line(&head)?;
        let written = files::write_with(path, Existing::Replace, |out| {
            out.write_all(head.as_bytes())?;
            records.iter().try_for_each(|record| out.write_all(line(record)?.as_bytes()))
        });
        Ok(written.with_context(|| format!("cannot write `{}`", path.display()))?)
    }

    /// Names of the scenes of the manifest of the whole run with a hash; `None` if there is none.
    pub fn names_of_run(folder: &Path, run_hash: &str) -> Option<Vec<String>> {
        let whole =
            Self::read(&folder.join(MANIFEST)).ok().filter(|whole| whole.head.run_hash == run_hash)?;
        Some(whole.records.into_iter().map(|record| record.scene).collect())
    }

    /// Reads a manifest.
    ///
    /// *Errors*: it cannot be read, or its lines are not those that were written.
    pub fn read(path: &Path) -> Result<Self> {
        let shown = || format!("`{}`", path.display());
        let mut lines = Lines::open(path).with_context(|| format!("cannot read {}", shown()))?;
        let within = |error: Error| error.within(shown());
        let is_empty = || Error::Refused("it is empty".to_owned());
        let first = lines.next_line().and_then(|line| line.ok_or_else(is_empty)).map_err(within)?;
        let head: Head = serde_json::from_str(&first).with_context(|| format!("{}, line 1", shown()))?;
        let (mut hasher, mut records, mut number) = (blake3::Hasher::new(), Vec::new(), 1);
        while let Some(text) = lines.next_line().map_err(within)? {
            number += 1;
            hasher.update(text.as_bytes());
            let record = serde_json::from_str(&text);
            records.push(record.with_context(|| format!("{}, line {number}", shown()))?);
        }
        let is_whole = hasher.finalize().to_hex()[..32] == head.blake3;
        if is_whole && Counts::of(&records) == head.counts {
            return Ok(Self { head, records });
        }
        Err(Error::Refused(format!(
            "{} is not as it was written: its lines do not have the hash `blake3` of its first line",
            shown()
        )))
    }
}

/// A line of a manifest, with its end.
fn line(value: &impl Serialize) -> serde_json::Result<String> {
    Ok(serde_json::to_string(value)? + "\n")
}

/// The lines of a file, with their ends.
struct Lines(BufReader<std::fs::File>);

impl Lines {
    fn open(path: &Path) -> std::io::Result<Self> {
        // To open a pipe would wait for somebody to write.
        if !std::fs::metadata(path)?.is_file() {
            return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, "it is no regular file"));
        }
        std::fs::File::open(path).map(BufReader::new).map(Self)
    }

    fn next_line(&mut self) -> Result<Option<String>> {
        use std::io::Read as _;
        let mut text = String::new();
        let length = (&mut self.0).take(LINE_LIMIT).read_line(&mut text)?;
        if length as u64 >= LINE_LIMIT {
            return Err(Error::Refused(format!("a line is longer than {LINE_LIMIT} bytes")));
        }
        Ok((length > 0).then_some(text))
    }
}

/// Name of a shard's manifest in its folder.
pub fn shard_file(Shard { number, of }: Shard) -> String {
    format!("{SHARDS}/{number}-of-{of}.jsonl")
}

/// Manifests of shards in a folder, in the order of their numbers.
///
/// *Errors*: the folder cannot be listed.
pub fn shard_files(folder: &Path) -> Result<Vec<(Shard, PathBuf)>> {
    let shards = folder.join(SHARDS);
    if !shards.is_dir() {
        return Ok(Vec::new());
    }
    let entries =
        std::fs::read_dir(&shards).with_context(|| format!("cannot read `{}`", shards.display()))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if !path.is_file() {
            continue;
        }
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let shard = name.strip_suffix(".jsonl").map(|name| name.replace("-of-", "/").parse());
        found.extend(shard.and_then(Result::ok).map(|shard| (shard, path)));
    }
    found.sort_by_key(|(shard, _): &(Shard, _)| (shard.of, shard.number));
    Ok(found)
}

/// The names of all scenes that the shards of a folder agree on; `None` before the first.
///
/// *Errors*: the file cannot be read.
pub fn agreed_scenes(folder: &Path) -> Result<Option<Vec<String>>> {
    let path = folder.join(SHARDS).join(SCENES);
    if !path.is_file() {
        return Ok(None);
    }
    let shown = || format!("cannot read `{}`", path.display());
    let bytes = files::read(&path, SCENES_LIMIT).with_context(shown)?;
    Ok(serde_json::from_slice(&bytes).with_context(shown).map(Some)?)
}

/// True if a folder has manifests of shards, or the list of their scenes.
///
/// *Errors*: the folder cannot be listed.
pub fn has_shards(folder: &Path) -> Result<bool> {
    Ok(folder.join(SHARDS).join(SCENES).is_file() || !shard_files(folder)?.is_empty())
}

/// Says in what two lists of scenes differ; `None` if they are equal.
pub fn difference(agreed: &[String], own: &[&str]) -> Option<String> {
    if agreed.iter().map(String::as_str).eq(own.iter().copied()) {
        return None;
    }
    let [there, here]: [std::collections::HashSet<&str>; 2] =
        [agreed.iter().map(String::as_str).collect(), own.iter().copied().collect()];
    let lacks = agreed.iter().find(|name| !here.contains(name.as_str()));
    let adds = own.iter().find(|name| !there.contains(**name));
    let example = match (lacks, adds) {
        (Some(name), _) => format!("`{name}` is missing here"),
        (None, Some(name)) => format!("`{name}` is new here"),
        (None, None) => "the order is another".to_owned(),
    };
    Some(format!("{} scenes there, {} here; {example}", agreed.len(), own.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn records(folder: &Path) -> Vec<SceneRecord> {
        std::fs::write(folder.join("a.json"), "{}").unwrap();
        let done = SceneRecord::new("a", State::Done, String::new()).with_files(folder, ["a.json"]).unwrap();
        vec![done, SceneRecord::new("b\n", State::Bad, "no lanes".to_owned())]
    }

    #[test]
    fn a_manifest_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(MANIFEST);
        let records = records(folder.path());
        let shard = ShardRecord { number: 2, of: 3, seconds: 1.5, threads: 4 };
        Manifest::write(&path, "abc", Some(shard), &records).unwrap();
        let read = Manifest::read(&path).unwrap();
        assert_eq!(read.records, records);
        assert_eq!((read.head.shard, read.head.bytes, read.head.counts.failure_count()), (Some(shard), 2, 1));
    }

    #[test]
    fn a_manifest_that_was_changed_or_cut_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(MANIFEST);
        Manifest::write(&path, "abc", None, &records(folder.path())).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let cut = text.lines().take(2).map(|line| format!("{line}\n")).collect::<String>();
        for wrong in [text.replace("no lanes", "no road"), cut, text.replace("\"bad\":1", "\"bad\":0")] {
            assert_ne!(wrong, text);
            std::fs::write(&path, wrong).unwrap();
            let error = Manifest::read(&path).unwrap_err().to_string();
            assert!(error.contains("not as it was written"), "{error}");
        }
        std::fs::write(&path, "").unwrap();
        assert!(Manifest::read(&path).is_err());
    }

    #[test]
    fn lists_of_scenes_that_differ_are_described() {
        let agreed = ["a", "b"].map(str::to_owned);
        assert_eq!(difference(&agreed, &["a", "b"]), None);
        let said = [&["a"][..], &["a", "b", "c"], &["b", "a"]].map(|own| difference(&agreed, own).unwrap());
        assert!(said[0].contains("`b` is missing") && said[1].contains("`c` is new"), "{said:?}");
        assert!(said[2].contains("order"), "{said:?}");
    }
}
