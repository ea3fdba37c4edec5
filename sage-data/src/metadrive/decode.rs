//! Decodes a document into a scene and checks all invariants of a scene.

use std::{
    cell::Cell,
    collections::{HashMap, HashSet},
    path::Path,
    sync::Arc,
};

use sage_core::{
    motion::{HISTORY, MAX_COORDINATE},
    scene::{
        AdversaryOrigin, Boundary, Lane, Map, MapFeature, MapKind, Neighbor, Note, PROVENANCE, Repair, Scene,
    },
};

use super::{
    ASSUMED_SIZES,
    added::added_tracks,
    fields::{Field, Fields},
    lights::{lights, point},
    tracks::{Whole, tracks},
};
use crate::{
    Error, ReadOptions, lane_links, lane_polygon,
    pickle::{Document, Id, Node},
    repairs::{self, Decoded, Draft},
};

/// Maximum number of frames of a recording: over an hour at 10 Hz.
pub(crate) const MAX_FRAMES: usize = 40_000;

/// Turns the values of a file into a checked scene at 10 Hz; `path` names the file in errors.
///
/// *Errors*: [`Error::Field`] with the field, the value found and the value expected.
pub fn decode(document: &Document, options: &ReadOptions, path: &Path) -> Result<Decoded, Error> {
    let fields = Fields::new(document, path);
    let root = Field::ROOT;
    let top = document.root();
    fields.entries(top, &root.key("(root)"))?;
    let frames = frames(&fields, top)?;
    let metadata_field = root.key("metadata");
    let metadata = fields.required(top, &root, "metadata", "a dict with `sdc_id`, the ego")?;
    let id = match fields.optional(top, "id").or_else(|| fields.optional(metadata, "scenario_id")) {
        Some(id) => fields.identifier(id, &root.key("id"))?,
        None => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
    };
    let mut notes = Vec::new();
    let ego_field = metadata_field.key("sdc_id");
    let ego_id = fields.required(metadata, &metadata_field, "sdc_id", "the id of the ego's track")?;
    let ego_name = fields.identifier(ego_id, &ego_field)?;
    let named = named_adversary(&fields, metadata, &ego_name);
    let whole = match options.strict {
        true => Whole::All,
        false => Whole::Only(named.iter().chain([&ego_name]).cloned().collect()),
    };
    let tracks = tracks(&fields, top, frames, &whole, &mut notes)?;
    let index = |name: &String| tracks.iter().position(|track| track.id == *name);
    let ego = index(&ego_name).ok_or_else(|| fields.wrong(&ego_field, ego_id, "the id of a track"))?;
    let named = named.as_ref().and_then(index);
    let now_index = fields.optional(metadata, "current_time_index").and_then(|id| document.integer(id));
    if let Some(id) = fields.optional(metadata, "focal_track_id").and_then(|id| document.text(id)) {
        notes.extend((!id.is_empty()).then(|| Note::Focal(id.to_owned())));
    }
    if let Some(sizes) = fields.optional(metadata, ASSUMED_SIZES).and_then(|text| document.text(text)) {
        notes.push(Repair::NoSize.note(sizes));
    }
    let sample_rate =
        fields.optional(metadata, "sample_rate").or_else(|| fields.optional(top, "sample_rate"));
    let sample_rate = sample_rate.and_then(|id| document.number(id));
    let timestamps = match fields.optional(metadata, "ts") {
        // Seconds from the start, or from any other clock.
        Some(ts) => fields.column_within(f64::MAX, ts, &metadata_field.key("ts"), frames)?,
        None => Vec::new(),
    };
    let provenance = fields.optional(metadata, PROVENANCE).and_then(|text| document.text(text));
    let added = provenance.map(added_tracks).unwrap_or_default();
    let map = Arc::new(map(&fields, top, &mut notes)?);
    let lights = lights(&fields, top, frames, options.strict, &mut notes)?;
    // A lookup beyond the work limit returns `None`, which must not count as a missing field.
    fields.spend(&root.key("(root)"), 0)?;
    let (adversary, adversary_origin) = (None, AdversaryOrigin::None);
    let scene = Scene {
        id,
        frames,
        timestamps,
        tracks: tracks.into(),
        map,
        lights,
        ego,
        adversary,
        adversary_origin,
        notes,
        held: Vec::new(),
    };
    repairs::finish(Draft { scene, named, added, sample_rate, now_index }, options, path)
}

