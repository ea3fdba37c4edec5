//! Invented files for tests: a straight road with an ego, a car, and a person beside the road, recorded at any rate.

use std::{path::Path, sync::Arc};

use sage_core::scene::{
    AdversaryOrigin, LightState, Map, MapFeature, MapKind, Scene, Track, TrackKind, TrafficLight,
};

use super::Decoded;
use crate::{
    Error, ReadOptions, Recording, metadrive,
    pickle::{Array, Document, Dtype, ElementKind, Id, Node},
};

const F64: Dtype = Dtype { kind: ElementKind::Float, size: 8, big_endian: false };

/// A file that can be changed before it is read.
pub(crate) struct Made {
    pub(crate) document: Document,
    pub(crate) scene: Scene,
}

/// Motion of a track: position, heading and velocity at a time.
pub(crate) type Path2 = fn(f64) -> ([f64; 2], f64, [f64; 2]);

/// 10 m/s along +x.
pub(crate) fn straight(time: f64) -> ([f64; 2], f64, [f64; 2]) {
    ([10.0 * time, -1.75], 0.0, [10.0, 0.0])
}

/// 10 m/s along +x in the lane to the right, 15 m behind.
pub(crate) fn beside(time: f64) -> ([f64; 2], f64, [f64; 2]) {
    ([10.0 * time - 15.0, -5.25], 0.0, [10.0, 0.0])
}

/// From 6 m/s on with 1 m/s², one lane to the right and behind.
pub(crate) fn speeding_up(time: f64) -> ([f64; 2], f64, [f64; 2]) {
    ([6.0 * time + 0.5 * time * time - 20.0, -5.25], 0.0, [6.0 + time, 0.0])
}

/// A circle of 20 m at 8 m/s; its heading passes ±π.
pub(crate) fn circle(time: f64) -> ([f64; 2], f64, [f64; 2]) {
    let angle = 8.0 * time / 20.0;
    let heading = sage_core::geometry::wrap_angle(angle + std::f64::consts::FRAC_PI_2);
    ([20.0 * angle.cos() + 60.0, 20.0 * angle.sin()], heading, [-8.0 * angle.sin(), 8.0 * angle.cos()])
}

fn standing(_: f64) -> ([f64; 2], f64, [f64; 2]) {
    ([50.0, 9.0], 1.0, [0.0, 0.0])
}

fn track(id: &str, kind: TrackKind, path: Path2, times: &[f64], size: [f64; 3]) -> Track {
    let states: Vec<_> = times.iter().map(|time| path(*time)).collect();
    Track {
        id: id.to_owned(),
        kind,
        position: states.iter().map(|([x, y], ..)| [*x, *y, 0.5]).collect(),
        heading: states.iter().map(|(_, heading, _)| *heading).collect(),
        velocity: states.iter().map(|(.., velocity)| *velocity).collect(),
        size: vec![size; times.len()],
        valid: vec![true; times.len()],
    }
}

impl Made {
    /// A file with frames at some times; `car` is the path of the other car.
    pub(crate) fn at(times: &[f64], car: Path2) -> Self {
        let line = |y: f64| [[-60.0, y, 0.0], [200.0, y, 0.0]];
        let kinds = [MapKind::LaneSurfaceStreet, MapKind::LaneSurfaceStreet, MapKind::EdgeBoundary];
        let points: Vec<[f64; 3]> = [-1.75, -5.25, -7.5].into_iter().flat_map(line).collect();
        let feature = |(k, kind): (usize, MapKind)| MapFeature {
            id: k.to_string(),
            lane: kind.is_lane().then(Default::default),
            kind,
            points: 2 * k..2 * k + 2,
        };
        let map = Map { points, features: kinds.into_iter().enumerate().map(feature).collect() };
        let size = [4.6, 1.9, 1.6];
        let states =
            (0..times.len()).map(|f| if 2 * f < times.len() { LightState::Stop } else { LightState::Go });
        let scene = Scene {
            id: "made".to_owned(),
            frames: times.len(),
            timestamps: times.to_vec(),
            tracks: vec![
                track("ego", TrackKind::Vehicle, straight, times, size),
                track("car", TrackKind::Vehicle, car, times, size),
                track("person", TrackKind::Pedestrian, standing, times, [0.7, 0.7, 1.8]),
            ]
            .into(),
            map: Arc::new(map),
            lights: vec![TrafficLight { lane: "0".to_owned(), stop_point: None, states: states.collect() }],
            ego: 0,
            adversary: Some(1),
            adversary_origin: AdversaryOrigin::File,
            notes: Vec::new(),
            held: Vec::new(),
        };
        let mut made = Self { document: metadrive::fresh(&scene), scene };
        // 64-bit columns, so that laws can be tested tightly.
        for track in made.scene.tracks.clone() {
            let flat = |rows: &[[f64; 3]]| rows.iter().flatten().copied().collect::<Vec<_>>();
            let n = times.len();
            made.set_array(&track.id, "position", &[n, 3], &flat(&track.position));
            made.set_array(&track.id, "velocity", &[n, 2], track.velocity.as_flattened());
            made.set_array(&track.id, "heading", &[n], &track.heading);
        }
        let times = made.array(&[times.len()], times);
        made.set_metadata("ts", times);
        made
    }

