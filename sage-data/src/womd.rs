//! The Waymo Open Motion Dataset as Waymo publishes it: TFRecord files of `Scenario` protos.
//!
//! A record becomes the MetaDrive values that ScenarioNet's converter makes of it, widths of lanes included, and goes through
//! the decoder that pickles go through. A scene is then the same, whichever file it came from, and a record can be written as a
//! pickle.
//!
//! [`ShardReader`] reads a file record by record. `docs/formats.md` lists what a conversion loses.
//!
//! # From a record to a scene
//!
//! | field of `Scenario` | becomes |
//! | --- | --- |
//! | `scenario_id` | `id`, `metadata.scenario_id`, name of output files |
//! | `timestamps_seconds` | `metadata.ts`, 32-bit |
//! | `tracks`: `id`, `object_type`, `states` | a track per id (text), 32-bit. Missing states are not valid |
//! | `sdc_track_index` | the ego |
//! | `objects_of_interest`, `tracks_to_predict`, `current_time_index` | the same in `metadata`; *now* is always frame 10 |
//! | `dynamic_map_states` | a light per lane, in order of appearance; the last stop point holds for all frames |
//! | `map_features` | a feature per id |
//! | `lane.speed_limit_mph` | also `speed_limit_kmh`, × 1.609344 |
//! | `lane.left_boundaries`, `right_boundaries` | also `width`, as in ScenarioNet; some are nonsense (over 10 m) |
//! | 7001, 7002, of `sage` alone | data set, if not Waymo's; `sage_provenance` |
//!
//! `version` is `womd`, `dataset` is `waymo` without field 7001, `source_file` is the name of the TFRecord file.
//!
//! Required of a record: 11 to 40 000 frames, finite numbers within ±10⁸, enum values of the schema and not `UNSET` as type of a
//! track, unique ids of tracks, `sdc_track_index` and each `track_index` of a track, indices of boundaries within their lane,
//! polylines and polygons of at least one point, length and width of a track above 0 on valid frames. A known field of another
//! wire type is an error, unknown fields are skipped.
//!
//! Not kept, in any format: `compressed_frame_laser_data`, `frame_camera_tokens`, unknown fields, features of no kind, states and
//! lights after the last frame, the order of lights within a frame, order and packing of fields, explicit zeros.

mod decode;
mod encode;
mod message_error;
mod open_shard;
mod record_path;
mod shard;
mod tfrecord;
mod wire;
mod words;

use std::path::{Path, PathBuf};

pub use decode::{DATASET, VERSION};
pub(crate) use encode::encode;
pub use encode::{EncodedScenario, Notes};
pub(crate) use encode::{Ids, note, unknown_edges};
pub use message_error::{MessageError, MessageProblem};
pub use record_path::{is_record_path, shard_of};
pub(crate) use record_path::{numbered, only_record, read_framed, record_paths, split_path};
pub(crate) use shard::{Open, count, is_shard_name, open};
pub use shard::{ShardReader, is_shard};
pub use tfrecord::{FrameProblem, Record, frame, write_frame};
pub(crate) use tfrecord::{MAX_RECORD, begins_with_record};
pub(crate) use words::{LANE_TYPES, ROAD_LINE_TYPES};

use crate::{Error, names, pickle::Document};

/// The MetaDrive values of a `Scenario` message, without summaries, and whether it has an id. `path` names it in errors,
/// such as `SHARD#3`.
///
/// *Errors*: [`Error::Message`] for a message that is no scene.
pub(crate) fn document(path: &Path, message: &[u8]) -> Result<(Document, bool), Error> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let shard = name.rsplit_once('#').filter(|_| is_record_path(path)).map(|(shard, _)| shard);
    let source_file = shard.unwrap_or(&name);
    let decoded = decode::decode(message, source_file, &unnamed(path));
    decoded.map_err(|problem| Error::Message { path: path.to_owned(), problem })
}

/// Id of a record that has none: its number, `record-3` for `SHARD#3`.
fn unnamed(path: &Path) -> String {
    let number = path.to_str().and_then(|path| path.rsplit_once('#')).map(|(_, number)| number);
    let number = number.filter(|number| number.bytes().all(|byte| byte.is_ascii_digit()));
    number.map_or_else(|| "record".to_owned(), |number| format!("record-{number}"))
}

/// Name of the scene of a record with its frame, for file names, and its data set.
///
/// *Errors*: as [`message`] and [`document`].
pub(crate) fn heading_of(path: &Path, framed: &[u8]) -> Result<SceneHeading, Error> {
    let heading = decode::heading(message(path, framed)?);
    let heading = heading.map_err(|problem| Error::Message { path: path.to_owned(), problem })?;
    let name = if heading.id.is_empty() { unnamed(path) } else { names::plain_name(heading.id) };
    Ok(SceneHeading { name, dataset: heading.dataset.to_owned() })
}

/// Name and data set of a scene that is not decoded.
pub struct SceneHeading {
    /// Its id, as part of file names.
    pub name: String,
    /// The data set that its MetaDrive values name.
    pub dataset: String,
}

/// The message of a record with its frame, whose place in a shard is not known.
///
/// *Errors*: [`Error::Shard`] for a wrong checksum.
pub(crate) fn message<'r>(path: &Path, framed: &'r [u8]) -> Result<&'r [u8], Error> {
    tfrecord::checked_data(framed).map_err(|problem| Error::Shard {
        path: path.to_owned(),
        record: 0,
        offset: 0,
        problem,
    })
}

impl Record {
    /// Path of the record, such as `SHARD#3`.
    pub fn path(&self) -> PathBuf {
        record_path::record_path(&self.shard, self.number)
    }

    /// Name and data set of the scene, which is not decoded.
    ///
    /// *Errors*: [`Error::Shard`] or [`Error::Message`].
    pub fn heading(&self) -> Result<SceneHeading, Error> {
        heading_of(&self.path(), &self.framed).map_err(|error| self.located(error))
    }

    /// The error with the record's number and offset in its shard.
    pub(crate) fn located(&self, error: Error) -> Error {
        match error {
            Error::Shard { problem, .. } => {
                let path = self.shard.clone();
                Error::Shard { path, record: self.number, offset: self.offset, problem }
            }
            other => other,
        }
    }
}
