//! Encodes a scene as JSON of the present dialect.
//!
//! Readers take the first 64 road users, so ego and adversary go first. What a scene does not model (goals that are no last
//! positions, other keys) comes from its MetaDrive values.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::Path,
};

use sage_core::{
    geometry::wrap_angle,
    scene::PROVENANCE,
    scene::{LightState, Scene, Track, TrackKind, TrafficLight},
};
use serde::Serialize;
use serde_json::value::RawValue;

use super::{ABSENT, OWN, REST, decode::REST_OF_METADATA, file::Own, lights::STATES, map_elements};
use crate::{
    Error,
    metadrive::ASSUMED_SIZES,
    openscenario::License,
    pickle::{Document, Id, Node},
    womd::{Ids, Notes, note, unknown_edges},
};

/// Frames and road users that readers take.
const FRAMES: usize = 91;
const OBJECTS: usize = 64;
/// What others call an adversary whose recorded path is to be driven.
const EXPERT: &str = "mark_as_expert";

/// A scene as the text of a file.
pub struct EncodedGpuDrive {
    /// The JSON.
    pub json: Vec<u8>,
    /// What could not be kept, and how often.
    pub notes: Notes,
}

/// Encodes a scene and its MetaDrive values. `attacker` is the id of an adversary that attacks: a simulator is told to drive
/// its path, and not that of the ego.
///
/// *Errors*: [`Error::Field`] if the ego is no vehicle, which no reader takes.
pub(crate) fn encode(
    scene: &Scene,
    document: &Document,
    attacker: Option<&str>,
    path: &Path,
) -> Result<EncodedGpuDrive, Error> {
    if scene.ego().kind != TrackKind::Vehicle {
        return Err(Error::Field {
            path: path.to_owned(),
            field: "(ego)".to_owned(),
            found: format!("`{}` of type {}", scene.ego().id.escape_debug(), scene.ego().kind.name()),
            expected: "a vehicle, which GPUDrive needs".to_owned(),
        });
    }
    let mut notes = Notes::default();
    let order = order(scene, attacker, &mut notes);
    let objects = Ids::of_tracks(scene);
    let roads = Ids::of_features(scene);
    let metadata = document.get(document.root(), "metadata");
    let of_metadata = |key: &str| metadata.and_then(|metadata| document.get(metadata, key));
    let text = |key: &str| of_metadata(key).and_then(|value| document.text(value)).map(str::to_owned);
    let mut out = Writer::default();
    out.open('{');
    let top = of_metadata(REST).map(|rest| texts(document, rest)).unwrap_or_default();
    match top.iter().find(|(key, _)| *key == "name") {
        Some((key, name)) => out.raw(key, name),
        None => out.entry("name", &format!("{}.json", scene.id)),
    }
    out.entry("scenario_id", &scene.id);
    out.key("objects");
    out.open('[');
    let sources = entries_by_id(document, "tracks");
    for k in &order {
        let track = &scene.tracks[*k];
        let source = sources.get(&track.id[..]).copied();
        let rest = source.and_then(|source| document.get(document.get(source, "metadata")?, REST));
        let role = match attacker {
            Some(id) if track.id == id => Role::Attacker,
            Some(_) if *k == scene.ego => Role::Attacked,
            _ => Role::AsRead,
        };
        write_object(
            &mut out,
            track,
            role,
            &objects,
            &rest.map(|rest| texts(document, rest)).unwrap_or_default(),
        );
    }
    out.close(']');
    out.key("roads");
    out.open('[');
    write_roads(&mut out, scene, document, &roads, &mut notes);
    out.close(']');
    out.key("tl_states");
    out.open('{');
    write_lights(&mut out, scene, document, &roads, &mut notes);
    out.close('}');
    out.key("metadata");
    out.open('{');
    write_metadata(&mut out, scene, document, &order, &objects, &mut notes);
    for (key, value) in of_metadata(REST_OF_METADATA).map(|rest| texts(document, rest)).unwrap_or_default() {
        out.raw(key, value);
    }
    out.close('}');
    for (key, value) in top.into_iter().filter(|(key, _)| *key != "name") {
        out.raw(key, value);
    }
    let dataset = text("dataset").filter(|dataset| dataset != super::DATASET);
    let license = dataset.as_deref().and_then(License::of_dataset).map(|license| license.notice);
    let own = Own {
        provenance: text(PROVENANCE),
        assumed_sizes: text(ASSUMED_SIZES),
        license,
        objects: objects.table(),
        roads: roads.table(),
        dataset,
    };
    out.entry(OWN, &own);
    out.close('}');
    if scene.frames > FRAMES {
        note(
            &mut notes,
            format!("scenes of more than {FRAMES} frames, of which readers take the first {FRAMES}"),
        );
    }
    Ok(EncodedGpuDrive { json: out.text, notes })
}

