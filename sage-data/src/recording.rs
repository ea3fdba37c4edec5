//! A scene together with its source file, and the size limit of scene files.

mod added;
mod without;

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
};

use sage_core::{
    files::{self, Existing},
    scene::{Note, PROVENANCE, Scene, TrackKind},
};

use crate::{
    Error, Format, ReadOptions, foreign,
    gpudrive::{self, EncodedGpuDrive},
    gzip, map_limits, metadrive, native, parquet_files,
    pickle::Document,
    repairs::{Decoded, Repair},
    womd::{self, EncodedScenario},
};

/// Size limit of a scene file, bytes. The largest public ones have 2 MB.
pub const MAX_SCENE_FILE: u64 = 256 << 20;

/// A scene and its source.
///
/// A scene file of one format becomes one of another:
///
/// ```
/// use std::path::Path;
///
/// use sage_data::Recording;
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let recording = Recording::read(file)?;
/// let native = recording.to_native()?;
/// let again = Recording::from_bytes(Path::new("crossing.safetensors"), native)?;
/// // The same scene, whichever file it came from.
/// assert_eq!(again.scene.content_hash(), recording.scene.content_hash());
/// # Ok::<(), sage_data::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// The scene.
    pub scene: Scene,
    /// The other content of the file.
    pub source: Source,
    /// How it was read.
    pub options: ReadOptions,
}

/// Source of a scene.
#[derive(Clone, Debug)]
pub enum Source {
    /// A MetaDrive pickle, with all its values.
    Pickle(Document),
    /// A native file, as bytes; its MetaDrive source is unpacked on demand.
    Native(Vec<u8>),
    /// A record of the Waymo Open Motion Dataset, as MetaDrive values without summaries.
    Record(Document),
    /// A scene of GPUDrive, as MetaDrive values without summaries.
    GpuDrive(Document),
    /// A scenario of Argoverse 2, as such values.
    Argoverse2(Document),
    /// No file: the scene is procedural.
    Procedural,
}

