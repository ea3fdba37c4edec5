//! Encodes the map of a scene.

use std::collections::{HashMap, HashSet};

use sage_core::{
    motion::MAX_COORDINATE,
    scene::{MapFeature, Scene},
};

use super::{Notes, ids::Ids, message::Writer, note};
use crate::{
    pickle::{Document, Id},
    womd::words::{
        LANE, LANE_TYPES, MEMBERS, MILE, ROAD_EDGE, ROAD_EDGE_TYPES, ROAD_LINE, ROAD_LINE_TYPES, STOP_SIGN,
    },
};

/// Keys of both sides of a lane in MetaDrive values.
const NEIGHBORS: [&str; 2] = ["left_neighbor", "right_neighbor"];
const BOUNDARIES: [&str; 2] = ["left_boundaries", "right_boundaries"];

/// Writes all map features that the schema has a type for.
pub(super) fn write(out: &mut Writer, scene: &Scene, document: &Document, ids: &Ids, notes: &mut Notes) {
    let entries = document.get(document.root(), "map_features");
    let entries = entries.and_then(|entries| document.entries(entries)).unwrap_or_default();
    let map = Map { scene, document, ids, unknown_edges: unknown_edges(document, entries) };
    let features: HashMap<&str, &MapFeature> = scene.map.features.iter().map(|f| (&f.id[..], f)).collect();
    // A record keeps the order of its source; the features of a scene are sorted.
    for (key, entry) in entries {
        let id = document.identifier(*key);
        if let Some(feature) = id.and_then(|id| features.get(&id[..])) {
            map.write(out, feature, *entry, notes);
        }
    }
}

/// Ids of boundaries of an unknown type. Over a road edge, Waymo's boundaries have none.
pub(crate) fn unknown_edges(document: &Document, entries: &[(Id, Id)]) -> HashSet<String> {
    let mut edges = HashSet::new();
    for (_, entry) in entries {
        for key in BOUNDARIES {
            let list = document.get(*entry, key).and_then(|list| document.items(list)).unwrap_or_default();
            for boundary in list {
                let is_unknown =
                    document.get(*boundary, "boundary_type").and_then(|word| document.text(word))
                        == Some(ROAD_LINE_TYPES[0]);
                let id =
                    document.get(*boundary, "boundary_feature_id").and_then(|id| document.identifier(id));
                edges.extend(id.filter(|_| is_unknown));
            }
        }
    }
    edges
}

struct Map<'m> {
    scene: &'m Scene,
    document: &'m Document,
    ids: &'m Ids,
    unknown_edges: HashSet<String>,
}