/// Road users in their order: ego and adversary first, obstacles last.
fn order(scene: &Scene, attacker: Option<&str>, notes: &mut Notes) -> Vec<usize> {
    let adversary = match attacker {
        Some(id) => scene.tracks.iter().position(|track| track.id == id),
        None => scene.adversary,
    };
    let first: Vec<usize> = std::iter::once(scene.ego).chain(adversary.filter(|k| *k != scene.ego)).collect();
    let others = (0..scene.tracks.len()).filter(|k| !first.contains(k));
    let mut order = Vec::with_capacity(scene.tracks.len());
    for k in first.iter().copied().chain(others) {
        let track = &scene.tracks[k];
        if !track.valid.contains(&true) {
            note(notes, "road users that are absent in every frame");
            continue;
        }
        if !["UNSET", "OTHER"].contains(&track.kind.name()) && word_of(&track.kind) == "other" {
            note(notes, format!("road users of type {}, written as `other`", track.kind.name()));
        }
        order.push(k);
    }
    // Readers have no use for them.
    order.sort_by_key(|k| matches!(scene.tracks[*k].kind, TrackKind::Other(_)));
    if order.len() > OBJECTS {
        let taken =
            format!("of which readers take the first {OBJECTS} (ego and adversary are objects 0 and 1)");
        note(notes, format!("scenes of more than {OBJECTS} road users, {taken}"));
    }
    order
}

fn word_of(kind: &TrackKind) -> &'static str {
    match kind {
        TrackKind::Vehicle => "vehicle",
        TrackKind::Pedestrian => "pedestrian",
        TrackKind::Cyclist => "cyclist",
        TrackKind::Other(name) if name == TrackKind::UNSET => "unset",
        TrackKind::Other(_) => "other",
    }
}

/// What a road user is in an attack.
enum Role {
    Attacker,
    Attacked,
    AsRead,
}

fn write_object(out: &mut Writer, track: &Track, role: Role, ids: &Ids, rest: &[(&str, &str)]) {
    let frames = 0..track.valid.len();
    out.open('{');
    out.key("position");
    out.list(frames.clone(), |out, f| {
        out.point(if track.valid[f] { track.position[f] } else { [ABSENT; 3] });
    });
    // Callers leave out tracks that are never there.
    let last = track.valid.iter().rposition(|valid| *valid).unwrap_or(0);
    let [length, width, height] = track.size[last];
    out.entry("width", &width);
    out.entry("length", &length);
    out.entry("height", &height);
    out.key("heading");
    out.list(frames.clone(), |out, f| {
        out.number(if track.valid[f] { within_pi(track.heading[f]) } else { ABSENT });
    });
    out.key("velocity");
    out.list(frames, |out, f| {
        let [x, y] = if track.valid[f] { track.velocity[f] } else { [ABSENT; 2] };
        out.open('{');
        out.entry("x", &x);
        out.entry("y", &y);
        out.close('}');
    });
    out.entry("valid", &track.valid);
    out.key("goalPosition");
    out.point(track.position[last]);
    out.entry("type", word_of(&track.kind));
    out.entry("id", &ids.get(&track.id).unwrap_or(0));
    let read = rest.iter().find(|(key, _)| *key == EXPERT).map(|(_, value)| *value);
    let mark = match role {
        Role::Attacker => "true",
        Role::Attacked => "false",
        Role::AsRead => read.unwrap_or("false"),
    };
    out.raw(EXPERT, mark);
    for (key, value) in rest.iter().filter(|(key, _)| *key != EXPERT && *key != "goalPosition") {
        out.raw(key, value);
    }
    out.close('}');
}

/// A heading within [−π, π). One that is there stays as it is, bit for bit.
fn within_pi(heading: f64) -> f64 {
    let pi = std::f64::consts::PI;
    if (-pi..pi).contains(&heading) {
        return heading;
    }
    let found = wrap_angle(heading);
    if found >= pi { -pi } else { found }
}

