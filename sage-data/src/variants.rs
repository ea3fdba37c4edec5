//! Variants of one recording with changed tracks, as scene files.

use std::path::{Path, PathBuf};

use sage_core::{
    scene::Scene,
    scene::{Note, PROVENANCE},
};

use crate::{
    Error, Format, Recording,
    gpudrive::{self, EncodedGpuDrive},
    metadrive, native,
    pickle::Document,
    repairs::Decoded,
};

/// Writes variants of a recording. Their common content is prepared once.
///
/// A pickle has all values that MetaDrive 0.4.3 reads. Object and number summaries are those of the variant,
/// and all other values are those of the source.
///
/// The recorded scene with another future of its adversary, as a file of the same data set:
///
/// ```
/// use std::path::Path;
///
/// use sage_core::motion::Trajectory;
/// use sage_data::{Recording, VariantWriter};
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let recording = Recording::read(file)?;
/// let adversary = recording.scene.adversary_index()?;
/// // The adversary stops where it is *now*.
/// let stops = Trajectory::new("stops", vec![recording.scene.tracks[adversary].point(10); 80])?;
/// let mut scene = recording.scene.clone();
/// scene.tracks[adversary] = scene.tracks[adversary].following(&stops);
///
/// let bytes = VariantWriter::new(&recording)?.variant(&scene, r#"{"made": "by hand"}"#)?.to_pickle();
/// let written = Recording::from_bytes(Path::new("variant.pkl"), bytes)?;
/// assert_eq!(written.provenance()?.as_deref(), Some(r#"{"made": "by hand"}"#));
/// assert_eq!(written.scene.tracks[adversary].point(90), written.scene.tracks[adversary].point(10));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct VariantWriter {
    path: PathBuf,
    /// The completed values of the file, and the scene as it was read; none for a procedural scene.
    source: Option<(Document, Decoded)>,
    dataset: String,
    version: String,
}

impl VariantWriter {
    /// Prepares the variants of a recording.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn new(recording: &Recording) -> Result<Self, Error> {
        let path = recording.path.clone();
        let Some(document) = recording.document()? else {
            let document = metadrive::fresh(&recording.scene);
            let [dataset, version] = names(&document);
            return Ok(Self { path, source: None, dataset, version });
        };
        let mut document = document.into_owned();
        let original = recording.as_read(&document)?;
        metadrive::complete(&mut document);
        let [dataset, version] = names(&document);
        Ok(Self { path, source: Some((document, original)), dataset, version })
    }

    /// Name of the recording's data set.
    pub fn dataset(&self) -> &str {
        &self.dataset
    }

    /// Version of the data set, or of the program that wrote the file.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// A variant whose files state their `provenance`.
    ///
    /// *Errors*: [`Error::Field`] if the variant has other tracks, frames, map or lights than the recording.
    pub fn variant<'v>(&'v self, scene: &'v Scene, provenance: &'v str) -> Result<Variant<'v>, Error> {
        let mut document = None;
        if let Some((source, original)) = &self.source {
            let mut changed = source.clone();
            // A variant is at 10 Hz even if its track drives as recorded.
            for id in metadrive::write_changes(&mut changed, scene, original, true, &self.path)? {
                metadrive::update(&mut changed, id);
            }
            metadrive::annotate(&mut changed, PROVENANCE, provenance);
            document = Some(changed);
        }
        Ok(Variant { path: &self.path, scene, provenance, document })
    }
}

/// Data set and version in a file.
fn names(document: &Document) -> [String; 2] {
    let root = document.root();
    let metadata = document.get(root, "metadata");
    let dataset = metadata.and_then(|metadata| document.get(metadata, "dataset"));
    [dataset, document.get(root, "version")].map(|value| {
        value
            .and_then(|value| document.text(value))
            .filter(|text| !text.is_empty())
            .unwrap_or("unknown")
            .to_owned()
    })
}

/// One variant of a recording.
pub struct Variant<'v> {
    path: &'v Path,
    scene: &'v Scene,
    provenance: &'v str,
    /// The values of the pickle; none for a procedural scene.
    document: Option<Document>,
}

impl Variant<'_> {
    /// The file of the variant in a format; `None` if the format has no file for a variant alone.
    ///
    /// *Errors*: as [`Recording::to_native`]; the ego is no vehicle in JSON of GPUDrive.
    pub fn encode(&self, format: Format) -> Result<Option<Vec<u8>>, Error> {
        Ok(Some(match format {
            Format::Pickle => self.to_pickle(),
            Format::Native => self.to_native()?,
            Format::GpuDrive => self.to_gpudrive()?.json,
            Format::TfRecord | Format::OpenScenario | Format::Parquet => return Ok(None),
        }))
    }

    /// The variant as a MetaDrive pickle, with [`PROVENANCE`] in the metadata.
    pub fn to_pickle(&self) -> Vec<u8> {
        match &self.document {
            Some(document) => document.to_pickle(),
            None => {
                let mut document = metadrive::fresh(self.scene);
                metadrive::annotate(&mut document, PROVENANCE, self.provenance);
                document.to_pickle()
            }
        }
    }

    /// The variant as JSON of GPUDrive: simulators drive the adversary's path, and not the ego's.
    ///
    /// *Errors*: the ego is no vehicle.
    pub fn to_gpudrive(&self) -> Result<EncodedGpuDrive, Error> {
        let adversary = self.scene.adversary.map(|track| &self.scene.tracks[track].id[..]);
        let attacker = gpudrive::attacker(self.provenance);
        let attacker = attacker.as_deref().or(adversary);
        match &self.document {
            Some(document) => gpudrive::encode(self.scene, document, attacker, self.path),
            None => {
                let mut document = metadrive::fresh(self.scene);
                metadrive::annotate(&mut document, PROVENANCE, self.provenance);
                gpudrive::encode(self.scene, &document, attacker, self.path)
            }
        }
    }

    /// The variant as a native file. Its provenance is in the metadata of the source, or in the notes if
    /// there is no source.
    ///
    /// *Errors*: as [`Recording::to_native`].
    pub fn to_native(&self) -> Result<Vec<u8>, Error> {
        if self.document.is_some() {
            return native::encode(self.scene, self.document.as_ref(), self.path);
        }
        let mut scene = self.scene.clone();
        scene.notes.retain(|note| !matches!(note, Note::Provenance(_)));
        scene.notes.push(Note::Provenance(self.provenance.to_owned()));
        native::encode(&scene, None, self.path)
    }
}
