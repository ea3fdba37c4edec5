//! Derived values of a scene file, with the keys and definitions of MetaDrive 0.4.3.
//!
//! They are `object_summary` and `number_summary` in the metadata, and ids and types in the metadata of each
//! track and light.
//!
//! - `object_summary`, per track: `type`, `object_id`, `track_length` (frames), `moving_distance` (m, in the plane), `valid_length`
//!   (frames), `continuous_valid_length` (first valid run)
//! - `number_summary`: `num_objects`, `object_types`, `num_objects_each_type`, `num_moving_objects`, `num_moving_objects_each_type`,
//!   `num_traffic_lights`, `num_traffic_light_types`, `num_traffic_light_each_step`, `num_map_features`, `map_height_diff` (m)
//! - set where they are missing: `ts`, `coordinate`, `dataset`, `metadrive_processed`

use std::collections::{BTreeMap, BTreeSet};

use crate::pickle::{Array, Document, Dtype, ElementKind, Id, Node, dtype_values};

/// Distance above which an object counts as moving, metres.
const MOVING: f64 = 1.0;
/// Height difference of road lines at which the search stops, metres.
const HEIGHT_LIMIT: f64 = 10.0;
/// Time between frames, seconds.
const PERIOD: f64 = 0.1;

const F32: Dtype = Dtype { kind: ElementKind::Float, size: 4, big_endian: false };

/// Writes both summaries, and all derivable values that MetaDrive's `sanity_check` requires. Changed dicts
/// are copied first, because other values may share them.
pub(crate) fn complete(document: &mut Document) {
    let root = document.root();
    for (group, kind) in [("tracks", "UNSET"), ("dynamic_map_states", "TRAFFIC_LIGHT")] {
        complete_objects(document, root, group, kind);
    }
    let length = document.get(root, "length").and_then(|length| document.integer(length));
    let length = u32::try_from(length.unwrap_or(0)).unwrap_or(0);
    let metadata = match document.get(root, "metadata") {
        Some(metadata) => document.shallow_copy(metadata),
        None => document.push(Node::Dict(Vec::new())),
    };
    if document.get(metadata, "ts").is_none() {
        let times = (0..length).map(|frame| f64::from(frame) * PERIOD);
        let data = document.push_bytes(&F32.write(times));
        let shape = vec![length];
        let times = Array { dtype: F32, shape, fortran: false, from_buffer: false, data };
        let times = document.push(Node::Array(Box::new(times)));
        document.set(metadata, "ts", times);
    }
    if document.get(metadata, "metadrive_processed").is_none() {
        let no = document.push(Node::Bool(false));
        document.set(metadata, "metadrive_processed", no);
    }
    for (key, value) in [("coordinate", "waymo"), ("dataset", "unknown")] {
        if document.get(metadata, key).is_none() {
            let value = document.new_text(value);
            document.set(metadata, key, value);
        }
    }
    for (key, value) in [("id", "unknown"), ("version", "unknown")] {
        if document.get(root, key).is_none() {
            let value = document.new_text(value);
            document.set(root, key, value);
        }
    }
    let (objects, numbers) = summaries(document);
    document.set(metadata, "object_summary", objects);
    document.set(metadata, "number_summary", numbers);
    document.set(root, "metadata", metadata);
}

/// Sets a missing type and id in the metadata of each object of a group.
fn complete_objects(document: &mut Document, root: Id, group: &str, kind: &str) {
    let Some(objects) = document.get(root, group) else {
        let empty = document.push(Node::Dict(Vec::new()));
        return document.set(root, group, empty);
    };
    let mut changed = Vec::new();
    for (index, (key, object)) in
        document.entries(objects).unwrap_or_default().to_vec().into_iter().enumerate()
    {
        let metadata = document.get(object, "metadata");
        let has = |key: &str| metadata.is_some_and(|metadata| document.get(metadata, key).is_some());
        if has("type") && has("object_id") && document.get(object, "type").is_some() {
            continue;
        }
        let object = document.shallow_copy(object);
        let kind = match document.get(object, "type") {
            Some(kind) => kind,
            None => document.new_text(kind),
        };
        let metadata = match metadata {
            Some(metadata) => document.shallow_copy(metadata),
            None => document.push(Node::Dict(Vec::new())),
        };
        document.set(object, "type", kind);
        document.set(metadata, "type", kind);
        document.set(metadata, "object_id", key);
        document.set(object, "metadata", metadata);
        changed.push((index, object));
    }
    if changed.is_empty() {
        return;
    }
    let mut node = document.node(objects).clone();
    if let Node::Dict(entries) | Node::DefaultDict { entries, .. } = &mut node {
        for (index, object) in changed {
            entries[index].1 = object;
        }
    }
    let objects = document.push(node);
    document.set(root, group, objects);
}