    /// A file at a frame rate that lasts some seconds.
    pub(crate) fn lasting(seconds: f64, step: f64, car: Path2) -> Self {
        let count = (seconds / step).round() as usize + 1;
        Self::at(&(0..count).map(|frame| frame as f64 * step).collect::<Vec<_>>(), car)
    }

    pub(crate) fn array(&mut self, shape: &[usize], values: &[f64]) -> Id {
        let data = self.document.push_bytes(&F64.write(values.iter().copied()));
        let shape = shape.iter().map(|n| *n as u32).collect();
        self.document.push(Node::Array(Box::new(Array {
            dtype: F64,
            shape,
            fortran: false,
            from_buffer: false,
            data,
        })))
    }

    fn under_root(&self, keys: &[&str]) -> Id {
        let get = |id, key: &&str| self.document.get(id, key).unwrap_or_else(|| panic!("no `{key}`"));
        keys.iter().fold(self.document.root(), get)
    }

    /// Sets a value in the metadata.
    pub(crate) fn set_metadata(&mut self, key: &str, value: Id) {
        let metadata = self.under_root(&["metadata"]);
        self.document.set(metadata, key, value);
    }

    /// Removes a value from the metadata.
    pub(crate) fn without_metadata(mut self, key: &str) -> Self {
        let none = self.document.push(Node::None);
        self.set_metadata(key, none);
        self
    }

    /// Sets a number in the metadata.
    pub(crate) fn with_number(mut self, key: &str, value: f64) -> Self {
        let value = self.document.push(Node::Float(value));
        self.set_metadata(key, value);
        self
    }

    /// Sets a value of the state of a track.
    pub(crate) fn set(&mut self, track: &str, key: &str, value: Id) {
        let state = self.under_root(&["tracks", track, "state"]);
        self.document.set(state, key, value);
    }

    /// Sets a column of a track.
    pub(crate) fn set_array(&mut self, track: &str, key: &str, shape: &[usize], values: &[f64]) {
        let array = self.array(shape, values);
        self.set(track, key, array);
    }

    /// Changes one number of a column of a track.
    pub(crate) fn with_value(mut self, track: &str, key: &str, index: usize, value: f64) -> Self {
        let column = self.under_root(&["tracks", track, "state", key]);
        let Node::Array(array) = self.document.node(column).clone() else { panic!("`{key}` is no array") };
        let mut values: Vec<f64> = array.dtype.read(self.document.bytes(array.data)).collect();
        values[index] = value;
        let shape: Vec<usize> = array.shape.iter().map(|n| *n as usize).collect();
        self.set_array(track, key, &shape, &values);
        self
    }

    /// Gives a track another type name.
    pub(crate) fn with_type(mut self, track: &str, name: &str) -> Self {
        let text = self.document.push_bytes(name.as_bytes());
        let text = self.document.push(Node::Str(text));
        let track = self.under_root(&["tracks", track]);
        self.document.set(track, "type", text);
        self
    }

    /// Removes a column of a track.
    pub(crate) fn without(mut self, track: &str, key: &str) -> Self {
        let none = self.document.push(Node::None);
        self.set(track, key, none);
        self
    }

    /// Reads it.
    pub(crate) fn read_as(&self, options: &ReadOptions) -> Result<Decoded, Error> {
        metadrive::decode(&self.parsed(), options, Path::new("made.pkl"))
    }

    /// Reads it with default options.
    pub(crate) fn read(&self) -> Result<Scene, Error> {
        self.read_as(&ReadOptions::default()).map(|decoded| decoded.scene)
    }

    /// Reads it from its bytes.
    pub(crate) fn recording(&self, options: &ReadOptions) -> Recording {
        Recording::from_bytes_as(Path::new("made.pkl"), self.document.to_pickle(), options)
            .expect("it is a scene")
    }

    fn parsed(&self) -> Document {
        Document::parse(self.document.to_pickle()).expect("it is a pickle")
    }
}
