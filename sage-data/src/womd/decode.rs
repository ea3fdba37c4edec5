//! Decodes a `Scenario` message into the MetaDrive values that ScenarioNet's converter makes of it.
//!
//! The fields are those of `waymo.open_dataset.Scenario`. Fields that scenes do not use, such as lidar, are skipped.

mod budget;
mod features;
mod foreign;
mod lanes;
mod lights;
mod points;
mod tracks;
mod width;

use sage_core::{
    motion::{HISTORY, MAX_COORDINATE},
    scene::PROVENANCE,
};

use super::{
    message_error::{MessageError, MessageProblem, Place},
    wire::{Field, Message},
    words::{DIFFICULTIES, OBJECT_TYPES},
};
use crate::{
    metadrive::{MAX_FRAMES, SceneValues, Values},
    pickle::{Document, Id},
};
use budget::{Budget, DICT, ENTRY};

/// Name of the data set in MetaDrive values and names of files.
pub const DATASET: &str = "waymo";
/// Its version there; records do not tell the true one.
pub const VERSION: &str = "womd";

/// Fields that this project adds to records, which other readers skip as unknown: the data set of a scene that is not
/// Waymo's, and how a scene was made.
pub(super) const FIELD_DATASET: u32 = 7001;
pub(super) const FIELD_PROVENANCE: u32 = 7002;

/// A `Scenario` whose parts are not decoded yet.
struct Scenario<'r> {
    id: &'r str,
    dataset: &'r str,
    /// How the scene was made, if this project made it.
    provenance: Option<&'r str>,
    /// Size of the record, bytes.
    record_size: usize,
    timestamps: Vec<f32>,
    tracks: Vec<Message<'r>>,
    steps: Vec<Message<'r>>,
    features: Vec<Message<'r>>,
    predictions: Vec<Message<'r>>,
    objects_of_interest: Vec<i64>,
    sdc_track_index: Option<(i32, usize)>,
    current_time_index: i32,
}

/// The values of a record, as in a MetaDrive file without summaries, and whether it has an id. `source_file` is the name
/// of the shard, `unnamed` the id of a record without one.
///
/// *Errors*: [`MessageError`] with the offset, the field, the value found and the value expected.
pub(super) fn decode(
    record: &[u8],
    source_file: &str,
    unnamed: &str,
) -> Result<(Document, bool), MessageError> {
    let mut budget = Budget::of(record.len());
    let mut scenario = scenario(record, &mut budget)?;
    let has_id = !scenario.id.is_empty();
    if !has_id {
        scenario.id = unnamed;
    }
    let frames = scenario.timestamps.len();
    // Points take 12 of their 29 bytes, and lanes their widths besides; states 37 of 59.
    let mut values = Values::with_capacity(record.len() / 8 * 5);
    let tracks = tracks::decode(&scenario, &mut values, &mut budget)?;
    let lights = lights::decode(&scenario, &mut values, &mut budget)?;
    let features = features::decode(&scenario, &mut values, &mut budget)?;
    let metadata = metadata(&scenario, &tracks, source_file, &mut values)?;
    let entries = tracks.iter().map(|track| (track.name, track.value)).collect();
    let tracks = values.entries(entries);
    values.set_scene(scenario.id, VERSION, frames, SceneValues { tracks, lights, features, metadata });
    values.document.set_file_size(record.len());
    Ok((values.document, has_id))
}

/// What a record says of itself before it is decoded.
pub(super) struct Heading<'r> {
    pub(super) id: &'r str,
    pub(super) dataset: &'r str,
}

/// The id and the data set of a record; the id may be empty. The rest is not decoded.
///
/// *Errors*: a record that is no `Scenario`.
pub(super) fn heading(record: &[u8]) -> Result<Heading<'_>, MessageError> {
    let root = Place::ROOT;
    if record.is_empty() {
        return Err(MessageError::at(0, &root, MessageProblem::Empty));
    }
    let mut found = Heading { id: "", dataset: DATASET };
    let mut fields = Message { bytes: record, offset: 0 }.fields();
    while let Some(field) = fields.next(&root).map_err(|error| foreign::explained(record, error))? {
        match field.number {
            5 => found.id = field.text(&root.field("scenario_id"))?,
            FIELD_DATASET => found.dataset = field.text(&root.field("sage_dataset"))?,
            _ => {}
        }
    }
    Ok(found)
}