/// Recomputes the summary of one track and the numbers of moving objects, in new dicts. Other copies of the
/// document may share the dicts that [`complete`] wrote.
pub(crate) fn update(document: &mut Document, id: &str) {
    let root = document.root();
    let found = |document: &Document, group: Id| {
        let entries = document.entries(group)?;
        entries.iter().rposition(|(key, _)| document.identifier(*key).as_deref() == Some(id))
    };
    let (Some(metadata), Some(tracks)) = (document.get(root, "metadata"), document.get(root, "tracks"))
    else {
        return;
    };
    let Some(index) = found(document, tracks) else { return };
    let Some((_, track)) = document.entries(tracks).and_then(|entries| entries.get(index)).copied() else {
        return;
    };
    let object = ObjectSummary::of(document, id.to_owned(), track);
    let metadata = document.shallow_copy(metadata);
    document.set(root, "metadata", metadata);
    let (Some(objects), Some(numbers)) =
        (document.get(metadata, "object_summary"), document.get(metadata, "number_summary"))
    else {
        return;
    };
    let (objects, numbers) = (document.shallow_copy(objects), document.shallow_copy(numbers));
    document.set(metadata, "object_summary", objects);
    document.set(metadata, "number_summary", numbers);
    let kind = document.new_text(&object.kind);
    let summary = object.write(document, kind);
    document.set(objects, id, summary);
    let mut moving: BTreeMap<String, usize> = BTreeMap::new();
    for (_, object) in document.entries(objects).unwrap_or_default() {
        let distance = document.get(*object, "moving_distance").and_then(|d| document.number(d));
        let kind = document.get(*object, "type").and_then(|kind| document.text(kind));
        if let (Some(kind), true) = (kind, distance.is_some_and(|distance| distance > MOVING)) {
            *moving.entry(kind.to_owned()).or_default() += 1;
        }
    }
    let total = document.new_int(moving.values().sum());
    document.set(numbers, "num_moving_objects", total);
    let moving = counts(document, &moving.iter().map(|(kind, n)| (&kind[..], *n)).collect());
    document.set(numbers, "num_moving_objects_each_type", moving);
}

/// Content of the summary of one object.
struct ObjectSummary {
    id: String,
    kind: String,
    frames: usize,
    moving_distance: f64,
    valid_frames: usize,
    first_valid_frames: usize,
}

impl ObjectSummary {
    fn of(document: &Document, id: String, track: Id) -> Self {
        let state = document.get(track, "state");
        let column = |name: &str| {
            let column = state.and_then(|state| document.get(state, name));
            column.map_or_else(Column::default, |column| Column::of(document, column))
        };
        let (valid, position) = (column("valid"), column("position"));
        let is_valid = |frame: &usize| valid.at(*frame, 0) != 0.0;
        let frames: Vec<usize> = (0..valid.frames.min(position.frames)).filter(is_valid).collect();
        let step = |pair: &[usize]| {
            let [dx, dy] = [0, 1].map(|axis| position.at(pair[1], axis) - position.at(pair[0], axis));
            dx.hypot(dy)
        };
        let run = |first: usize| frames.iter().zip(first..).take_while(|(frame, at)| **frame == *at).count();
        let kind = document.get(track, "type").and_then(|kind| document.text(kind)).unwrap_or("UNSET");
        Self {
            id,
            kind: kind.to_owned(),
            frames: position.frames,
            moving_distance: frames.windows(2).map(step).sum(),
            valid_frames: frames.len(),
            first_valid_frames: frames.first().map_or(0, |first| run(*first)),
        }
    }

    fn write(&self, document: &mut Document, kind: Id) -> Id {
        let id = document.new_text(&self.id);
        let numbers = [self.frames, self.valid_frames, self.first_valid_frames];
        let [frames, valid, first] = numbers.map(|number| document.new_int(number));
        let distance = document.push(Node::Float(self.moving_distance));
        document.new_dict([
            ("type", kind),
            ("object_id", id),
            ("track_length", frames),
            ("moving_distance", distance),
            ("valid_length", valid),
            ("continuous_valid_length", first),
        ])
    }
}

/// `object_summary` and `number_summary` of a scene.
fn summaries(document: &mut Document) -> (Id, Id) {
    let tracks = document.get(document.root(), "tracks");
    let tracks = tracks.and_then(|tracks| document.entries(tracks)).unwrap_or_default();
    let object = |(key, track): &(Id, Id)| {
        ObjectSummary::of(document, document.identifier(*key).unwrap_or_default(), *track)
    };
    let all: Vec<ObjectSummary> = tracks.iter().map(object).collect();
    let kinds: BTreeSet<&str> = all.iter().map(|object| &object.kind[..]).collect();
    let kinds: BTreeMap<&str, Id> = kinds.iter().map(|kind| (*kind, document.new_text(kind))).collect();
    let count = |is_counted: &dyn Fn(&ObjectSummary) -> bool| {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for object in all.iter().filter(|object| is_counted(object)) {
            *counts.entry(&object.kind).or_default() += 1;
        }
        counts
    };
    let (total, moving) = (count(&|_| true), count(&|object| object.moving_distance > MOVING));
    let mut numbers: Vec<(&str, Id)> = vec![
        ("num_objects", document.new_int(all.len())),
        ("object_types", document.push(Node::Set(kinds.values().copied().collect()))),
        ("num_objects_each_type", counts(document, &total)),
        ("num_moving_objects", document.new_int(moving.values().sum())),
        ("num_moving_objects_each_type", counts(document, &moving)),
    ];
    lights(document, &mut numbers);
    let features = document.get(document.root(), "map_features");
    let features = features.and_then(|f| document.entries(f)).unwrap_or_default();
    let (number, difference) = (features.len(), height_difference(document, features));
    numbers.push(("num_map_features", document.new_int(number)));
    numbers.push(("map_height_diff", document.push(Node::Float(difference))));
    let objects: Vec<(&str, Id)> =
        all.iter().map(|object| (&object.id[..], object.write(document, kinds[&object.kind[..]]))).collect();
    (document.new_dict(objects), document.new_dict(numbers))
}