impl Map<'_> {
    fn write(&self, out: &mut Writer, feature: &MapFeature, entry: Id, notes: &mut Notes) {
        let name = feature.kind.name();
        let index = |words: &[&str]| words.iter().position(|word| *word == name);
        let is_lane = feature.lane.is_some() || self.document.get(entry, "entry_lanes").is_some();
        let is_edge = feature.kind.is_edge() || name == "UNKNOWN" && self.unknown_edges.contains(&feature.id);
        let line = index(&ROAD_LINE_TYPES);
        let (number, kind) = if is_lane {
            if index(&LANE_TYPES).is_none() {
                note(notes, format!("lanes of type {name}, written as LANE_UNKNOWN"));
            }
            (LANE, index(&LANE_TYPES).unwrap_or(0))
        } else if is_edge {
            (ROAD_EDGE, index(&ROAD_EDGE_TYPES).unwrap_or(0))
        } else if let Some(line) = line {
            (ROAD_LINE, line)
        } else if let Some(member) = MEMBERS.iter().find(|member| member.kind == name) {
            (member.number, 0)
        } else if name.starts_with("ROAD_LINE_") {
            note(notes, format!("road lines of type {name}, written as UNKNOWN"));
            (ROAD_LINE, 0)
        } else {
            note(notes, format!("map features of type {name}, which the format does not have"));
            return;
        };
        out.message(8, |out| {
            out.integer(1, self.ids.get(&feature.id).unwrap_or(0));
            out.message(number, |out| match number {
                LANE => self.write_lane(out, feature, entry, kind, notes),
                ROAD_LINE | ROAD_EDGE => {
                    out.integer(1, kind as i64);
                    self.write_points(out, 2, feature);
                }
                STOP_SIGN => {
                    self.feature_ids(entry, "lane", notes).into_iter().for_each(|lane| out.integer(1, lane));
                    self.write_points(out, 2, feature);
                }
                _ => self.write_points(out, 1, feature),
            });
        });
    }

    fn write_points(&self, out: &mut Writer, number: u32, feature: &MapFeature) {
        self.scene.map.points_of(feature).iter().for_each(|point| out.point(number, *point));
    }

    fn write_lane(&self, out: &mut Writer, feature: &MapFeature, entry: Id, kind: usize, notes: &mut Notes) {
        let document = self.document;
        let number = |key: &str| document.get(entry, key).and_then(|value| document.number(value));
        let mph = number("speed_limit_mph").or_else(|| number("speed_limit_kmh").map(|kmh| kmh / MILE));
        let known = mph.filter(|mph| mph.abs() <= MAX_COORDINATE);
        if mph.is_some() && known.is_none() {
            note(notes, "speed limits beyond any, written as none");
        }
        out.double(1, known.unwrap_or(0.0));
        out.integer(2, kind as i64);
        if number("interpolating") == Some(1.0) {
            out.integer(3, 1);
        }
        self.write_points(out, 8, feature);
        out.packed(9, &self.feature_ids(entry, "entry_lanes", notes));
        out.packed(10, &self.feature_ids(entry, "exit_lanes", notes));
        for (number, key) in (11..).zip(NEIGHBORS) {
            for neighbor in self.items(entry, key) {
                self.write_neighbor(out, number, *neighbor, notes);
            }
        }
        let points = feature.points.len() as i64;
        for (number, key) in (13..).zip(BOUNDARIES) {
            for boundary in self.items(entry, key) {
                // The reader refuses such a boundary, because the lane's width cannot be computed.
                let [first, last] = self.indices(*boundary, ["lane_start_index", "lane_end_index"]);
                if (0..points).contains(&first) && (0..points).contains(&last) {
                    self.write_boundary(out, number, *boundary, notes);
                } else {
                    note(notes, "boundaries of points that their lane does not have");
                }
            }
        }
    }

    fn write_neighbor(&self, out: &mut Writer, number: u32, neighbor: Id, notes: &mut Notes) {
        // Some data sets list only ids.
        let id = self.document.get(neighbor, "feature_id").unwrap_or(neighbor);
        let Some(id) = self.document.identifier(id).and_then(|id| self.ids.get(&id)) else {
            return note(notes, "links to lanes that are not in the map");
        };
        out.message(number, |out| {
            out.integer(1, id);
            let keys = ["self_start_index", "self_end_index", "neighbor_start_index", "neighbor_end_index"];
            for (number, index) in (2..).zip(self.indices(neighbor, keys)) {
                out.integer(number, index);
            }
            for boundary in self.items(neighbor, "boundaries") {
                self.write_boundary(out, 6, *boundary, notes);
            }
        });
    }

    fn write_boundary(&self, out: &mut Writer, number: u32, boundary: Id, notes: &mut Notes) {
        let document = self.document;
        let id = document.get(boundary, "boundary_feature_id").and_then(|id| document.identifier(id));
        // The id 0 of no feature is left out, as in Waymo's files.
        let id = id.filter(|id| id != "0");
        let feature = id.as_ref().and_then(|id| self.ids.get(id));
        if feature.is_none() && id.is_some() {
            note(notes, "boundaries that are not in the map");
        }
        let word = document.get(boundary, "boundary_type").and_then(|word| document.text(word));
        let kind = ROAD_LINE_TYPES.iter().position(|known| Some(*known) == word).unwrap_or(0);
        out.message(number, |out| {
            let indices = self.indices(boundary, ["lane_start_index", "lane_end_index"]);
            for (number, index) in (1..).zip(indices) {
                out.integer(number, index);
            }
            if let Some(feature) = feature {
                out.integer(3, feature);
            }
            out.integer(4, kind as i64);
        });
    }

    fn items(&self, entry: Id, key: &str) -> &[Id] {
        self.document.get(entry, key).and_then(|list| self.document.items(list)).unwrap_or_default()
    }

    /// Numbers of the lanes that a list names.
    fn feature_ids(&self, entry: Id, key: &str, notes: &mut Notes) -> Vec<i64> {
        let mut numbers = Vec::new();
        for item in self.items(entry, key) {
            match self.document.identifier(*item).and_then(|id| self.ids.get(&id)) {
                Some(number) => numbers.push(number),
                None => note(notes, "links to lanes that are not in the map"),
            }
        }
        numbers
    }

    /// Indices under some keys of a dict; 0 for those that it does not have.
    fn indices<const N: usize>(&self, dict: Id, keys: [&str; N]) -> [i64; N] {
        let index = |key: &str| {
            let value = self.document.get(dict, key).and_then(|value| self.document.integer(value));
            value.filter(|value| i32::try_from(*value).is_ok()).unwrap_or(0)
        };
        keys.map(index)
    }
}
