//! Encodes a scene as a `Scenario` message, with the fields in the order in which Waymo's files have them.
//!
//! Numbers are those of the scene. What a scene does not model (types of lights, interpolated lanes, difficulties) comes
//! from its MetaDrive values.

mod ids;
mod map;
mod message;

use std::collections::{BTreeMap, HashMap};

use sage_core::{
    motion::{DT, NOW},
    scene::PROVENANCE,
    scene::{LightState, Scene, Track},
};
use serde_json::{Value, json};

use super::{
    decode::{DATASET, FIELD_DATASET, FIELD_PROVENANCE},
    words::{OBJECT_TYPES, SIGNAL_STATES},
};
use crate::pickle::{Document, Id, Node};
pub(crate) use ids::Ids;
pub(crate) use map::unknown_edges;
use message::Writer;

/// A scene as the data of a record.
pub struct EncodedScenario {
    /// The `Scenario` message.
    pub data: Vec<u8>,
    /// Ids by number, if the ids of tracks or features are texts; `None` if all kept their values.
    pub ids: Option<Value>,
    /// What could not be kept, and how often.
    pub notes: Notes,
}

/// What could not be kept, and how often.
pub type Notes = BTreeMap<String, usize>;

/// Counts one more of what could not be kept.
pub(crate) fn note(notes: &mut Notes, what: impl Into<String>) {
    *notes.entry(what.into()).or_default() += 1;
}

/// Encodes a scene and its MetaDrive values, which list tracks, features and lights in the same order.
///
/// `id` replaces the id of the scene, which variants of one scene share.
pub(crate) fn encode(scene: &Scene, document: &Document, id: Option<&str>) -> EncodedScenario {
    let (tracks, features) = (Ids::of_tracks(scene), Ids::of_features(scene));
    let mut notes = Notes::default();
    let metadata = document.get(document.root(), "metadata");
    let get = |key: &str| metadata.and_then(|metadata| document.get(metadata, key));
    let mut out = Writer(Vec::with_capacity(4 * document.file_size().max(1 << 14)));
    for frame in 0..scene.frames {
        let seconds = scene.timestamps.get(frame).copied().unwrap_or(frame as f64 * DT);
        out.double(1, seconds);
    }
    for track in &scene.tracks {
        out.message(2, |out| write_track(out, track, &tracks, &mut notes));
    }
    let index: HashMap<&str, usize> =
        scene.tracks.iter().enumerate().map(|(k, track)| (&track.id[..], k)).collect();
    let interest = get("objects_of_interest").and_then(|list| document.items(list)).unwrap_or_default();
    for id in interest {
        let id = document.identifier(*id).filter(|id| index.contains_key(&id[..]));
        match id.and_then(|id| tracks.get(&id)) {
            Some(id) => out.integer(4, id),
            None => note(&mut notes, "objects of interest that are no tracks"),
        }
    }
    let own =
        || get("scenario_id").and_then(|id| document.identifier(id)).unwrap_or_else(|| scene.id.clone());
    let id = id.map_or_else(own, str::to_owned);
    out.bytes(5, id.as_bytes());
    out.integer(6, scene.ego as i64);
    write_lights(&mut out, scene, document, &features, &mut notes);
    map::write(&mut out, scene, document, &features, &mut notes);
    let now = get("current_time_index").and_then(|now| document.integer(now));
    out.integer(10, now.filter(|now| i32::try_from(*now).is_ok()).unwrap_or(NOW as i64));
    write_predictions(&mut out, &index, document, get("tracks_to_predict"), &mut notes);
    let text = |key: &str| get(key).and_then(|value| document.text(value));
    // Without it, readers take the scene for Waymo's.
    if let Some(dataset) = text("dataset").filter(|dataset| *dataset != DATASET) {
        out.bytes(FIELD_DATASET, dataset.as_bytes());
    }
    if let Some(provenance) = text(PROVENANCE) {
        out.bytes(FIELD_PROVENANCE, provenance.as_bytes());
    }
    let tables = json!({"tracks": table(&tracks), "map_features": table(&features)});
    let is_numbered = tables.as_object().is_some_and(|tables| tables.values().any(|table| !table.is_null()));
    if is_numbered {
        note(&mut notes, "scenes with ids that are no integers, which `ids.json` lists by their numbers");
    }
    EncodedScenario { data: out.0, ids: is_numbered.then_some(tables), notes }
}

