//! A MetaDrive file for a scene without a source.

use std::collections::BTreeMap;

use sage_core::scene::{Boundary, LightState, Map, MapFeature, MapKind, Neighbor, Scene, Track};

use crate::pickle::{Array, Document, Dtype, ElementKind, Id, Node};

/// Data set name of procedural scenes.
pub(crate) const PROCEDURAL_DATASET: &str = "sage";

const F32: Dtype = Dtype { kind: ElementKind::Float, size: 4, big_endian: false };
const BOOL: Dtype = Dtype { kind: ElementKind::Bool, size: 1, big_endian: false };

/// The values of a new MetaDrive file for a scene. Numbers are rounded to 32-bit floats, as in recorded
/// files.
pub(crate) fn fresh(scene: &Scene) -> Document {
    let mut builder = Builder(Document::empty());
    let tracks = scene.tracks.iter().map(|track| (track.id.clone(), builder.track(track))).collect();
    let lights: Vec<(String, Id)> = scene
        .lights
        .iter()
        .map(|light| {
            let states = light.states.iter().map(|state| builder.light_state(*state)).collect();
            let states = builder.push(Node::List(states));
            let state = builder.dict([("object_state", states)]);
            let stop = match light.stop_point {
                Some(point) => builder.floats(&[3], point),
                None => builder.push(Node::None),
            };
            let (kind, lane) = (builder.text("TRAFFIC_LIGHT"), builder.text(&light.lane));
            let length = builder.push(Node::Int(light.states.len() as i64));
            let metadata = builder.dict([("track_length", length), ("type", kind), ("object_id", lane)]);
            let entries = [
                ("type", kind),
                ("state", state),
                ("lane", lane),
                ("stop_point", stop),
                ("metadata", metadata),
            ];
            (light.lane.clone(), builder.dict(entries))
        })
        .collect();
    let mut signs: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
    for lane_feature in &scene.map.features {
        for sign in lane_feature.lane.iter().flat_map(|lane| &lane.stop_signs) {
            signs.entry(*sign).or_default().push(&lane_feature.id);
        }
    }
    let features = scene.map.features.iter().enumerate();
    let features = features
        .map(|(k, feature)| {
            let lanes = signs.get(&k).map_or(&[][..], Vec::as_slice);
            (feature.id.clone(), builder.feature(&scene.map, feature, lanes))
        })
        .collect::<Vec<_>>();
    let metadata = builder.metadata(scene);
    let (tracks, lights, features) = (builder.named(tracks), builder.named(lights), builder.named(features));
    let (id, version) = (builder.text(&scene.id), builder.text("sage"));
    let length = builder.push(Node::Int(scene.frames as i64));
    let root = builder.dict([
        ("id", id),
        ("version", version),
        ("length", length),
        ("tracks", tracks),
        ("dynamic_map_states", lights),
        ("map_features", features),
        ("metadata", metadata),
    ]);
    builder.0.set_root(root);
    super::complete(&mut builder.0);
    builder.0
}

/// Builds a document.
struct Builder(Document);

impl Builder {
    fn push(&mut self, node: Node) -> Id {
        self.0.push(node)
    }

    fn text(&mut self, text: &str) -> Id {
        self.0.new_text(text)
    }

    fn dict<const N: usize>(&mut self, entries: [(&str, Id); N]) -> Id {
        self.0.new_dict(entries)
    }

    fn named(&mut self, entries: Vec<(String, Id)>) -> Id {
        self.0.new_dict(entries)
    }