/// A dict of counts by name.
fn counts(document: &mut Document, counts: &BTreeMap<&str, usize>) -> Id {
    let entries: Vec<(&str, Id)> = counts.iter().map(|(name, n)| (*name, document.new_int(*n))).collect();
    document.new_dict(entries)
}

/// Numbers of a column of a track, or of a polyline: from an array of one or two axes, or from a list of
/// numbers or rows.
#[derive(Default)]
struct Column {
    values: Vec<f64>,
    frames: usize,
    width: usize,
    /// True if the values of one component are contiguous.
    fortran: bool,
}

impl Column {
    fn of(document: &Document, column: Id) -> Self {
        if let Node::Array(array) = document.node(column) {
            let values: Vec<f64> = dtype_values(document, array).collect();
            let frames = array.shape.first().map_or(0, |n| *n as usize);
            let width = values.len().checked_div(frames).unwrap_or(0);
            return Self { values, frames, width, fortran: array.fortran };
        }
        let items = document.items(column).unwrap_or_default();
        let row = |item: &Id| match document.number(*item) {
            Some(number) => vec![number],
            None => match document.node(*item) {
                Node::Array(array) => dtype_values(document, array).collect(),
                _ => {
                    let cells = document.items(*item).unwrap_or_default();
                    cells.iter().map(|cell| document.number(*cell).unwrap_or(0.0)).collect()
                }
            },
        };
        let rows: Vec<Vec<f64>> = items.iter().map(row).collect();
        let width = rows.first().map_or(0, Vec::len);
        // Rows of unequal length count as an empty column.
        let frames = if rows.iter().all(|row| row.len() == width) { rows.len() } else { 0 };
        Self { values: rows.concat(), frames, width, fortran: false }
    }

    /// A number; 0 if the column has no such component.
    fn at(&self, frame: usize, component: usize) -> f64 {
        if component >= self.width {
            return 0.0;
        }
        let index =
            if self.fortran { component * self.frames + frame } else { frame * self.width + component };
        self.values.get(index).copied().unwrap_or(0.0)
    }
}

/// Adds the entries of `number_summary` for traffic lights.
fn lights(document: &mut Document, numbers: &mut Vec<(&str, Id)>) {
    let lights = document.get(document.root(), "dynamic_map_states");
    let lights = lights.and_then(|lights| document.entries(lights)).unwrap_or_default();
    let number = lights.len();
    let mut steps: BTreeMap<String, usize> = BTreeMap::new();
    for (_, light) in lights {
        let states = document.get(*light, "state").and_then(|state| document.get(state, "object_state"));
        for state in states.and_then(|states| document.items(states)).unwrap_or_default() {
            if let Some(name) = document.text(*state) {
                *steps.entry(name.to_owned()).or_default() += 1;
            }
        }
    }
    numbers.push(("num_traffic_lights", document.new_int(number)));
    let types = steps.keys().map(|name| document.new_text(name)).collect();
    numbers.push(("num_traffic_light_types", document.push(Node::Set(types))));
    let steps = steps.iter().map(|(name, n)| (&name[..], *n)).collect();
    numbers.push(("num_traffic_light_each_step", counts(document, &steps)));
}

/// Difference between the highest and the lowest point of the road lines, metres; 0 if no line has heights.
fn height_difference(document: &Document, features: &[(Id, Id)]) -> f64 {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (_, feature) in features {
        let kind = document.get(*feature, "type").and_then(|kind| document.text(kind)).unwrap_or_default();
        if !kind.starts_with("ROAD_LINE_") && kind != "UNKNOWN_LINE" {
            continue;
        }
        let Some(line) = document.get(*feature, "polyline") else { continue };
        let line = Column::of(document, line);
        for point in (0..line.frames).filter(|_| line.width == 3) {
            let z = line.at(point, 2);
            (low, high) = (low.min(z), high.max(z));
        }
        if high - low > HEIGHT_LIMIT {
            break;
        }
    }
    if high >= low { high - low } else { 0.0 }
}