fn write_roads(out: &mut Writer, scene: &Scene, document: &Document, ids: &Ids, notes: &mut Notes) {
    let sources = entries_by_id(document, "map_features");
    let position: HashMap<&str, usize> =
        document_order(document, "map_features").into_iter().enumerate().map(|(k, id)| (id, k)).collect();
    let entries = document.get(document.root(), "map_features").and_then(|all| document.entries(all));
    let unknown_edges = unknown_edges(document, entries.unwrap_or_default());
    let mut features: Vec<_> = scene.map.features.iter().collect();
    // The features of a scene are sorted; a file keeps the order of its source.
    features.sort_by_key(|feature| position.get(&feature.id[..]).copied());
    for feature in features {
        let word = feature.kind.name();
        let is_edge = feature.kind.is_edge() || word == "UNKNOWN" && unknown_edges.contains(&feature.id);
        let is_lane = feature.kind.is_lane() || feature.lane.is_some();
        let Some((name, id)) = map_elements::written(word, is_edge, is_lane) else {
            note(notes, format!("map features of type {word}, which the format does not have"));
            continue;
        };
        if !map_elements::has(word) {
            note(notes, format!("map features of type {word}, written as `{name}` of unknown type"));
        }
        out.open('{');
        out.key("geometry");
        out.list(feature.points.clone(), |out, k| out.point(scene.map.points[k]));
        out.entry("type", name);
        out.entry("map_element_id", &id);
        out.entry("id", &ids.get(&feature.id).unwrap_or(0));
        let rest = sources.get(&feature.id[..]).and_then(|source| document.get(*source, REST));
        for (key, value) in rest.map(|rest| texts(document, rest)).unwrap_or_default() {
            out.raw(key, value);
        }
        out.close('}');
    }
}

fn write_lights(out: &mut Writer, scene: &Scene, document: &Document, ids: &Ids, notes: &mut Notes) {
    let sources = document.get(document.root(), "dynamic_map_states");
    let sources = sources.and_then(|lights| document.entries(lights)).unwrap_or_default();
    let mut written = HashSet::new();
    for (light, (_, source)) in scene.lights.iter().zip(sources) {
        let Some(lane) = ids.get(&light.lane).filter(|lane| written.insert(*lane)) else {
            note(notes, "lights of lanes that are not in the map, or that have one already");
            continue;
        };
        let words = document.get(*source, "state").and_then(|state| document.get(state, "object_state"));
        let words = words.and_then(|words| document.items(words)).unwrap_or_default();
        let seen: Vec<(usize, &str)> = (0..scene.frames)
            .filter_map(|frame| Some((frame, state_of(document, light, words, frame, notes)?)))
            .collect();
        out.key(&lane.to_string());
        out.open('{');
        out.entry("state", &seen.iter().map(|(_, state)| *state).collect::<Vec<_>>());
        if let Some(stop) = light.stop_point {
            for (axis, value) in ["x", "y", "z"].into_iter().zip(stop) {
                out.entry(axis, &vec![value; seen.len()]);
            }
        }
        out.entry("time_index", &seen.iter().map(|(frame, _)| *frame).collect::<Vec<_>>());
        out.close('}');
    }
}

/// The state of a light in a frame; `None` where it was not seen.
fn state_of(
    document: &Document,
    light: &TrafficLight,
    words: &[Id],
    frame: usize,
    notes: &mut Notes,
) -> Option<&'static str> {
    let word = words.get(frame).copied().filter(|word| !matches!(document.node(*word), Node::None))?;
    let text = document.text(word).unwrap_or_default();
    if let Some((state, _)) = STATES.iter().find(|(_, known)| *known == text) {
        return Some(state);
    }
    note(notes, format!("states {text} of lights, written as stop, flashing_stop, caution, go or unknown"));
    Some(match light.states[frame] {
        LightState::Unknown => "unknown",
        LightState::Stop => "stop",
        LightState::Caution => "caution",
        LightState::Go => "go",
        LightState::FlashingStop => "flashing_stop",
    })
}

