//! A scene together with the file it came from.

use std::path::{Path, PathBuf};

use sage_core::scene::Scene;

use crate::{Error, metadrive, pickle::Document};

/// Largest scene file that is read, bytes. The largest of the public ones hold 2 MB.
pub(crate) const MAX_FILE: u64 = 256 << 20;

/// A scene and what its file holds beyond it.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// The scene.
    pub scene: Scene,
    /// All values of the file.
    pub source: Document,
}

impl Recording {
    /// Reads and checks a scene file.
    ///
    /// *Errors*: [`Error`], which names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::from_bytes(path, read_bounded(path)?)
    }

    /// Reads and checks the bytes of a scene file; `path` only names it.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, Error> {
        let source = parse(path, bytes)?;
        let scene = metadrive::decode(&source, path)?;
        Ok(Self { path: path.to_owned(), scene, source })
    }

    /// The recording as a MetaDrive pickle. Where the scene is as it was read, keys, types, shapes
    /// and values are those of the source; tracks that were changed are written in their place.
    ///
    /// *Errors*: as [`metadrive::encode`].
    pub fn to_pickle(&self) -> Result<Vec<u8>, Error> {
        metadrive::encode(&self.scene, &self.source, &self.path).map(|document| document.to_pickle())
    }

    /// Writes the recording as a MetaDrive pickle, under a temporary name first.
    ///
    /// *Errors*: [`Error::Write`], or as [`Recording::to_pickle`].
    pub fn write_pickle(&self, path: &Path) -> Result<(), Error> {
        let fail = |source| Error::Write { path: path.to_owned(), source };
        let mut name = path.as_os_str().to_owned();
        name.push(".part");
        let part = PathBuf::from(name);
        std::fs::write(&part, self.to_pickle()?).map_err(fail)?;
        std::fs::rename(&part, path).map_err(fail)
    }
}

/// The values of a pickle file.
pub(crate) fn parse(path: &Path, bytes: Vec<u8>) -> Result<Document, Error> {
    Document::parse(bytes).map_err(|problem| Error::Pickle { path: path.to_owned(), problem })
}

/// A file's bytes, if it is no larger than [`MAX_FILE`].
pub(crate) fn read_bounded(path: &Path) -> Result<Vec<u8>, Error> {
    use std::io::Read;
    let fail = |source| Error::Read { path: path.to_owned(), source };
    let file = std::fs::File::open(path).map_err(fail)?;
    let size = file.metadata().map_err(fail)?.len();
    if size > MAX_FILE {
        return Err(Error::TooLarge { path: path.to_owned(), size, limit: MAX_FILE });
    }
    let mut bytes = Vec::with_capacity(size as usize);
    // A pipe has no size to ask for, so the limit is kept while reading as well.
    file.take(MAX_FILE + 1).read_to_end(&mut bytes).map_err(fail)?;
    if bytes.len() as u64 > MAX_FILE {
        return Err(Error::TooLarge { path: path.to_owned(), size: bytes.len() as u64, limit: MAX_FILE });
    }
    Ok(bytes)
}