fn frames(fields: &Fields, top: Id) -> Result<usize, Error> {
    let field = Field::ROOT.key("length");
    let expected = format!("a number of frames from {HISTORY} to {MAX_FRAMES}");
    let id = fields.required(top, &Field::ROOT, "length", &expected)?;
    let frames = fields.document.integer(id).and_then(|n| usize::try_from(n).ok());
    match frames {
        // Whether there are enough for the history depends on their rate.
        Some(frames) if (2..=MAX_FRAMES).contains(&frames) => Ok(frames),
        _ => Err(fields.wrong(&field, id, expected)),
    }
}

/// Id of the object of interest besides the ego, if the file names exactly one that is a track.
///
/// MetaDrive gives the tracks of a re-exported drive new ids. The objects of interest are then those of the scene that
/// was driven (`history_metadata`), and each track has its old id (`original_id`).
fn named_adversary(fields: &Fields, metadata: Id, ego: &str) -> Option<String> {
    let document = fields.document;
    let tracks = fields.optional(document.root(), "tracks").and_then(|tracks| document.entries(tracks))?;
    let identifier = |id: Id| {
        fields.spend_work(document.text_length(id).unwrap_or(1)).then(|| document.identifier(id)).flatten()
    };
    let original = |track: Id| {
        let metadata = fields.optional(track, "metadata")?;
        identifier(fields.optional(metadata, "original_id")?)
    };
    let interest = |metadata: Id| document.items(fields.optional(metadata, "objects_of_interest")?);
    let (list, is_before) = match interest(metadata) {
        Some(list) => (list, false),
        None => (interest(fields.optional(metadata, "history_metadata")?)?, true),
    };
    let list: HashSet<String> = list.iter().filter_map(|id| identifier(*id)).collect();
    let mut others: Vec<String> = Vec::new();
    for (key, track) in tracks {
        // Texts are compared without a copy.
        let is_named = match document.text(*key) {
            _ if is_before => original(*track).is_some_and(|id| list.contains(&id)),
            Some(id) => fields.spend_work(id.len()) && list.contains(id),
            None => identifier(*key).is_some_and(|id| list.contains(&id)),
        };
        if is_named {
            others.extend(identifier(*key).filter(|id| id != ego));
        }
    }
    if others.len() == 1 { others.pop() } else { None }
}

// --- map ---

/// Highest speed limit, km/h; above it there is none.
const FASTEST_LIMIT: f64 = 300.0;
/// Keys of the left and right side of a lane.
const NEIGHBORS: [&str; 2] = ["left_neighbor", "right_neighbor"];
const BOUNDARIES: [&str; 2] = ["left_boundaries", "right_boundaries"];

