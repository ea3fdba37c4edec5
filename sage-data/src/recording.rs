//! A scene together with its source file, and the size limit of scene files.

use std::{
    borrow::Cow,
    collections::HashMap,
    path::{Path, PathBuf},
};

use sage_core::{
    files::{self, Existing},
    geometry::distance,
    motion::{HORIZON, NOW},
    scene::{Scene, TrackKind},
};

use crate::{
    Error, Format, ReadOptions, argoverse2, foreign,
    gpudrive::{self, EncodedGpuDrive},
    gzip, metadrive, native,
    pickle::Document,
    repairs::{Decoded, Repair},
    variants::PROVENANCE,
    womd::{self, EncodedScenario},
};

/// Size limit of a scene file, bytes. The largest public ones have 2 MB.
pub const MAX_SCENE_FILE: u64 = 256 << 20;

/// Limit of the total length of the lines of a map, metres. None of 30 public maps has more than 21 km.
/// Without a limit a small file could make every search among lines slow.
const MAX_LINES: f64 = 16e6;

/// Side of the squares in which points of a map are counted, metres.
const SQUARE: f64 = 4.0;
/// Limit of the number of points of a map in a square. None of 430 recorded maps has more than 83. Without a limit
/// thousands of lines could lie below one car, and every test of a car against the map would look at all of them.
const MOST_POINTS: u32 = 4000;

/// A scene and its source.
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

/// Refuses a map whose lines exceed [`MAX_LINES`].
fn check_lines(scene: &Scene, path: &Path) -> Result<(), Error> {
    let map = &scene.map;
    if bound_of_lines(&map.points) <= MAX_LINES {
        return Ok(());
    }
    let lines = map.features.iter().flat_map(|feature| map.points[feature.points.clone()].windows(2));
    let length: f64 = lines.map(|w| distance([w[0][0], w[0][1]], [w[1][0], w[1][1]])).sum();
    if length <= MAX_LINES {
        return Ok(());
    }
    Err(Error::Field {
        path: path.to_owned(),
        field: "map_features".to_owned(),
        found: format!("lines of {:.0} km in total", 1e-3 * length),
        expected: format!("at most {:.0} km", 1e-3 * MAX_LINES),
    })
}

/// Refuses a map with more than [`MOST_POINTS`] points in a square.
fn check_density(scene: &Scene, path: &Path) -> Result<(), Error> {
    let points = &scene.map.points;
    let square = |p: &[f64; 3]| [p[0], p[1]].map(|x| (x / SQUARE).floor() as i64);
    // Squares that share a slot count together: if no slot is full, no square is.
    let mut slots = [0u32; 4096];
    let slot = |[x, y]: [i64; 2]| (x.wrapping_mul(73) ^ y.wrapping_mul(179)) as usize % 4096;
    points.iter().for_each(|p| slots[slot(square(p))] += 1);
    if slots.iter().all(|count| *count <= MOST_POINTS) {
        return Ok(());
    }
    let mut squares: HashMap<[i64; 2], u32> = HashMap::new();
    points.iter().for_each(|p| *squares.entry(square(p)).or_default() += 1);
    let Some((at, count)) = squares.into_iter().max_by_key(|(at, count)| (*count, *at)) else {
        return Ok(());
    };
    if count <= MOST_POINTS {
        return Ok(());
    }
    let [x, y] = at.map(|k| k as f64 * SQUARE);
    Err(Error::Field {
        path: path.to_owned(),
        field: "map_features".to_owned(),
        found: format!("{count} points within {SQUARE} m of [{x}, {y}]"),
        expected: format!("at most {MOST_POINTS} points in a square of {SQUARE} m"),
    })
}