/// The fields of the outermost message.
fn scenario<'r>(record: &'r [u8], budget: &mut Budget) -> Result<Scenario<'r>, MessageError> {
    let root = Place::ROOT;
    if record.is_empty() {
        return Err(MessageError::at(0, &root, MessageProblem::Empty));
    }
    let mut found = Scenario {
        id: "",
        dataset: DATASET,
        provenance: None,
        record_size: record.len(),
        timestamps: Vec::new(),
        tracks: Vec::new(),
        steps: Vec::new(),
        features: Vec::new(),
        predictions: Vec::new(),
        objects_of_interest: Vec::new(),
        sdc_track_index: None,
        current_time_index: 0,
    };
    let mut fields = Message { bytes: record, offset: 0 }.fields();
    loop {
        let field = fields.next(&root).and_then(|field| match field {
            Some(field) => add(&mut found, field, budget).map(|()| true),
            None => Ok(false),
        });
        match field {
            Ok(true) => {}
            Ok(false) => break,
            // Before the first track, another message is the likeliest cause.
            Err(error) if found.tracks.is_empty() => return Err(foreign::explained(record, error)),
            Err(error) => return Err(error),
        }
    }
    if found.timestamps.is_empty() && found.tracks.is_empty() {
        return Err(foreign::refused(record, "it has neither timestamps nor tracks"));
    }
    let frames = found.timestamps.len();
    if !(HISTORY..=MAX_FRAMES).contains(&frames) {
        let place = root.field("timestamps_seconds");
        let expected = format!("{HISTORY} to {MAX_FRAMES} frames");
        return Err(MessageError::value(0, &place, format!("a list of {frames} frames"), expected));
    }
    Ok(found)
}

/// Adds a field of the outermost message.
fn add<'r>(found: &mut Scenario<'r>, field: Field<'r>, budget: &mut Budget) -> Result<(), MessageError> {
    /// Memory of an element: the message, its dicts, and its name.
    const TRACK: usize = 400;
    const FEATURE: usize = 200;
    const OTHER: usize = 150;
    /// Limit of a time, seconds: beyond any clock.
    const MAX_SECONDS: f64 = 1e15;
    let root = Place::ROOT;
    let mut message = |name: &'static str, list: &mut Vec<Message<'r>>, bytes: usize| {
        let place = root.item(name, list.len());
        list.push(field.message(&place)?);
        budget.spend(bytes, field.offset, &place, name)
    };
    match field.number {
        1 => {
            let place = root.field("timestamps_seconds");
            field.doubles(&place, |offset, seconds| {
                if !(seconds.abs() <= MAX_SECONDS) {
                    let expected = format!("a finite number of seconds within ±{MAX_SECONDS:e}");
                    return Err(MessageError::value(offset, &place, seconds, expected));
                }
                found.timestamps.push(seconds as f32);
                budget.spend(size_of::<f32>() + size_of::<f64>(), offset, &place, "frames")
            })
        }
        2 => message("tracks", &mut found.tracks, TRACK),
        4 => field.integers(&root.field("objects_of_interest"), |id| {
            found.objects_of_interest.push(id);
            budget.spend(64, field.offset, &root.field("objects_of_interest"), "objects_of_interest")
        }),
        5 => {
            let place = root.field("scenario_id");
            found.id = field.text(&place)?;
            budget.spend(found.id.len(), field.offset, &place, "text")
        }
        6 => {
            let place = root.field("sdc_track_index");
            found.sdc_track_index = Some((field.int32(&place)?, field.offset));
            Ok(())
        }
        7 => message("dynamic_map_states", &mut found.steps, size_of::<Message>()),
        8 => message("map_features", &mut found.features, FEATURE),
        10 => {
            found.current_time_index = field.int32(&root.field("current_time_index"))?;
            Ok(())
        }
        FIELD_DATASET | FIELD_PROVENANCE => {
            let place =
                root.field(if field.number == FIELD_DATASET { "sage_dataset" } else { "sage_provenance" });
            let text = field.text(&place)?;
            match field.number {
                FIELD_DATASET => found.dataset = text,
                _ => found.provenance = Some(text),
            }
            budget.spend(text.len(), field.offset, &place, "text")
        }
        11 => message("tracks_to_predict", &mut found.predictions, OTHER + DICT + 4 * ENTRY),
        _ => Ok(()),
    }
}

/// A track in the document.
struct TrackEntry {
    /// Its id as a str.
    name: Id,
    kind: Id,
    value: Id,
}