fn map(fields: &Fields, top: Id, notes: &mut Vec<Note>) -> Result<Map, Error> {
    let root = Field::ROOT.key("map_features");
    let Some(id) = fields.optional(top, "map_features") else { return Ok(Map::default()) };
    let entries = fields.entries(id, &root)?;
    let mut map = Map { points: Vec::with_capacity(fields.document.file_size() / 24), ..Map::default() };
    // Lanes whose points are the outline of the lane.
    let mut rings: Vec<usize> = Vec::new();
    // Row widths of the file's polylines and polygons.
    let (mut flat, mut deep) = (false, false);
    for (key, value) in entries {
        let name = fields.identifier(*key, &root)?;
        let field = root.key(&name);
        let kind = fields.required(*value, &field, "type", "LANE_…, ROAD_LINE_…, ROAD_EDGE_…, …")?;
        let kind = fields.word(kind, &field.key("type"))?;
        let kind = MapKind::from_name(kind);
        let first = map.points.len();
        let shape = ["polyline", "polygon", "position"]
            .into_iter()
            .find_map(|key| fields.optional(*value, key).map(|id| (key, id)));
        let (key, shape) = shape
            .ok_or_else(|| fields.error(&field, "without points", "a `polyline`, `polygon` or `position`"))?;
        let shape_field = field.key(key);
        let is_ring = key == "polygon";
        match key {
            "position" => map.points.extend(point(fields, shape, &shape_field)?),
            _ => {
                fields.append_rows(&mut map.points, shape, &shape_field, &[3, 2])?;
                let three = fields.row_width(shape) == Some(3);
                (flat, deep) = (flat | !three, deep | three);
            }
        }
        if map.points.len() == first {
            return Err(fields.error(&shape_field, "empty", "at least one point"));
        }
        if is_ring && kind.is_edge() {
            close(&mut map.points, first);
        } else if is_ring && kind.is_lane() {
            rings.push(map.features.len());
        }
        map.features.push(MapFeature { id: name, kind, points: first..map.points.len(), lane: None });
    }
    if flat && deep {
        // A map with heights has three columns everywhere. The third column of nuScenes lanes is a heading.
        map.points.iter_mut().for_each(|p| p[2] = 0.0);
        notes.push(Note::Other(
            "map points have two or three columns; heights are taken as unknown".to_owned(),
        ));
    }
    // Lanes refer to each other, so they are linked after all features are read.
    let index: HashMap<&str, usize> = map.features.iter().enumerate().map(|(k, f)| (&f.id[..], k)).collect();
    if index.len() != map.features.len() {
        return Err(fields.error(&root, "an id that occurs twice", "one feature per id"));
    }
    let links = Links { fields, index, odd_limits: Cell::new(0), odd_widths: Cell::new(0) };
    let mut lanes: Vec<Option<Box<Lane>>> = entries
        .iter()
        .zip(&map.features)
        .map(|((_, value), feature)| match feature.kind.is_lane() {
            true => links.lane(*value, &root.key(&feature.id)).map(|lane| Some(Box::new(lane))),
            false => Ok(None),
        })
        .collect::<Result<_, Error>>()?;
    for (sign, ((_, value), feature)) in entries.iter().zip(&map.features).enumerate() {
        if feature.kind == MapKind::StopSign {
            for lane in links.ids(*value, "lane", &root.key(&feature.id))? {
                lanes[lane].iter_mut().for_each(|lane| lane.stop_signs.push(sign));
            }
        }
    }
    for (count, what) in [(&links.odd_limits, "speed limits"), (&links.odd_widths, "widths")] {
        if count.get() > 0 {
            let text =
                format!("{} lanes have {what} that cannot be true; they count as unknown", count.get());
            notes.push(Repair::MapValues.note(text));
        }
    }
    for (feature, lane) in map.features.iter_mut().zip(lanes) {
        feature.lane = lane;
    }
    lane_polygon::derive_center_lines(&mut map, &rings, notes);
    let mut removed = 0;
    for k in 0..map.features.len() {
        let mut lane = map.features[k].lane.take();
        removed += lane.as_deref_mut().map_or(0, |lane| remove_links_out_of_range(lane, k, &map));
        map.features[k].lane = lane;
    }
    if removed > 0 {
        notes.push(Note::Other(format!(
            "{removed} lane links name points that do not exist and are left out"
        )));
    }
    // Up to here features are in the order of the file, as the entries are.
    let mut map = map.in_order_of_ids();
    lane_links::derive(&mut map, notes);
    // Shrinking copies the points, so it is done only if the estimated capacity was much too large.
    if map.points.capacity() > 2 * map.points.len() {
        map.points.shrink_to_fit();
    }
    Ok(map)
}

/// The entry of each map feature in a file whose values are a document. Files have any order.
pub(crate) fn entries_of_features(document: &Document, map: &Map) -> Vec<Option<Id>> {
    let entries = document.get(document.root(), "map_features").and_then(|entries| document.entries(entries));
    let entries = entries.unwrap_or_default();
    let named = entries.iter().filter_map(|(key, value)| Some((document.identifier(*key)?, *value)));
    let named: HashMap<String, Id> = named.collect();
    map.features.iter().map(|feature| named.get(&feature.id).copied()).collect()
}

/// Closes the outline of points from `first` on.
fn close(points: &mut Vec<[f64; 3]>, first: usize) {
    let start = points[first];
    if points.len() > first + 2 && points.last().is_some_and(|last| last[..2] != start[..2]) {
        points.push(start);
    }
}

/// Removes a lane's links to points that do not exist. Returns their number.
fn remove_links_out_of_range(lane: &mut Lane, own: usize, map: &Map) -> usize {
    let links = |lane: &Lane| {
        lane.neighbors.iter().map(Vec::len).sum::<usize>()
            + lane.boundaries.iter().map(Vec::len).sum::<usize>()
    };
    let before = links(lane);
    for side in &mut lane.neighbors {
        side.retain(|n| map.has_points(own, n.own) && map.has_points(n.lane, n.other));
    }
    for side in &mut lane.boundaries {
        side.retain(|b| map.has_points(own, b.own));
    }
    before - links(lane)
}

/// Index of features by id, for linking lanes.
struct Links<'f, 'd> {
    fields: &'f Fields<'d>,
    index: HashMap<&'f str, usize>,
    /// Number of lanes with a speed limit or a width that cannot be one.
    odd_limits: Cell<usize>,
    odd_widths: Cell<usize>,
}

