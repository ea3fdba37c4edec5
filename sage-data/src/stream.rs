//! Scenes of files, folders and shards, one after another. Memory stays the same, however many there are.

use std::{
    path::{Path, PathBuf},
    vec,
};

use sage_core::defect;

pub use crate::map_in_order::map_in_order;
use crate::{
    Error, ReadOptions, Recording, folder, recording,
    womd::{self, Open, Record, ShardReader},
};

/// Files, pipes and shards that the user gave.
///
/// ```
/// use sage_data::stream::Inputs;
///
/// # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl");
/// // Files, folders and shards; scenes are counted before any is read.
/// let inputs = Inputs::under(&[file.into()])?;
/// assert_eq!((inputs.count(), inputs.items().count()), (Some(1), 1));
/// # Ok::<(), sage_data::Error>(())
/// ```
pub struct Inputs {
    /// The folder that a file is listed relative to, and the file.
    files: Vec<(PathBuf, PathBuf)>,
}

impl Inputs {
    /// The files under some paths, in their order. A path is a scene file, a record such as `SHARD#3`, a shard, a
    /// pipe, or a folder of files and shards.
    ///
    /// *Errors*: as [`folder::scene_files`].
    pub fn under(paths: &[PathBuf]) -> Result<Self, Error> {
        let mut files = Vec::new();
        for path in paths {
            let root = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
            for file in folder::files(path)? {
                files.push((root.to_owned(), womd::numbered(&file)?));
            }
        }
        Ok(Self { files })
    }

    /// The files; a shard is one file.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.files.iter().map(|(_, file)| file.as_path())
    }

    /// Names for the outputs of the files that are no shards, as [`Item::name`] gives them.
    pub fn names(&self) -> impl Iterator<Item = PathBuf> {
        let scenes =
            self.files.iter().filter(|(_, file)| !womd::is_shard(file) && !womd::is_record_path(file));
        scenes.map(|(root, file)| name_of(root, file))
    }

    /// Number of scenes; `None` if a pipe or a compressed shard would have to be read to count them.
    pub fn count(&self) -> Option<usize> {
        self.files().map(|file| if is_pipe(file) { None } else { womd::count(file) }).sum()
    }

    /// The scenes, one after another.
    pub fn items(&self) -> Items {
        Items { files: self.files.clone().into_iter(), shard: None }
    }
}

fn is_pipe(file: &Path) -> bool {
    file.to_str() == Some("-") || std::fs::metadata(file).is_ok_and(|found| !found.is_file())
}

/// Name for the output of a file.
fn name_of(root: &Path, file: &Path) -> PathBuf {
    if file.to_str() == Some("-") {
        return "stdin".into();
    }
    folder::without_ending(&folder::name_below(root, file))
}

/// A scene to be read.
pub struct Item {
    root: PathBuf,
    path: PathBuf,
    content: Content,
}

enum Content {
    /// A file with its size, bytes.
    File(usize),
    /// What a pipe held.
    Bytes(Vec<u8>),
    Record(Record),
    /// A shard that cannot be read on.
    Broken(Error),
}

impl Item {
    /// The file, or the record as `SHARD#3`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The shard of which it is a record; `None` for a file, and for a record that was given by itself.
    pub fn shard(&self) -> Option<&Path> {
        match &self.content {
            Content::Record(record) => Some(&record.shard),
            Content::Broken(_) => Some(&self.path),
            _ => None,
        }
    }

    /// Name for outputs, without ending: the path of a file relative to the folder that was given, or the id of a
    /// record. For a record also the data set.
    ///
    /// *Errors*: a record that cannot be read, or that is no scene.
    pub fn name(&self) -> Result<(PathBuf, Option<String>), Error> {
        let heading = match &self.content {
            Content::Record(record) => record.heading()?,
            _ if womd::is_record_path(&self.path) => {
                womd::heading_of(&self.path, &crate::read_bytes(&self.path)?)?
            }
            _ => return Ok((name_of(&self.root, &self.path), None)),
        };
        Ok((heading.name.into(), Some(heading.dataset)))
    }

    /// Why this is no scene but a file that could not be opened or read on; `None` for a scene.
    pub fn problem(&self) -> Option<&Error> {
        match &self.content {
            Content::Broken(error) => Some(error),
            _ => None,
        }
    }

    /// Reads and checks the scene.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn read(self, options: &ReadOptions) -> Result<Recording, Error> {
        match self.content {
            Content::File(_) => Recording::read_as(&self.path, options),
            Content::Bytes(bytes) => Recording::from_bytes_as(&self.path, bytes, options),
            Content::Record(record) => record.read(options),
            Content::Broken(error) => Err(error),
        }
    }

    /// As [`Item::read`], with some work on the recording. A panic in either is an error of this scene.
    ///
    /// *Errors*: as [`Item::read`], those of `work`, and [`Error::Defect`].
    pub fn read_and<T>(
        self,
        options: &ReadOptions,
        work: impl FnOnce(Recording) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let path = self.path.clone();
        defect::caught(|| self.read(options).and_then(work))
            .unwrap_or_else(|source| Err(Error::Defect { path, source }))
    }

    /// Bytes that the item holds in memory.
    pub fn size(&self) -> usize {
        match &self.content {
            Content::Bytes(bytes) => bytes.len(),
            Content::Record(record) => record.framed.len(),
            Content::File(size) => *size,
            Content::Broken(_) => 0,
        }
    }
}

/// The scenes of some inputs, one after another. A shard is read record by record.
pub struct Items {
    files: vec::IntoIter<(PathBuf, PathBuf)>,
    shard: Option<(PathBuf, ShardReader)>,
}

impl Iterator for Items {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        loop {
            if let Some((root, shard)) = &mut self.shard {
                let root = root.clone();
                match shard.next_record() {
                    Some(Ok(record)) => {
                        let path = record.path();
                        return Some(Item { root, path, content: Content::Record(record) });
                    }
                    Some(Err(error)) => {
                        let path = shard.path().to_owned();
                        return Some(Item { root, path, content: Content::Broken(error) });
                    }
                    None => self.shard = None,
                }
            }
            let (root, path) = self.files.next()?;
            let content = match open(&path) {
                Ok(Opened::One(content)) => content,
                Ok(Opened::Shard(shard)) => {
                    self.shard = Some((root, shard));
                    continue;
                }
                Err(error) => Content::Broken(error),
            };
            return Some(Item { root, path, content });
        }
    }
}

enum Opened {
    One(Content),
    Shard(ShardReader),
}

fn open(file: &Path) -> Result<Opened, Error> {
    if !is_pipe(file) && !womd::is_shard(file) {
        let size = std::fs::metadata(file).map_or(0, |found| found.len());
        return Ok(Opened::One(Content::File(usize::try_from(size).unwrap_or(usize::MAX))));
    }
    Ok(match womd::open(file)? {
        Open::Shard(shard) => Opened::Shard(shard),
        Open::Other(stream) => Opened::One(Content::Bytes(recording::read_stream(file, stream)?)),
    })
}
