//! Scenes of files, folders and shards, read one after another and worked on in parallel. Memory stays the same,
//! however many there are.

use std::{
    path::{Path, PathBuf},
    vec,
};

use rayon::prelude::*;

use crate::{
    Error, Recording, folder, recording,
    womd::{self, Open, Record, Shard},
};

/// Scenes that are worked on before their results go to the caller.
const WINDOW: usize = 64;
/// Bytes of records that wait for their turn at most, besides those of one record.
const WINDOW_BYTES: usize = 8 << 20;

/// A scene to be read.
pub struct Item {
    path: PathBuf,
    content: Content,
}

enum Content {
    File,
    /// What a pipe held.
    Bytes(Vec<u8>),
    Record(Record),
    /// A record, or a whole file, that cannot be read.
    Broken(Error),
}

impl Item {
    /// The file, or the record as `SHARD#3`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// True for a record of a shard, which is named after its scene and not after its file.
    pub fn is_record(&self) -> bool {
        matches!(self.content, Content::Record(_))
    }

    /// The file name of an output, without ending: that of the file, or the id of a record.
    ///
    /// *Errors*: a record that is no scene.
    pub fn scene_name(&self) -> Result<String, Error> {
        match &self.content {
            Content::Record(record) => record.scene_id(&self.path),
            _ => Ok(self.path.file_stem().unwrap_or(self.path.as_os_str()).to_string_lossy().into_owned()),
        }
    }

    /// Reads and checks the scene.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn read(self) -> Result<Recording, Error> {
        match self.content {
            Content::File => Recording::read(&self.path),
            Content::Bytes(bytes) => Recording::from_bytes(&self.path, bytes),
            Content::Record(record) => record.read(&self.path),
            Content::Broken(error) => Err(error),
        }
    }

    fn size(&self) -> usize {
        match &self.content {
            Content::Record(record) => record.framed.len(),
            _ => 0,
        }
    }
}

/// Applies `work` to the scenes under some paths, in parallel, and passes the results to `take` in their order.
/// Stops at the first `Err` of `take` and returns it.
///
/// A path is a scene file, a record, a shard, a pipe with a shard, or a folder of files and shards.
///
/// *Errors*: the first of `take`. A file, folder or shard that cannot be read is an [`Item`] whose reading fails.
pub fn stream<T: Send, E: Send>(
    paths: &[PathBuf],
    work: impl Fn(Item) -> T + Sync,
    mut take: impl FnMut(&Path, T) -> Result<(), E> + Send,
) -> Result<(), E> {
    let mut items = Items { paths: paths.to_vec().into_iter(), files: Vec::new().into_iter(), shard: None };
    let mut window = items.window();
    while !window.is_empty() {
        // The next window is read while this one is worked on.
        let (results, next) = rayon::join(
            || {
                let one = |item: Item| (item.path.clone(), work(item));
                window.into_par_iter().with_max_len(1).map(one).collect::<Vec<_>>()
            },
            || items.window(),
        );
        for (path, result) in results {
            take(&path, result)?;
        }
        window = next;
    }
    Ok(())
}

/// All scenes under some paths, one after another.
struct Items {
    paths: vec::IntoIter<PathBuf>,
    files: vec::IntoIter<PathBuf>,
    shard: Option<Shard>,
}

impl Items {
    /// Opens a file: a shard, of which the records follow, or one scene.
    fn open(&mut self, file: &Path) -> Result<Option<Content>, Error> {
        let is_pipe = file.to_str() == Some("-") || std::fs::metadata(file).is_ok_and(|found| !found.is_file());
        if !is_pipe && !womd::is_shard(file) {
            return Ok(Some(Content::File));
        }
        match womd::open(file)? {
            Open::Shard(shard) => {
                self.shard = Some(shard);
                Ok(None)
            }
            Open::Other(stream) => Ok(Some(Content::Bytes(recording::read_stream(file, stream)?))),
        }
    }

    fn window(&mut self) -> Vec<Item> {
        let (mut window, mut size) = (Vec::new(), 0);
        while window.len() < WINDOW && size < WINDOW_BYTES {
            let Some(item) = self.next() else { break };
            size += item.size();
            window.push(item);
        }
        window
    }
}

impl Iterator for Items {
    type Item = Item;

    fn next(&mut self) -> Option<Item> {
        loop {
            if let Some(shard) = &mut self.shard {
                match shard.next_record() {
                    Some(Ok(record)) => {
                        let path = shard.path_of(&record);
                        return Some(Item { path, content: Content::Record(record) });
                    }
                    Some(Err(error)) => return Some(broken(shard.path(), error)),
                    None => self.shard = None,
                }
            }
            if let Some(file) = self.files.next() {
                match self.open(&file) {
                    Ok(Some(content)) => return Some(Item { path: file, content }),
                    Ok(None) => continue,
                    Err(error) => return Some(broken(&file, error)),
                }
            }
            let path = self.paths.next()?;
            match folder::files(&path) {
                Ok(files) => self.files = files.into_iter(),
                Err(error) => return Some(broken(&path, error)),
            }
        }
    }
}

fn broken(path: &Path, error: Error) -> Item {
    Item { path: path.to_owned(), content: Content::Broken(error) }
}