impl Links<'_, '_> {
    fn lane(&self, id: Id, field: &Field) -> Result<Lane, Error> {
        let limit = self.fields.optional(id, "speed_limit_kmh").and_then(|x| self.fields.document.number(x));
        // 0 is how Waymo's files write that there is none, 1000 how MetaDrive's do.
        if limit.is_some_and(|kmh| !(kmh.is_finite() && kmh >= 0.0)) {
            self.odd_limits.set(self.odd_limits.get() + 1);
        }
        let mut width = match self.fields.optional(id, "width") {
            // Some data sets store one mean width instead of a table.
            Some(width) if matches!(self.fields.document.node(width), Node::Array(a) if a.shape.len() == 2) => {
                self.fields.unchecked_rows::<2>(width, &field.key("width"), &[2])?
            }
            _ => Vec::new(),
        };
        let is_odd = |side: &f64| !((*side >= 0.0) & (*side <= MAX_COORDINATE));
        // One branch-free pass over all; nearly no file has such a width.
        if width.as_flattened().iter().fold(false, |odd, side| odd | is_odd(side)) {
            width.as_flattened_mut().iter_mut().filter(|side| is_odd(side)).for_each(|side| *side = 0.0);
            self.odd_widths.set(self.odd_widths.get() + 1);
        }
        Ok(Lane {
            speed_limit: limit.filter(|kmh| *kmh > 0.0 && *kmh <= FASTEST_LIMIT).map(|kmh| kmh / 3.6),
            entries: self.ids(id, "entry_lanes", field)?,
            exits: self.ids(id, "exit_lanes", field)?,
            neighbors: [self.neighbors(id, NEIGHBORS[0], field)?, self.neighbors(id, NEIGHBORS[1], field)?],
            boundaries: [
                self.boundaries(id, BOUNDARIES[0], field)?,
                self.boundaries(id, BOUNDARIES[1], field)?,
            ],
            stop_signs: Vec::new(),
            width,
        })
    }

    /// Items of a list under a key, each of which becomes a `T`; empty if there is no list.
    fn items<T>(&self, id: Id, key: &str, field: &Field) -> Result<&[Id], Error> {
        let items = self.fields.optional(id, key).and_then(|list| self.fields.document.items(list));
        let items = items.unwrap_or_default();
        self.fields.spend(&field.key(key), size_of::<T>() * items.len())?;
        Ok(items)
    }

    /// The feature that a value names; `None` if the map does not contain it (maps are parts of larger ones).
    fn feature(&self, id: Id) -> Option<usize> {
        // Hashing reads the whole text.
        if !self.fields.spend_work(self.fields.document.text_length(id).unwrap_or(0)) {
            return None;
        }
        match self.fields.document.text(id) {
            Some(name) => self.index.get(name).copied(),
            None => self.index.get(&self.fields.document.identifier(id)?[..]).copied(),
        }
    }

    fn ids(&self, id: Id, key: &str, field: &Field) -> Result<Vec<usize>, Error> {
        Ok(self.items::<usize>(id, key, field)?.iter().filter_map(|item| self.feature(*item)).collect())
    }

    /// An index range under two keys of a dict.
    fn range(&self, dict: Id, first: &str, last: &str) -> Option<[usize; 2]> {
        let at = |key: &str| {
            let value = self.fields.document.integer(self.fields.optional(dict, key)?)?;
            usize::try_from(value).ok()
        };
        Some([at(first)?, at(last)?])
    }

    fn neighbors(&self, id: Id, key: &str, field: &Field) -> Result<Vec<Neighbor>, Error> {
        let neighbor = |item: Id| {
            // Some data sets list only ids.
            let Some(lane) = self.fields.optional(item, "feature_id") else {
                return Some(Neighbor { lane: self.feature(item)?, own: [0, 0], other: [0, 0] });
            };
            Some(Neighbor {
                lane: self.feature(lane)?,
                own: self.range(item, "self_start_index", "self_end_index")?,
                other: self.range(item, "neighbor_start_index", "neighbor_end_index")?,
            })
        };
        Ok(self.items::<Neighbor>(id, key, field)?.iter().filter_map(|item| neighbor(*item)).collect())
    }

    fn boundaries(&self, id: Id, key: &str, field: &Field) -> Result<Vec<Boundary>, Error> {
        let boundary = |item: Id| {
            Some(Boundary {
                feature: self.feature(self.fields.optional(item, "boundary_feature_id")?)?,
                own: self.range(item, "lane_start_index", "lane_end_index")?,
            })
        };
        Ok(self.items::<Boundary>(id, key, field)?.iter().filter_map(|item| boundary(*item)).collect())
    }
}