    fn texts<'t>(&mut self, texts: impl IntoIterator<Item = &'t str>) -> Id {
        let items = texts.into_iter().map(|text| self.text(text)).collect();
        self.push(Node::List(items))
    }

    fn array(&mut self, dtype: Dtype, shape: &[usize], values: impl Iterator<Item = f64>) -> Id {
        let data = self.0.push_bytes(&dtype.write(values));
        let shape = shape.iter().map(|n| *n as u32).collect();
        self.push(Node::Array(Box::new(Array { dtype, shape, fortran: false, from_buffer: false, data })))
    }

    fn floats(&mut self, shape: &[usize], values: impl IntoIterator<Item = f64>) -> Id {
        self.array(F32, shape, values.into_iter())
    }

    fn track(&mut self, track: &Track) -> Id {
        let n = track.valid.len();
        let position = self.floats(&[n, 3], track.position.iter().flatten().copied());
        let size = [0, 1, 2].map(|k| self.floats(&[n], track.size.iter().map(|s| s[k])));
        let heading = self.floats(&[n], track.heading.iter().copied());
        let velocity = self.floats(&[n, 2], track.velocity.iter().flatten().copied());
        let valid = self.array(BOOL, &[n], track.valid.iter().map(|v| f64::from(u8::from(*v))));
        let state = self.dict([
            ("position", position),
            ("length", size[0]),
            ("width", size[1]),
            ("height", size[2]),
            ("heading", heading),
            ("velocity", velocity),
            ("valid", valid),
        ]);
        let (kind, id) = (self.text(track.kind.name()), self.text(&track.id));
        let length = self.push(Node::Int(n as i64));
        let metadata = self.dict([("track_length", length), ("type", kind), ("object_id", id)]);
        self.dict([("type", kind), ("state", state), ("metadata", metadata)])
    }

    fn light_state(&mut self, state: LightState) -> Id {
        match state {
            LightState::Unknown => self.push(Node::None),
            LightState::Stop => self.text("LANE_STATE_STOP"),
            LightState::Caution => self.text("LANE_STATE_CAUTION"),
            LightState::Go => self.text("LANE_STATE_GO"),
            LightState::FlashingStop => self.text("LANE_STATE_FLASHING_STOP"),
        }
    }

    /// A feature; `signed` are the lanes of a stop sign.
    fn feature(&mut self, map: &Map, feature: &MapFeature, signed: &[&str]) -> Id {
        let kind = self.text(feature.kind.name());
        let points = map.points_of(feature);
        let n = points.len();
        let Some(lane) = &feature.lane else {
            let line = feature.kind.is_edge() || feature.kind.name().starts_with("ROAD_LINE_");
            let key = match (line, n) {
                (true, _) => "polyline",
                (_, 1) => "position",
                _ => "polygon",
            };
            let shape: &[usize] = if key == "position" { &[3] } else { &[n, 3] };
            let points = self.floats(shape, points.iter().flatten().copied());
            if feature.kind == MapKind::StopSign {
                let lanes = self.texts(signed.iter().copied());
                return self.dict([("type", kind), ("lane", lanes), (key, points)]);
            }
            return self.dict([("type", kind), (key, points)]);
        };
        let polyline = self.floats(&[n, 3], points.iter().flatten().copied());
        let width = self.floats(&[lane.width.len(), 2], lane.width.iter().flatten().copied());
        let ids = |list: &[usize]| list.iter().map(|k| map.features[*k].id.clone()).collect::<Vec<_>>();
        let entries = self.texts(ids(&lane.entries).iter().map(String::as_str));
        let exits = self.texts(ids(&lane.exits).iter().map(String::as_str));
        let neighbors = [0, 1].map(|side| self.neighbors(map, &lane.neighbors[side]));
        let boundaries = [0, 1].map(|side| self.boundaries(map, &lane.boundaries[side]));
        let kmh = lane.speed_limit.unwrap_or(0.0) * 3.6;
        let (kmh, mph) = (self.push(Node::Float(kmh)), self.push(Node::Float(kmh / 1.609_344)));
        let interpolating = self.push(Node::Bool(false));
        self.dict([
            ("speed_limit_mph", mph),
            ("speed_limit_kmh", kmh),
            ("type", kind),
            ("polyline", polyline),
            ("interpolating", interpolating),
            ("entry_lanes", entries),
            ("exit_lanes", exits),
            ("left_boundaries", boundaries[0]),
            ("right_boundaries", boundaries[1]),
            ("left_neighbor", neighbors[0]),
            ("right_neighbor", neighbors[1]),
            ("width", width),
        ])
    }

    fn neighbors(&mut self, map: &Map, neighbors: &[Neighbor]) -> Id {
        let items = neighbors
            .iter()
            .map(|n| {
                let id = self.text(&map.features[n.lane].id);
                let [a, b, c, d] =
                    [n.own[0], n.own[1], n.other[0], n.other[1]].map(|index| self.text(&index.to_string()));
                let boundaries = self.push(Node::List(Vec::new()));
                self.dict([
                    ("feature_id", id),
                    ("self_start_index", a),
                    ("self_end_index", b),
                    ("neighbor_start_index", c),
                    ("neighbor_end_index", d),
                    ("boundaries", boundaries),
                ])
            })
            .collect();
        self.push(Node::List(items))
    }

    fn boundaries(&mut self, map: &Map, boundaries: &[Boundary]) -> Id {
        let items = boundaries
            .iter()
            .map(|b| {
                let feature = &map.features[b.feature];
                let (id, kind) = (self.text(&feature.id), self.text(feature.kind.name()));
                let [first, last] = b.own.map(|index| self.text(&index.to_string()));
                self.dict([
                    ("lane_start_index", first),
                    ("lane_end_index", last),
                    ("boundary_type", kind),
                    ("boundary_feature_id", id),
                ])
            })
            .collect();
        self.push(Node::List(items))
    }

    fn metadata(&mut self, scene: &Scene) -> Id {
        let ego = self.text(&scene.ego().id);
        let involved =
            scene.adversary.map(|k| scene.tracks[k].id.as_str()).into_iter().chain([scene.ego().id.as_str()]);
        let interest = self.texts(involved);
        let now = self.push(Node::Int(sage_core::motion::NOW as i64));
        let times = if scene.timestamps.is_empty() {
            (0..scene.frames).map(|f| f as f64 * sage_core::motion::DT).collect()
        } else {
            scene.timestamps.clone()
        };
        let times = self.floats(&[scene.frames], times);
        let [id, dataset, coordinate] =
            [&scene.id[..], PROCEDURAL_DATASET, "waymo"].map(|text| self.text(text));
        let processed = self.push(Node::Bool(false));
        let length = self.push(Node::Int(scene.frames as i64));
        self.dict([
            ("ts", times),
            ("coordinate", coordinate),
            ("metadrive_processed", processed),
            ("sdc_id", ego),
            ("dataset", dataset),
            ("scenario_id", id),
            ("track_length", length),
            ("current_time_index", now),
            ("objects_of_interest", interest),
        ])
    }
}