impl Recording {
    /// Reads and checks a scene file of any format, or a record of a shard: `SHARD#3` or `SHARD#<id>`.
    ///
    /// *Errors*: [`Error`], which names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::read_as(path, &ReadOptions::default())
    }

    /// As [`Recording::read`], with options.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn read_as(path: &Path, options: &ReadOptions) -> Result<Self, Error> {
        Self::from_bytes_as(path, read_bytes(path)?, options)
    }

    /// Reads and checks the bytes of a scene file. `path` only names the file in errors and in the result.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, Error> {
        Self::from_bytes_as(path, bytes, &ReadOptions::default())
    }

    /// As [`Recording::from_bytes`], with options.
    ///
    /// *Errors*: as [`Recording::read`].
    pub fn from_bytes_as(path: &Path, bytes: Vec<u8>, options: &ReadOptions) -> Result<Self, Error> {
        let bytes = match gpudrive::is_compressed_name(path) && gzip::is_gzip(&bytes) {
            true => inflate(path, &bytes)?,
            false => bytes,
        };
        if is_record(path, &bytes) {
            return Self::of_record(path, &womd::only_record(path, bytes)?, options);
        }
        let format = Format::of(&bytes);
        if format == Some(Format::GpuDrive) {
            return Self::of_gpudrive(path, &bytes, options);
        }
        if format == Some(Format::Parquet) {
            return Self::of_parquet(path, bytes, options);
        }
        if format.is_none()
            && let Some(found) = foreign::of_bytes(&bytes)
        {
            return Err(found.error(path));
        }
        if format == Some(Format::Native) {
            let scene = native::decode(&bytes, options, path)?;
            return Self::checked(path, scene, Source::Native(bytes), options);
        }
        let source = parse(path, bytes)?;
        let explain = |error| foreign::of_document(&source).map_or(error, |found| found.error(path));
        let scene = metadrive::decode(&source, options, path).map_err(explain)?.scene;
        Self::checked(path, scene, Source::Pickle(source), options)
    }

    fn of_gpudrive(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<Self, Error> {
        let (source, notes) = gpudrive::document(path, bytes, options)?;
        let mut scene = metadrive::decode(&source, options, path)?.scene;
        scene.notes.extend(notes);
        Self::checked(path, scene, Source::GpuDrive(source), options)
    }

    #[cfg(feature = "argoverse2")]
    fn of_parquet(path: &Path, bytes: Vec<u8>, options: &ReadOptions) -> Result<Self, Error> {
        use sage_core::motion::{HORIZON, NOW};

        use crate::argoverse2;

        let mut options = options.clone();
        let now = *options.now.get_or_insert(argoverse2::DEFAULT_NOW);
        let made = argoverse2::document(path, bytes, &options)?;
        let mut scene = metadrive::decode(&made.document, &options, path)?.scene;
        let category = |id: &str| made.categories.get(id).copied().unwrap_or(0);
        (scene.adversary, scene.adversary_origin) = argoverse2::adversary(&scene, category);
        scene.notes.extend(made.notes);
        if scene.frames < NOW + 1 + HORIZON {
            let left = scene.frames - NOW - 1;
            scene
                .notes
                .push(Note::Other(format!("with frame {now} as now, {left} of {HORIZON} frames follow")));
        }
        Self::checked(path, scene, Source::Argoverse2(made.document), &options)
    }

    #[cfg(not(feature = "argoverse2"))]
    fn of_parquet(path: &Path, _: Vec<u8>, _: &ReadOptions) -> Result<Self, Error> {
        let found = "a Parquet file, as Argoverse 2 has them";
        Err(Error::OtherFormat {
            path: path.to_owned(),
            found,
            remedy: "this program was built without the feature `argoverse2`, which reads it",
        })
    }

    fn checked(path: &Path, mut scene: Scene, source: Source, options: &ReadOptions) -> Result<Self, Error> {
        map_limits::check(&scene, path)?;
        if let Some(id) = options.ego_track.as_deref().filter(|id| scene.ego().id != *id) {
            let wrong = |problem: String| Error::Field {
                path: path.to_owned(),
                field: "(ego)".to_owned(),
                found: format!("`{}`, which cannot be the ego: {problem}", id.escape_debug()),
                expected: "the id of a vehicle that is there now".to_owned(),
            };
            scene = scene.with_roles(Some(id), None).map_err(|error| wrong(error.to_string()))?;
            if scene.ego().kind != TrackKind::Vehicle {
                return Err(wrong(format!("it is a {}", scene.ego().kind.name())));
            }
        }
        if !options.without.is_empty() {
            scene = without::scene(scene, &options.without, path)?;
        }
        Ok(Self { path: path.to_owned(), scene, source, options: options.clone() })
    }

    /// Reads and checks a record with its frame; `path` names it in errors, such as `SHARD#3`.
    ///
    /// *Errors*: [`Error::Shard`], [`Error::Message`] or [`Error::Field`].
    pub(crate) fn of_record(path: &Path, framed: &[u8], options: &ReadOptions) -> Result<Self, Error> {
        Self::of_message(path, womd::message(path, framed)?, options)
    }

    fn of_message(path: &Path, message: &[u8], options: &ReadOptions) -> Result<Self, Error> {
        let (source, has_id) = womd::document(path, message)?;
        let mut scene = metadrive::decode(&source, options, path)?.scene;
        if !has_id {
            scene.notes.push(Repair::NoId.note(format!("the record has no id; it is named `{}`", scene.id)));
        }
        Self::checked(path, scene, Source::Record(source), options)
    }

    /// The scene of its values as they were read, before anything was changed: what a written scene is compared with.
    ///
    /// *Errors*: as [`metadrive::decode`].
    pub(crate) fn as_read(&self, document: &Document) -> Result<Decoded, Error> {
        // Motion that was recomputed is a change that is written.
        let options = ReadOptions { trust_positions: false, ..self.options.clone() };
        metadrive::decode(document, &options, &self.path)
    }

    /// A recording of a procedural scene, which has no file.
    pub fn procedural(scene: Scene) -> Self {
        let options = ReadOptions::default();
        Self { path: PathBuf::from(&scene.id), scene, source: Source::Procedural, options }
    }

    /// All values of the MetaDrive source, of all road users; `None` if there is none.
    fn whole_document(&self) -> Result<Option<Cow<'_, Document>>, Error> {
        Ok(match &self.source {
            Source::Pickle(document) => Some(Cow::Borrowed(document)),
            Source::Record(document) | Source::GpuDrive(document) | Source::Argoverse2(document) => {
                let mut document = document.clone();
                metadrive::complete(&mut document);
                Some(Cow::Owned(document))
            }
            Source::Native(bytes) => native::document(bytes, &self.path)?.map(Cow::Owned),
            Source::Procedural => None,
        })
    }

    /// Name of the data set in the metadata, such as `waymo`; that of this project for a procedural scene.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn dataset(&self) -> Result<Option<String>, Error> {
        let document = match &self.source {
            Source::Record(document) | Source::GpuDrive(document) | Source::Argoverse2(document) => {
                Cow::Borrowed(document)
            }
            _ => match self.document()? {
                Some(document) => document,
                None => return Ok(Some(metadrive::PROCEDURAL_DATASET.to_owned())),
            },
        };
        let metadata = document.get(document.root(), "metadata");
        let dataset = metadata.and_then(|metadata| document.get(metadata, "dataset"));
        Ok(dataset.and_then(|dataset| document.text(dataset)).map(str::to_owned))
    }

    /// How the scene was derived from its source, as [`crate::VariantWriter`] wrote it; `None` without.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn provenance(&self) -> Result<Option<String>, Error> {
        let Some(document) = self.document()? else {
            return Ok(self.scene.notes.iter().find_map(|note| match note {
                Note::Provenance(text) => Some(text.clone()),
                _ => None,
            }));
        };
        let metadata = document.get(document.root(), "metadata");
        let text = metadata.and_then(|metadata| document.get(metadata, PROVENANCE));
        Ok(text.and_then(|text| document.text(text)).map(str::to_owned))
    }

    /// The recording as a MetaDrive pickle.
    ///
    /// Keys, types, shapes and values are those of the source, except for changed tracks, which replace those
    /// of the source. The frames are those of the file, unless a track changed or a part of the recording was chosen.
    /// A scene without a source becomes a new file with 32-bit floats.
    ///
    /// *Errors*: [`Error::Field`] if the scene has other tracks, frames, map or lights than its file; as
    /// [`Recording::document`].
    pub fn to_pickle(&self) -> Result<Vec<u8>, Error> {
        Ok(match self.written(false)? {
            Some(document) => document.to_pickle(),
            None => self.fresh(&self.scene.as_observed())?.to_pickle(),
        })
    }

    /// A document for a scene without a source. It says how the scene was derived: who was added attacks in other formats too.
    fn fresh(&self, scene: &Scene) -> Result<Document, Error> {
        let mut document = metadrive::fresh(scene);
        if let Some(provenance) = self.provenance()? {
            metadrive::annotate(&mut document, PROVENANCE, &provenance);
        }
        Ok(document)
    }

    /// The recording as a native file.
    ///
    /// *Errors*: as [`Recording::to_pickle`].
    pub fn to_native(&self) -> Result<Vec<u8>, Error> {
        native::encode(&self.scene.as_observed(), self.written(true)?.as_ref(), &self.path)
    }

    /// The recording as a `Scenario` message of the Waymo Open Motion Dataset.
    ///
    /// A scene that this project changed is named after its file, because all variants of a scene have its id.
    ///
    /// The message is read again before it is returned.
    ///
    /// *Errors*: as [`Recording::to_pickle`]; [`Error::TooLarge`], and those of a record that cannot be read.
    pub fn to_scenario(&self) -> Result<EncodedScenario, Error> {
        let is_variant = !matches!(self.source, Source::Record(_)) && self.provenance()?.is_some();
        let stem = self.path.file_stem().filter(|_| is_variant).map(|stem| stem.to_string_lossy());
        // A scene without an id is named after its file too.
        let own =
            self.path.file_stem().filter(|_| self.scene.id.is_empty()).map(|stem| stem.to_string_lossy());
        let stem = stem.or(own);
        let scene = self.scene.as_observed();
        let encode = |document: &Document| womd::encode(&scene, document, stem.as_deref());
        let encoded = match self.written(true)? {
            Some(document) => encode(&document),
            None => encode(&self.fresh(&scene)?),
        };
        if encoded.data.len() as u64 > womd::MAX_RECORD {
            return Err(Error::TooLarge { path: self.path.clone(), limit: womd::MAX_RECORD });
        }
        // What no reader takes must not be written.
        Self::of_message(&self.path, &encoded.data, &self.options)?;
        Ok(encoded)
    }

    /// The recording as JSON of GPUDrive. The adversary of an attack is marked such that simulators drive its path.
    ///
    /// *Errors*: as [`Recording::to_pickle`].
    pub fn to_gpudrive(&self) -> Result<EncodedGpuDrive, Error> {
        let provenance = self.provenance()?;
        let attacker = provenance.as_deref().and_then(gpudrive::attacker);
        let scene = self.scene.as_observed();
        let document = match self.written(true)? {
            Some(document) => document,
            None => self.fresh(&scene)?,
        };
        gpudrive::encode(&scene, &document, attacker.as_deref(), &self.path)
    }

    /// The source with the tracks of the scene; with `ten_hertz` also with its frames.
    fn written(&self, ten_hertz: bool) -> Result<Option<Document>, Error> {
        let Some(source) = self.document()? else { return Ok(None) };
        let original = self.as_read(&source)?;
        let mut document = source.into_owned();
        metadrive::write_changes(&mut document, &self.scene, &original, ten_hertz, &self.path)?;
        Ok(Some(document))
    }

    /// Writes the recording atomically and replaces an existing file. The format is that of the name's ending ([`Format::ending`]) if
    /// a scene is one file in it, and a MetaDrive pickle otherwise.
    ///
    /// *Errors*: [`Error::Write`], or as [`Recording::to_pickle`].
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        let ending = path.extension().and_then(|ending| ending.to_str());
        let bytes = match Format::all_written().find(|format| Some(format.ending()) == ending) {
            Some(Format::Native) => self.to_native()?,
            Some(Format::GpuDrive) => self.to_gpudrive()?.json,
            Some(Format::TfRecord) => womd::frame(&self.to_scenario()?.data),
            // A scenario is two files, and no Parquet is written.
            Some(Format::Pickle | Format::OpenScenario | Format::Parquet) | None => self.to_pickle()?,
        };
        files::write(path, &bytes, Existing::Replace)
            .map_err(|source| Error::Write { path: path.to_owned(), source })
    }
}