fn table(ids: &Ids) -> Value {
    let table = ids.table();
    if table.is_empty() {
        return Value::Null;
    }
    table.into_iter().map(|(number, id)| (number.to_string(), Value::String(id))).collect()
}

fn write_track(out: &mut Writer, track: &Track, ids: &Ids, notes: &mut Notes) {
    out.integer(1, ids.get(&track.id).unwrap_or(0));
    let kind = OBJECT_TYPES.iter().skip(1).position(|word| *word == track.kind.name());
    if kind.is_none() {
        note(notes, format!("tracks of type {}, written as OTHER", track.kind.name()));
    }
    out.integer(2, kind.map_or(OBJECT_TYPES.len() - 1, |kind| kind + 1) as i64);
    for frame in 0..track.valid.len() {
        out.message(3, |out| write_state(out, track, frame));
    }
}

/// A state. One that is not valid and holds nothing but a height is short, as in Waymo's files.
fn write_state(out: &mut Writer, track: &Track, frame: usize) {
    let ([x, y, z], [length, width, height]) = (track.position[frame], track.size[frame]);
    let ([vx, vy], heading) = (track.velocity[frame], track.heading[frame]);
    let is_short = !track.valid[frame]
        && [x, y, length, width, height, heading, vx, vy].iter().all(|value| *value == 0.0);
    if is_short {
        out.double(4, z);
    } else {
        out.double(2, x);
        out.double(3, y);
        out.double(4, z);
        for (number, value) in (5..).zip([length, width, height, heading, vx, vy]) {
            out.float(number, value);
        }
    }
    out.integer(11, i64::from(track.valid[frame]));
}

/// One message a frame, which holds the lights whose state is known in it.
fn write_lights(out: &mut Writer, scene: &Scene, document: &Document, features: &Ids, notes: &mut Notes) {
    let lights = document.get(document.root(), "dynamic_map_states");
    let lights = lights.and_then(|lights| document.entries(lights)).unwrap_or_default();
    let mut columns = Vec::with_capacity(lights.len());
    for (light, (_, entry)) in scene.lights.iter().zip(lights) {
        let Some(lane) = features.get(&light.lane) else {
            note(notes, "lights of lanes that are not in the map");
            continue;
        };
        let words = document.get(*entry, "state").and_then(|state| document.get(state, "object_state"));
        let words = words.and_then(|words| document.items(words)).unwrap_or_default();
        columns.push((lane, light, words));
    }
    for frame in 0..scene.frames {
        out.message(7, |out| {
            for (lane, light, words) in &columns {
                let word = words.get(frame).copied();
                let Some(state) = signal_state(document, word, light.states[frame], notes) else { continue };
                out.message(1, |out| {
                    out.integer(1, *lane);
                    out.integer(2, state);
                    if let Some(point) = light.stop_point {
                        out.point(3, point);
                    }
                });
            }
        });
    }
}

/// Number of a light's state; `None` if the lane has none in this frame.
fn signal_state(document: &Document, word: Option<Id>, state: LightState, notes: &mut Notes) -> Option<i64> {
    let word = word.filter(|word| !matches!(document.node(*word), Node::None))?;
    let text = document.text(word).unwrap_or_default();
    if let Some(number) = SIGNAL_STATES.iter().position(|known| *known == text) {
        return Some(number as i64);
    }
    note(notes, format!("states {text} of lights, written as stop, flashing stop, caution, go or unknown"));
    Some(match state {
        LightState::Unknown => 0,
        LightState::Stop => 4,
        LightState::Caution => 5,
        LightState::Go => 6,
        LightState::FlashingStop => 7,
    })
}

fn write_predictions(
    out: &mut Writer,
    index: &HashMap<&str, usize>,
    document: &Document,
    list: Option<Id>,
    notes: &mut Notes,
) {
    let entries = list.and_then(|list| document.entries(list)).unwrap_or_default();
    for (key, entry) in entries {
        let id = document.identifier(*key).unwrap_or_default();
        let Some(index) = index.get(&id[..]).copied() else {
            note(notes, "tracks to predict that are no tracks");
            continue;
        };
        let difficulty = document.get(*entry, "difficulty").and_then(|level| document.integer(level));
        let known = difficulty.filter(|level| (0..=2).contains(level));
        if difficulty.is_some() && known.is_none() {
            note(notes, "difficulties other than 0, 1 and 2, written as 0");
        }
        out.message(11, |out| {
            out.integer(1, index as i64);
            out.integer(2, known.unwrap_or(0));
        });
    }
}
