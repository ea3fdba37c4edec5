//! A scene together with the file it came from.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use sage_core::scene::Scene;

use crate::{Error, metadrive, native, pickle::Document};

/// Largest scene file that is read, bytes. The largest of the public ones hold 2 MB.
pub(crate) const MAX_FILE: u64 = 256 << 20;

/// A scene and what its file holds beyond it.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// The scene.
    pub scene: Scene,
    /// What else the file holds.
    pub source: Source,
    /// How the scene came to differ from its source, for whoever reads the written file: it becomes
    /// the text [`PROVENANCE`] in the metadata, or a note in a native file without a source.
    pub provenance: Option<String>,
}

/// Key of a written file's metadata that tells how the scene was made from its source.
pub const PROVENANCE: &str = "sage_provenance";

/// Where a scene came from.
#[derive(Clone, Debug)]
pub enum Source {
    /// A MetaDrive pickle, with all its values.
    Pickle(Document),
    /// A native file, by its bytes: its source is unpacked when it is asked for.
    Native(Vec<u8>),
    /// No file: the scene was made.
    Made,
}

impl Recording {
    /// Reads and checks a scene file of either format.
    ///
    /// *Errors*: [`Error`], which names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::from_bytes(path, read_bounded(path)?)
    }

    /// Reads and checks the bytes of a scene file; `path` only names it.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, Error> {
        if is_native(&bytes) {
            let scene = native::decode(&bytes, path)?;
            return Ok(Self {
                path: path.to_owned(),
                scene,
                source: Source::Native(bytes),
                provenance: None,
            });
        }
        let source = parse(path, bytes)?;
        let scene = metadrive::decode(&source, path)?;
        Ok(Self { path: path.to_owned(), scene, source: Source::Pickle(source), provenance: None })
    }

    /// A recording of a scene that was made, not read.
    pub fn made(scene: Scene) -> Self {
        Self { path: PathBuf::from(&scene.id), scene, source: Source::Made, provenance: None }
    }

    /// All values of the MetaDrive file behind the scene; `None` if there was none.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn document(&self) -> Result<Option<Cow<'_, Document>>, Error> {
        Ok(match &self.source {
            Source::Pickle(document) => Some(Cow::Borrowed(document)),
            Source::Native(bytes) => native::document(bytes, &self.path)?.map(Cow::Owned),
            Source::Made => None,
        })
    }

    /// Whether the scene was made by this project rather than recorded: it has no source, or its
    /// source names the project as its data set.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn is_made(&self) -> Result<bool, Error> {
        let Some(document) = self.document()? else { return Ok(true) };
        let metadata = document.get(document.root(), "metadata");
        let dataset = metadata.and_then(|metadata| document.get(metadata, "dataset"));
        Ok(dataset.and_then(|dataset| document.text(dataset)) == Some(metadrive::MADE))
    }

    /// The recording as a MetaDrive pickle. Where the scene is as it was read, keys, types, shapes
    /// and values are those of the source; tracks that were changed are written in their place. A
    /// scene without a source becomes a new file with 32-bit floats.
    ///
    /// *Errors*: as [`metadrive::encode`] and [`Recording::document`].
    pub fn to_pickle(&self) -> Result<Vec<u8>, Error> {
        Ok(match self.written()? {
            Some(document) => document.to_pickle(),
            None => self.annotated(metadrive::fresh(&self.scene)).to_pickle(),
        })
    }

    /// The recording as a native file.
    ///
    /// *Errors*: as [`Recording::to_pickle`].
    pub fn to_native(&self) -> Result<Vec<u8>, Error> {
        let source = self.written()?;
        match &self.provenance {
            // Without a source there is no metadata to hold it: it becomes a note.
            Some(text) if source.is_none() => {
                let mut scene = self.scene.clone();
                scene.notes.push(format!("{PROVENANCE}: {text}"));
                native::encode(&scene, None, &self.path)
            }
            _ => native::encode(&self.scene, source.as_ref(), &self.path),
        }
    }

    /// The source with the scene's tracks in place of its own.
    fn written(&self) -> Result<Option<Document>, Error> {
        let Some(source) = self.document()? else { return Ok(None) };
        Ok(Some(self.annotated(metadrive::encode(&self.scene, &source, &self.path)?)))
    }

    fn annotated(&self, mut document: Document) -> Document {
        if let Some(text) = &self.provenance {
            metadrive::annotate(&mut document, PROVENANCE, text);
        }
        document
    }

    /// Writes the recording under a temporary name and renames it: as a native file if the name
    /// ends in `.safetensors`, as a MetaDrive pickle otherwise.
    ///
    /// *Errors*: [`Error::Write`], or as [`Recording::to_pickle`].
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        let fail = |source| Error::Write { path: path.to_owned(), source };
        let native = path.extension().is_some_and(|ending| ending == "safetensors");
        let bytes = if native { self.to_native()? } else { self.to_pickle()? };
        let mut name = path.as_os_str().to_owned();
        name.push(".part");
        let part = PathBuf::from(name);
        std::fs::write(&part, bytes).map_err(fail)?;
        std::fs::rename(&part, path).map_err(fail)
    }
}

/// Whether bytes are safetensors: a length of eight bytes, then a brace. The first byte of the
/// length can be that of a pickle, but then no pickle's next bytes make a length this small.
fn is_native(bytes: &[u8]) -> bool {
    let Some((length, [b'{', ..])) = bytes.split_first_chunk::<8>() else { return false };
    bytes[0] != 0x80 || u64::from_le_bytes(*length) <= bytes.len() as u64
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