/// The content of a compressed file.
fn inflate(path: &Path, bytes: &[u8]) -> Result<Vec<u8>, Error> {
    gzip::inflate(bytes, MAX_SCENE_FILE).map_err(|source| match source.kind() {
        std::io::ErrorKind::FileTooLarge => Error::TooLarge { path: path.to_owned(), limit: MAX_SCENE_FILE },
        _ => Error::Read { path: path.to_owned(), source },
    })
}

/// True if some bytes are a record or a shard. A file that is named like a shard is one, because the length of a
/// record can look like the start of a pickle.
fn is_record(path: &Path, bytes: &[u8]) -> bool {
    womd::is_shard_name(path) || gzip::is_gzip(bytes) || Format::of(bytes) == Some(Format::TfRecord)
}

/// The values of a pickle file.
pub(crate) fn parse(path: &Path, bytes: Vec<u8>) -> Result<Document, Error> {
    Document::parse(bytes).map_err(|problem| Error::Pickle { path: path.to_owned(), problem })
}

/// The bytes of a scene file that the user gave or that is in a folder, for [`Recording::from_bytes`].
///
/// For a record of a shard they are the record with its frame.
///
/// *Errors*: [`Error::Read`]; [`Error::TooLarge`] beyond [`MAX_SCENE_FILE`]; [`Error::Shard`].
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, Error> {
    if womd::is_shard(path) || womd::split_path(path).is_some() {
        return womd::read_framed(path);
    }
    let read = read_with(path, files::read_argument);
    let map = if read.as_ref().is_ok_and(|bytes| parquet_files::is_parquet(bytes)) {
        parquet_files::map_beside(path)
    } else {
        None
    };
    let read = match (read, map) {
        (Ok(bytes), Some(map)) => return Ok(parquet_files::with_map(bytes, &parquet_files::read_map(&map)?)),
        (read, _) => read,
    };
    read.map_err(|error| match error {
        Error::TooLarge { .. } => {
            let start = files::read_start(path, foreign::LOOK as u64).unwrap_or_default();
            let found = if Format::of(&start).is_none() { foreign::of_bytes(&start) } else { None };
            // Without a start nothing was looked at.
            found.filter(|_| !start.is_empty()).map_or(error, |found| found.error(path))
        }
        error => error,
    })
}

