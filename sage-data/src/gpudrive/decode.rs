//! Makes MetaDrive values of a file.

use std::{
    collections::{HashMap, HashSet},
    path::Path,
};

use sage_core::{
    motion::{DT, NOW},
    scene::{Note, PROVENANCE},
};

use super::{
    DATASET, Dialect, REST,
    file::{File, Metadata, Name, Object, Own, Road},
    headings::Unit,
    keyed::{Of, Rest},
    lights::{STATES, Signal},
    map_elements,
    names::{ids_of_objects, original, originals},
};
use crate::{
    Error, ReadOptions,
    json::explained,
    metadrive::{ASSUMED_SIZES, SceneValues, Values},
    pickle::{Document, Id},
    repairs::Repair,
};

/// Type of vehicles in a file.
const VEHICLE: &str = "vehicle";
/// Bytes that the states of lights may take, besides four times the size of the file: a light of a few bytes has a state
/// for each frame.
const FREE: usize = 4 << 20;

/// The values of a file, and notes on how it was read.
///
/// *Errors*: [`Error::Json`] for what is no JSON or has other types; [`Error::Field`] for values that contradict each other.
pub(crate) fn document(
    path: &Path,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<(Document, Vec<Note>), Error> {
    let body = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let Of(file) =
        serde_json::from_slice::<Of<File>>(body).map_err(|error| explained::<Of<File>>(path, body, error))?;
    let wrong = |field: &str, found: String, expected: &str| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found,
        expected: expected.to_owned(),
    };
    let objects = file.objects.unwrap_or_default();
    let frames = match objects.first() {
        Some(Of(first)) => first.valid.as_ref().map_or(0, Vec::len),
        None => return Err(wrong("objects", "empty".to_owned(), "at least one road user, the ego")),
    };
    let dialect = if file.metadata.is_some() { Dialect::Present } else { Dialect::Old };
    let own = file.own.unwrap_or_default();
    let Of(metadata) = file.metadata.unwrap_or_default();
    let mut notes = Vec::new();
    let ids = ids_of_objects(&objects, &own);
    let unit = Unit::of(&objects, dialect);
    let reader = Reader { path, frames, dialect, unit, objects: &objects, ids: &ids, rate: options.rate };
    let ego = reader.ego(&metadata, options)?;
    // Numbers take 8 bytes, and at least 5 in the file.
    let mut values = Values::with_capacity(body.len() / 2);
    let mut tracks = Vec::with_capacity(objects.len());
    for (k, Of(object)) in objects.iter().enumerate() {
        tracks.push(reader.track(k, object, &mut values)?);
    }
    let tracks = values.entries(tracks);
    let features = reader.roads(&file.roads.unwrap_or_default(), &own, &mut values, &mut notes)?;
    let signals = file.tl_states.flatten().unwrap_or_default().0;
    if signals.len().saturating_mul(frames) > body.len().saturating_add(FREE / 4) {
        let found = format!("{} lights with {frames} states each", signals.len());
        return Err(wrong("tl_states", found, "as many as a file of this size describes"));
    }
    let originals = originals(&own.roads);
    let mut lights = Vec::with_capacity(signals.len());
    let mut known = HashSet::new();
    for (lane, signal) in &signals {
        if !known.insert(lane) {
            let field = format!("tl_states/{}", lane.escape_debug());
            return Err(wrong(&field, "there twice".to_owned(), "one light for each lane"));
        }
        lights.push(reader.light(lane, signal, &originals, &mut values)?);
    }
    let lights = values.entries(lights);
    let unit = if unit == Unit::Degrees { "degrees" } else { "radians" };
    match dialect {
        Dialect::Old => {
            notes.push(Note::Other(format!("the old dialect of GPUDrive: headings are read in {unit}")))
        }
        Dialect::Present if reader.unit == Unit::Degrees => {
            notes.push(Note::Other(format!(
                "headings beyond a turn, which agree with the motion in degrees: they are read in {unit}"
            )));
        }
        Dialect::Present => {}
    }
    let metadata = reader.metadata(&metadata, &own, ego, &file.rest, &mut values, &mut notes);
    let id = match &file.scenario_id {
        Some(Name(id)) if !id.is_empty() => id.clone(),
        _ => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
    };
    values.set_scene(&id, DATASET, frames, SceneValues { tracks, lights, features, metadata });
    values.document.set_file_size(body.len());
    Ok((values.document, notes))
}

struct Reader<'r> {
    path: &'r Path,
    frames: usize,
    dialect: Dialect,
    unit: Unit,
    objects: &'r [Of<Object<'r>>],
    /// Ids of the objects.
    ids: &'r [String],
    /// Frames per second, if the user says so: the format has no times.
    rate: Option<f64>,
}