fn metadata(
    scenario: &Scenario,
    tracks: &[TrackEntry],
    source_file: &str,
    values: &mut Values,
) -> Result<Id, MessageError> {
    let root = Place::ROOT;
    let (index, offset) = scenario.sdc_track_index.unwrap_or((0, 0));
    let ego = usize::try_from(index).ok().and_then(|index| tracks.get(index)).ok_or_else(|| {
        let place = root.field("sdc_track_index");
        MessageError::value(offset, &place, index, format!("the index of one of {} tracks", tracks.len()))
    })?;
    let predictions = predictions(scenario, tracks, values)?;
    let interest = scenario.objects_of_interest.iter().map(|id| values.decimal(*id)).collect();
    let interest = values.list(interest);
    let frames = scenario.timestamps.len();
    let seconds = values.floats(&[frames], &scenario.timestamps);
    let (id, file) = (values.text(scenario.id), values.text(source_file));
    let (coordinate, dataset) = (values.word(DATASET), values.text(scenario.dataset));
    let [length, now, index] =
        [frames as i64, scenario.current_time_index.into(), index.into()].map(|value| values.int(value));
    let processed = values.bool(false);
    let metadata = values.dict([
        ("id", id),
        ("coordinate", coordinate),
        ("ts", seconds),
        ("metadrive_processed", processed),
        ("sdc_id", ego.name),
        ("dataset", dataset),
        ("scenario_id", id),
        ("source_file", file),
        ("track_length", length),
        ("current_time_index", now),
        ("sdc_track_index", index),
        ("objects_of_interest", interest),
        ("tracks_to_predict", predictions),
    ]);
    if let Some(provenance) = scenario.provenance {
        let provenance = values.text(provenance);
        values.document.set(metadata, PROVENANCE, provenance);
    }
    Ok(metadata)
}

/// `tracks_to_predict`: by id, the later of two with the same id at the place of the earlier.
fn predictions(scenario: &Scenario, tracks: &[TrackEntry], values: &mut Values) -> Result<Id, MessageError> {
    let root = Place::ROOT;
    let mut entries: Vec<(Id, Id)> = Vec::with_capacity(scenario.predictions.len());
    // Number of the entry of each track, from 1; 0 for none.
    let mut at = vec![0; tracks.len()];
    for (k, message) in scenario.predictions.iter().enumerate() {
        let place = root.item("tracks_to_predict", k);
        let (mut index, mut offset, mut difficulty) = (0, message.offset, 0);
        let mut fields = message.fields();
        while let Some(field) = fields.next(&place)? {
            match field.number {
                1 => (index, offset) = (field.int32(&place.field("track_index"))?, field.offset),
                2 => {
                    let place = place.field("difficulty");
                    field.word(&DIFFICULTIES, &place)?;
                    difficulty = field.int32(&place)?;
                }
                _ => {}
            }
        }
        let found = usize::try_from(index).ok().and_then(|index| Some((index, tracks.get(index)?)));
        let (number, track) = found.ok_or_else(|| {
            let expected = format!("the index of one of {} tracks", tracks.len());
            MessageError::value(offset, &place.field("track_index"), index, expected)
        })?;
        let [index, difficulty] = [index, difficulty].map(|value| values.int(value.into()));
        let entry = values.dict([
            ("track_index", index),
            ("track_id", track.name),
            ("difficulty", difficulty),
            ("object_type", track.kind),
        ]);
        match at[number] {
            0 => {
                entries.push((track.name, entry));
                at[number] = entries.len();
            }
            earlier => entries[earlier - 1].1 = entry,
        }
    }
    Ok(values.entries(entries))
}

/// Checks a number of a record.
///
/// *Errors*: a number that is not finite or not within ±[`MAX_COORDINATE`].
#[inline]
fn checked(value: f64, field: &Field, place: &Place, name: &'static str) -> Result<f64, MessageError> {
    if value.abs() <= MAX_COORDINATE {
        return Ok(value);
    }
    let expected = format!("a finite number within ±{MAX_COORDINATE:e}");
    // In full, a number may have 300 digits.
    let found = if value.abs() < 1e16 { value.to_string() } else { format!("{value:e}") };
    Err(MessageError::value(field.offset, &place.field(name), found, expected))
}

/// The word of a known track type.
fn object_type(field: &Field, place: &Place) -> Result<&'static str, MessageError> {
    let place = place.field("object_type");
    let word = field.word(&OBJECT_TYPES, &place)?;
    if word == OBJECT_TYPES[0] {
        return Err(MessageError::value(field.offset, &place, "0 (TYPE_UNSET)", "1 to 4"));
    }
    Ok(word)
}