/// Whether a file is one of those that a scene is read from: its own, also by another name, or the map beside it. No output may
/// take its place.
pub fn is_source(scene: &Path, file: &Path) -> bool {
    let Ok(file) = file.canonicalize() else { return false };
    let own = womd::shard_of(scene).unwrap_or_else(|| scene.to_owned());
    let sources = [Some(own), parquet_files::map_beside(scene)];
    sources.into_iter().flatten().any(|source| source.canonicalize().is_ok_and(|source| source == file))
}

/// The bytes of a file in a folder, which must be a regular file.
pub(crate) fn read_inside(path: &Path) -> Result<Vec<u8>, Error> {
    read_with(path, files::read)
}

/// All bytes of a pipe that the user gave.
pub(crate) fn read_stream(path: &Path, stream: impl std::io::Read) -> Result<Vec<u8>, Error> {
    read_with(path, |_, limit| files::read_open(stream, 0, limit))
}

fn read_with(
    path: &Path,
    read: impl FnOnce(&Path, u64) -> std::io::Result<Vec<u8>>,
) -> Result<Vec<u8>, Error> {
    read(path, MAX_SCENE_FILE).map_err(|source| match source.kind() {
        std::io::ErrorKind::FileTooLarge => Error::TooLarge { path: path.to_owned(), limit: MAX_SCENE_FILE },
        _ => Error::Read { path: path.to_owned(), source },
    })
}

impl womd::Record {
    /// Reads and checks the scene.
    ///
    /// *Errors*: [`Error::Shard`], [`Error::Message`] or [`Error::Field`].
    pub fn read(&self, options: &ReadOptions) -> Result<Recording, Error> {
        Recording::of_record(&self.path(), &self.framed, options).map_err(|error| self.located(error))
    }
}