impl Reader<'_> {
    fn wrong(&self, field: impl Into<String>, found: String, expected: impl Into<String>) -> Error {
        Error::Field { path: self.path.to_owned(), field: field.into(), found, expected: expected.into() }
    }

    /// Number of the ego.
    fn ego(&self, metadata: &Metadata, options: &ReadOptions) -> Result<usize, Error> {
        let count = self.objects.len();
        if let Some(id) = &options.ego_track {
            let found = self.ids.iter().position(|known| known == id);
            let found = found.filter(|k| self.kind(*k) == VEHICLE);
            return found.ok_or_else(|| {
                let found = format!("without a vehicle `{}`", id.escape_debug());
                self.wrong("objects", found, "the id of a vehicle with --ego-track")
            });
        }
        let remedy = "name the ego by its id with --ego-track";
        let field = "metadata/sdc_track_index";
        let index = match metadata.sdc_track_index {
            Some(index) => index,
            None if self.dialect == Dialect::Old => {
                let has_ids = self.objects.iter().any(|Of(object)| object.id.is_some());
                let name = if has_ids { "id" } else { "number in `objects`" };
                let expected = format!(
                    "the ego; this is the old dialect, which names none: give its {name} with --ego-track"
                );
                return Err(self.wrong("metadata", "missing".to_owned(), expected));
            }
            None => {
                return Err(self.wrong(
                    field,
                    "missing".to_owned(),
                    format!("the number of the ego; {remedy}"),
                ));
            }
        };
        let Some(k) = usize::try_from(index).ok().filter(|k| *k < count) else {
            let expected = format!(
                "the number of one of {count} objects; some converters count road users that they leave out: {remedy}"
            );
            return Err(self.wrong(field, index.to_string(), expected));
        };
        let Of(object) = &self.objects[k];
        let kind = self.kind(k);
        let is_there = object.valid.as_ref().and_then(|valid| valid.get(NOW)).is_some_and(|flag| flag.0);
        if kind != VEHICLE || (!is_there && options.now.is_none()) {
            let found = match kind {
                VEHICLE => format!("{index}, a vehicle that is absent at frame {NOW}"),
                kind => format!("{index}, a road user of type `{}`", kind.escape_debug()),
            };
            let expected = format!(
                "a vehicle that is there at that frame; some converters count road users that they leave out: {remedy}"
            );
            return Err(self.wrong(field, found, expected));
        }
        Ok(k)
    }

    /// What a road user is.
    fn kind(&self, k: usize) -> &str {
        self.objects[k].0.kind.as_ref().map_or("", |kind| &kind.0)
    }

    fn track(&self, k: usize, object: &Object, values: &mut Values) -> Result<(Id, Id), Error> {
        let frames = self.frames;
        let Object { position, velocity, heading, valid, .. } = object;
        let lengths = [
            ("position", position.as_ref().map_or(0, Vec::len)),
            ("velocity", velocity.as_ref().map_or(0, Vec::len)),
            ("heading", heading.as_ref().map_or(0, Vec::len)),
            ("valid", valid.as_ref().map_or(0, Vec::len)),
        ];
        if let Some((key, found)) = lengths.into_iter().find(|(_, length)| *length != frames) {
            let expected = format!("{frames}, one for each frame as in the first object's `valid`");
            return Err(self.wrong(format!("objects/{k}/{key}"), format!("{found} entries"), expected));
        }
        let [position, velocity] = [position, velocity].map(|column| column.as_deref().unwrap_or_default());
        let heading = heading.as_deref().unwrap_or_default();
        let valid: Vec<u8> = valid.iter().flatten().map(|flag| u8::from(flag.0)).collect();
        let is_there = |frame: &usize| valid[*frame] == 1;
        let (mut places, mut speeds, mut headings) =
            (vec![0.0; 3 * frames], vec![0.0; 2 * frames], vec![0.0; frames]);
        // Absent frames hold a number that is far from the scene; here they hold zeros.
        for frame in (0..frames).filter(is_there) {
            places[3 * frame..][..3].copy_from_slice(&position[frame].0);
            speeds[2 * frame..][..2].copy_from_slice(&velocity[frame].0[..2]);
            headings[frame] = match self.unit {
                Unit::Radians => heading[frame],
                Unit::Degrees => heading[frame].to_radians(),
            };
        }
        let mut state = vec![
            (values.word("position"), values.doubles(&[frames, 3], &places)),
            (values.word("velocity"), values.doubles(&[frames, 2], &speeds)),
            (values.word("heading"), values.doubles(&[frames], &headings)),
            (values.word("valid"), values.bools(&valid)),
        ];
        let has_size = object.size[..2] != [Some(0.0); 2];
        for (key, size) in ["length", "width", "height"].into_iter().zip(object.size) {
            // Some writers take the size of the last frame, 0 if the road user is not there then.
            if let Some(size) = size.filter(|_| has_size) {
                state.push((values.word(key), values.float(size)));
            }
        }
        let state = values.entries(state);
        let kind = match self.kind(k) {
            VEHICLE => values.word("VEHICLE"),
            "pedestrian" => values.word("PEDESTRIAN"),
            "cyclist" => values.word("CYCLIST"),
            "unset" => values.word("UNSET"),
            "other" => values.word("OTHER"),
            other => values.text(&other.to_ascii_uppercase()),
        };
        let (name, length, dataset) =
            (values.text(&self.ids[k]), values.int(frames as i64), values.word(DATASET));
        let mut metadata = vec![
            (values.word("track_length"), length),
            (values.word("type"), kind),
            (values.word("object_id"), name),
            (values.word("dataset"), dataset),
        ];
        metadata.extend(kept(&object.rest, values));
        let metadata = values.entries(metadata);
        let track = values.dict([("type", kind), ("state", state), ("metadata", metadata)]);
        Ok((name, track))
    }

    fn roads(
        &self,
        roads: &[Of<Road>],
        own: &Own,
        values: &mut Values,
        notes: &mut Vec<Note>,
    ) -> Result<Id, Error> {
        let originals = originals(&own.roads);
        let mut features = Vec::with_capacity(roads.len());
        let mut known_ids = HashSet::with_capacity(roads.len());
        let (mut odd, mut renamed) = (0, 0);
        for (k, Of(road)) in roads.iter().enumerate() {
            let name = road.kind.as_ref().map_or("", |kind| &kind.0);
            let known = map_elements::read(name, road.map_element_id.map(|id| id.0));
            odd += usize::from(known.is_none_or(|(.., is_odd)| is_odd));
            let (kind, key) = match known {
                Some((word, key, _)) => (values.word(word), key),
                None => (values.text(&name.to_ascii_uppercase()), "polyline"),
            };
            let geometry = road.geometry.as_deref().unwrap_or_default();
            let points: Vec<f64> = geometry.iter().flat_map(|point| point.0).collect();
            let shape = match (key, geometry) {
                ("position", [_]) => values.doubles(&[3], &points),
                ("position", _) => {
                    let found = format!("{} points", geometry.len());
                    return Err(self.wrong(
                        format!("roads/{k}/geometry"),
                        found,
                        "one, the place of the sign",
                    ));
                }
                _ => values.doubles(&[geometry.len(), 3], &points),
            };
            let mut feature = vec![(values.word("type"), kind), (values.word(key), shape)];
            feature.extend(kept(&road.rest, values));
            let feature = values.entries(feature);
            let mut id = road.id.as_ref().map_or_else(|| k.to_string(), |id| original(id, &originals));
            // Some converters number what has no integer as id, so that a number may be that of another road.
            if !known_ids.insert(id.clone()) {
                id = format!("{id}-road-{k}");
                renamed += 1;
                known_ids.insert(id.clone());
            }
            features.push((values.text(&id), feature));
        }
        if odd > 0 {
            let text =
                format!("{odd} roads have a `type` or `map_element_id` that the format does not define");
            notes.push(Repair::MapValues.note(text));
        }
        if renamed > 0 {
            notes.push(Note::Other(format!(
                "{renamed} roads have the id of another road; they get one of their own"
            )));
        }
        Ok(values.entries(features))
    }

    /// A light; `originals` are the ids of lanes by the numbers that took their place.
    fn light(
        &self,
        lane: &str,
        signal: &Signal,
        originals: &HashMap<i64, &String>,
        values: &mut Values,
    ) -> Result<(Id, Id), Error> {
        let states = signal.state.as_deref().unwrap_or_default();
        let times = signal.time_index.as_deref().unwrap_or_default();
        let field = |key: &str| format!("tl_states/{}/{key}", lane.escape_debug());
        if states.len() != times.len() {
            let found = format!("{} entries", states.len());
            return Err(self.wrong(field("state"), found, format!("{}, as in `time_index`", times.len())));
        }
        let mut all = vec![values.none(); self.frames];
        for (state, time) in states.iter().zip(times) {
            let slot = usize::try_from(*time).ok().and_then(|time| all.get_mut(time)).ok_or_else(|| {
                self.wrong(field("time_index"), time.to_string(), format!("a frame below {}", self.frames))
            })?;
            *slot = values.word(STATES[usize::from(state.0)].1);
        }
        for (key, axis) in ["x", "y", "z"].into_iter().zip(&signal.stop) {
            let length = axis.as_ref().map_or(0, Vec::len);
            if length != 0 && length != times.len() {
                let found = format!("{length} entries");
                return Err(self.wrong(field(key), found, format!("{}, as in `time_index`", times.len())));
            }
        }
        // The last stop point holds for all frames, as in Waymo's records. Some files have no heights.
        let [x, y, z] = [0, 1, 2].map(|axis: usize| signal.stop[axis].as_ref()?.last().copied());
        let stop = x.zip(y).map(|(x, y)| [x, y, z.unwrap_or(0.0)]);
        let lane = &original(&Name(lane.to_owned()), originals)[..];
        let kind = values.word("TRAFFIC_LIGHT");
        let all = values.list(all);
        let state = values.dict([("object_state", all)]);
        let (name, length) = (values.text(lane), values.int(self.frames as i64));
        let dataset = values.word(DATASET);
        let metadata = values.dict([
            ("track_length", length),
            ("type", kind),
            ("object_id", name),
            ("dataset", dataset),
        ]);
        let mut light =
            vec![(values.word("type"), kind), (values.word("state"), state), (values.word("lane"), name)];
        if let Some(stop) = stop {
            light.push((values.word("stop_point"), values.doubles(&[3], &stop)));
        }
        light.push((values.word("metadata"), metadata));
        let light = values.entries(light);
        Ok((name, light))
    }

    fn metadata(
        &self,
        metadata: &Metadata,
        own: &Own,
        ego: usize,
        rest: &Rest,
        values: &mut Values,
        notes: &mut Vec<Note>,
    ) -> Id {
        let step = self.rate.map_or(DT, |rate| 1.0 / rate);
        let times: Vec<f64> = (0..self.frames).map(|frame| frame as f64 * step).collect();
        let seconds = values.doubles(&[self.frames], &times);
        let originals = originals(&own.objects);
        let interest = metadata.objects_of_interest.iter().flatten();
        let interest: Vec<Id> = interest
            .map(|name| {
                let id = original(name, &originals);
                values.text(&id)
            })
            .collect();
        let interest = values.list(interest);
        let mut predictions = Vec::new();
        let (mut beyond, mut known) = (0, HashSet::new());
        for one in metadata.tracks_to_predict.iter().flatten() {
            let Some(id) = usize::try_from(one.track_index).ok().and_then(|k| self.ids.get(k)) else {
                beyond += 1;
                continue;
            };
            if !known.insert(id) {
                continue;
            }
            let name = values.text(id);
            let (index, difficulty) = (values.int(one.track_index), values.int(one.difficulty));
            let entry = values.dict([("track_index", index), ("track_id", name), ("difficulty", difficulty)]);
            predictions.push((name, entry));
        }
        if beyond > 0 {
            notes.push(Note::Other(format!(
                "{beyond} of `tracks_to_predict` are no objects; they are left out"
            )));
        }
        let predictions = values.entries(predictions);
        let dataset = match &own.dataset {
            Some(dataset) => values.text(dataset),
            None => values.word(DATASET),
        };
        let (ego_id, ego_index) = (values.text(&self.ids[ego]), values.int(ego as i64));
        let (length, now) = (values.int(self.frames as i64), values.int(NOW as i64));
        let coordinate = values.word("waymo");
        let processed = values.bool(false);
        let mut entries = vec![
            (values.word("coordinate"), coordinate),
            (values.word("ts"), seconds),
            (values.word("metadrive_processed"), processed),
            (values.word("sdc_id"), ego_id),
            (values.word("dataset"), dataset),
            (values.word("track_length"), length),
            (values.word("current_time_index"), now),
            (values.word("sdc_track_index"), ego_index),
            (values.word("objects_of_interest"), interest),
            (values.word("tracks_to_predict"), predictions),
        ];
        if let Some(sizes) = &own.assumed_sizes {
            entries.push((values.word(ASSUMED_SIZES), values.text(sizes)));
        }
        if let Some(provenance) = &own.provenance {
            entries.push((values.word(PROVENANCE), values.text(provenance)));
        }
        entries.extend(kept(rest, values));
        if let Some((_, inner)) = kept(&metadata.rest, values) {
            entries.push((values.word(REST_OF_METADATA), inner));
        }
        values.entries(entries)
    }
}

/// Key of MetaDrive values for what the metadata of a file say besides.
pub(super) const REST_OF_METADATA: &str = "gpudrive_metadata";

/// An entry for what an object of a file holds besides, if it does.
fn kept(rest: &Rest, values: &mut Values) -> Option<(Id, Id)> {
    if rest.is_empty() {
        return None;
    }
    let entries = rest.iter().map(|(key, value)| (values.text(key), values.text(value.get()))).collect();
    let dict = values.entries(entries);
    Some((values.word(REST), dict))
}
