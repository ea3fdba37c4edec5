//! The Waymo Open Motion Dataset as Waymo publishes it: TFRecord files of `Scenario` protos.
//!
//! A record becomes the MetaDrive values that ScenarioNet's converter makes of it, widths of lanes included, and goes
//! through the decoder that pickles go through. A scene is then the same, whichever file it came from.
//!
//! [`Shard`] reads a file record by record. `docs/formats.md` lists what is read.

mod decode;
mod encode;
mod message_error;
mod record_path;
mod shard;
mod tfrecord;
mod wire;
mod words;

use std::path::Path;

pub use decode::{DATASET, VERSION};
pub use encode::EncodedScenario;
pub(crate) use encode::encode;
pub use message_error::{MessageError, MessageProblem};
pub use record_path::{is_record_path, shard_of};
pub(crate) use record_path::{numbered, only_record, read_framed, record_paths, split_path};
pub(crate) use shard::{Open, count, is_gzip, is_shard_name, open};
pub use shard::{Shard, is_shard};
pub(crate) use tfrecord::begins_with_record;
pub use tfrecord::{FrameProblem, Record, frame};

use crate::{Error, Recording, dataset, pickle::Document};

/// The MetaDrive values of a record with its frame, without summaries. `path` names it, such as `SHARD#3`.
///
/// *Errors*: [`Error::Shard`] for a wrong checksum, [`Error::Message`] for a record that is no scene.
pub(crate) fn document(path: &Path, framed: &[u8]) -> Result<Document, Error> {
    let data = tfrecord::checked_data(framed).map_err(|problem| Error::Shard {
        path: path.to_owned(),
        record: 0,
        offset: 0,
        problem,
    })?;
    let shard = shard_of(path);
    let source_file = shard.file_name().unwrap_or_default().to_string_lossy();
    decode::decode(data, &source_file).map_err(|problem| Error::Message { path: path.to_owned(), problem })
}

impl Record {
    /// Reads and checks the scene. `path` names the record, such as `SHARD#3`.
    ///
    /// *Errors*: [`Error::Shard`], [`Error::Message`] or [`Error::Field`].
    pub fn read(&self, path: &Path) -> Result<Recording, Error> {
        Recording::of_record(path, &self.framed).map_err(|error| self.located(error))
    }

    /// Id of the scene.
    pub(crate) fn scene_id(&self, path: &Path) -> Result<String, Error> {
        id_of(path, &self.framed).map_err(|error| self.located(error))
    }

    /// The error with the record's number and offset in its shard.
    fn located(&self, error: Error) -> Error {
        match error {
            Error::Shard { path, problem, .. } => {
                let path = shard_of(&path);
                Error::Shard { path, record: self.number, offset: self.offset, problem }
            }
            other => other,
        }
    }
}

/// Id of the scene of a record with its frame, as part of file names: it comes from the content of a file.
///
/// *Errors*: as [`document`].
pub(crate) fn id_of(path: &Path, framed: &[u8]) -> Result<String, Error> {
    let data = tfrecord::checked_data(framed).map_err(|problem| Error::Shard {
        path: path.to_owned(),
        record: 0,
        offset: 0,
        problem,
    })?;
    decode::id(data)
        .map(dataset::plain_name)
        .map_err(|problem| Error::Message { path: path.to_owned(), problem })
}