/// Upper bound on the total length of the lines, fast to compute: the sum of the steps along each axis,
/// including the steps from one feature to the next.
fn bound_of_lines(points: &[[f64; 3]]) -> f64 {
    let from = points.as_flattened();
    let to = from.get(3..).unwrap_or_default();
    let (mut from, mut to) = (from[..to.len()].chunks_exact(8), to.chunks_exact(8));
    // Eight independent sums, because each addition depends on the previous one.
    let mut sums = [0.0f64; 8];
    for (from, to) in from.by_ref().zip(to.by_ref()) {
        for lane in 0..8 {
            sums[lane] += (to[lane] - from[lane]).abs();
        }
    }
    let rest: f64 = from.remainder().iter().zip(to.remainder()).map(|(a, b)| (b - a).abs()).sum();
    sums.iter().sum::<f64>() + rest
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
            return Self::of_argoverse2(path, bytes, options);
        }
        let found = if format.is_none() { foreign::of_bytes(&bytes) } else { None };
        if format == Some(Format::Native) {
            let scene = native::decode(&bytes, options, path)?;
            return Self::checked(path, scene, Source::Native(bytes), options);
        }
        let source = parse(path, bytes).map_err(|error| foreign::instead_of(error, found))?;
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

    fn of_argoverse2(path: &Path, bytes: Vec<u8>, options: &ReadOptions) -> Result<Self, Error> {
        let mut options = options.clone();
        let now = *options.now.get_or_insert(argoverse2::DEFAULT_NOW);
        let made = argoverse2::document(path, bytes, &options)?;
        let mut scene = metadrive::decode(&made.document, &options, path)?.scene;
        let category = |id: &str| made.categories.get(id).copied().unwrap_or(0);
        (scene.adversary, scene.adversary_origin) = argoverse2::adversary(&scene, category);
        scene.notes.extend(made.notes);
        if scene.frames < NOW + 1 + HORIZON {
            let left = scene.frames - NOW - 1;
            scene.notes.push(format!("with frame {now} as now, {left} of {HORIZON} frames follow"));
        }
        Self::checked(path, scene, Source::Argoverse2(made.document), &options)
    }

    fn checked(path: &Path, mut scene: Scene, source: Source, options: &ReadOptions) -> Result<Self, Error> {
        check_lines(&scene, path)?;
        check_density(&scene, path)?;
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

    /// All values of the MetaDrive source; `None` if there is none.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn document(&self) -> Result<Option<Cow<'_, Document>>, Error> {
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
            let note = self.scene.notes.iter().find_map(|note| note.strip_prefix(PROVENANCE));
            return Ok(note.map(|text| text.trim_start_matches(": ").to_owned()));
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
            None => metadrive::fresh(&self.scene).to_pickle(),
        })
    }

    /// The recording as a native file.
    ///
    /// *Errors*: as [`Recording::to_pickle`].
    pub fn to_native(&self) -> Result<Vec<u8>, Error> {
        native::encode(&self.scene, self.written(true)?.as_ref(), &self.path)
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
        let encode = |document: &Document| womd::encode(&self.scene, document, stem.as_deref());
        let encoded = match self.written(true)? {
            Some(document) => encode(&document),
            None => encode(&metadrive::fresh(&self.scene)),
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
        let document = self.written(true)?.unwrap_or_else(|| metadrive::fresh(&self.scene));
        Ok(gpudrive::encode(&self.scene, &document, attacker.as_deref()))
    }

    /// The source with the tracks of the scene; with `ten_hertz` also with its frames.
    fn written(&self, ten_hertz: bool) -> Result<Option<Document>, Error> {
        let Some(source) = self.document()? else { return Ok(None) };
        let original = self.as_read(&source)?;
        let mut document = source.into_owned();
        metadrive::write_changes(&mut document, &self.scene, &original, ten_hertz, &self.path)?;
        Ok(Some(document))
    }

    /// Writes the recording atomically and replaces an existing file. The format is native if the name ends
    /// in `.safetensors`, and a MetaDrive pickle otherwise.
    ///
    /// *Errors*: [`Error::Write`], or as [`Recording::to_pickle`].
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        let native = path.extension().is_some_and(|ending| ending == "safetensors");
        let bytes = if native { self.to_native()? } else { self.to_pickle()? };
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
    read_with(path, files::read_argument).map_err(|error| match error {
        Error::TooLarge { .. } => {
            let start = files::read_start(path, foreign::LOOK as u64).unwrap_or_default();
            let found = if Format::of(&start).is_none() { foreign::of_bytes(&start) } else { None };
            // Without a start nothing was looked at.
            found.filter(|_| !start.is_empty()).map_or(error, |found| found.error(path))
        }
        error => error,
    })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_with_many_points_in_one_place_is_refused() {
        use sage_core::scene::{MapFeature, MapKind};
        let mut scene = crate::procedural::generate(crate::procedural::Kind::Straight, 0, 0).unwrap();
        let with = |scene: &mut Scene, count: usize, step: f64| {
            let map = std::sync::Arc::make_mut(&mut scene.map);
            let first = map.points.len();
            map.points.extend((0..count).map(|k| [step * k as f64, 500.0, 0.0]));
            let points = first..map.points.len();
            map.features.push(MapFeature { id: "many".into(), kind: MapKind::StopSign, points, lane: None });
        };
        with(&mut scene, 30_000, 0.01);
        check_density(&scene, Path::new("x")).unwrap();
        with(&mut scene, 4001, 1e-6);
        let error = check_density(&scene, Path::new("x")).unwrap_err().to_string();
        assert!(error.contains("at most 4000 points in a square of 4 m"), "{error}");
    }

    #[test]
    fn the_bound_of_lines_is_the_sum_of_steps_along_the_axes() {
        for n in 0..40 {
            let points: Vec<[f64; 3]> = (0..n).map(|k| [f64::from(k * k), f64::from(-3 * k), 0.0]).collect();
            let step = |w: &[[f64; 3]]| (w[1][0] - w[0][0]).abs() + (w[1][1] - w[0][1]).abs();
            let expected: f64 = points.windows(2).map(step).sum();
            assert_eq!(bound_of_lines(&points), expected, "{n} points");
        }
    }
}