fn write_metadata(
    out: &mut Writer,
    scene: &Scene,
    document: &Document,
    order: &[usize],
    ids: &Ids,
    notes: &mut Notes,
) {
    let metadata = document.get(document.root(), "metadata");
    let of = |key: &str| metadata.and_then(|metadata| document.get(metadata, key));
    let index: HashMap<&str, usize> =
        order.iter().enumerate().map(|(place, k)| (&scene.tracks[*k].id[..], place)).collect();
    out.entry("sdc_track_index", &order.iter().position(|k| *k == scene.ego));
    let mut interest = Vec::new();
    for item in of("objects_of_interest").and_then(|list| document.items(list)).unwrap_or_default() {
        let id = document.identifier(*item).filter(|id| index.contains_key(&id[..]));
        match id.and_then(|id| ids.get(&id)) {
            Some(id) => interest.push(id),
            None => note(notes, "objects of interest that are not written"),
        }
    }
    out.entry("objects_of_interest", &interest);
    #[derive(Serialize)]
    struct Prediction {
        track_index: usize,
        difficulty: i64,
    }
    let mut predictions = Vec::new();
    for (key, entry) in of("tracks_to_predict").and_then(|all| document.entries(all)).unwrap_or_default() {
        let place = document.identifier(*key).and_then(|id| index.get(&id[..]).copied());
        let Some(track_index) = place else {
            note(notes, "tracks to predict that are not written");
            continue;
        };
        let difficulty = document.get(*entry, "difficulty").and_then(|level| document.integer(level));
        predictions.push(Prediction { track_index, difficulty: difficulty.unwrap_or(0) });
    }
    out.entry("tracks_to_predict", &predictions);
}

/// Ids of a dict of the document, in its order.
fn document_order<'d>(document: &'d Document, key: &str) -> Vec<&'d str> {
    let entries =
        document.get(document.root(), key).and_then(|all| document.entries(all)).unwrap_or_default();
    entries.iter().filter_map(|(key, _)| document.text(*key)).collect()
}

/// Entries of a dict of the document.
fn entries_by_id(document: &Document, key: &str) -> BTreeMap<String, Id> {
    let entries =
        document.get(document.root(), key).and_then(|all| document.entries(all)).unwrap_or_default();
    entries.iter().filter_map(|(key, value)| Some((document.identifier(*key)?, *value))).collect()
}

/// Entries of a dict of JSON texts, as the reader keeps them.
fn texts(document: &Document, dict: Id) -> Vec<(&str, &str)> {
    let entries = document.entries(dict).unwrap_or_default();
    let text = |(key, value): &(Id, Id)| {
        let value = document.text(*value)?;
        // Another program may have put anything there.
        serde_json::from_str::<&RawValue>(value).ok()?;
        Some((document.text(*key)?, value))
    };
    entries.iter().filter_map(text).collect()
}

/// Writes JSON without white space.
#[derive(Default)]
struct Writer {
    text: Vec<u8>,
}

impl Writer {
    fn open(&mut self, bracket: char) {
        self.separate();
        self.text.push(bracket as u8);
    }

    fn close(&mut self, bracket: char) {
        self.text.push(bracket as u8);
    }

    /// A comma, unless something begins here.
    fn separate(&mut self) {
        if !matches!(self.text.last(), None | Some(b'{' | b'[' | b':')) {
            self.text.push(b',');
        }
    }

    fn key(&mut self, key: &str) {
        self.separate();
        self.value(key);
        self.text.push(b':');
    }

    fn value(&mut self, value: &(impl Serialize + ?Sized)) {
        // Cannot fail: memory takes all bytes, and all keys are texts.
        let written = serde_json::to_writer(&mut self.text, value);
        debug_assert!(written.is_ok());
    }

    fn entry(&mut self, key: &str, value: &(impl Serialize + ?Sized)) {
        self.key(key);
        self.value(value);
    }

    fn raw(&mut self, key: &str, value: &str) {
        self.key(key);
        self.text.extend_from_slice(value.as_bytes());
    }

    fn number(&mut self, value: f64) {
        self.separate();
        self.value(&value);
    }

    fn point(&mut self, [x, y, z]: [f64; 3]) {
        self.open('{');
        self.entry("x", &x);
        self.entry("y", &y);
        self.entry("z", &z);
        self.close('}');
    }

    fn list(&mut self, items: impl Iterator<Item = usize>, mut write: impl FnMut(&mut Self, usize)) {
        self.open('[');
        items.for_each(|item| write(self, item));
        self.close(']');
    }
}
