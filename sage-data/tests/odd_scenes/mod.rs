//! Scene files that are odd in many ways at once: each way is a parameter with several values, from public reports on how
//! converters and recorders write scenes. A straight road with traffic, written without this project's writers.

#![allow(dead_code)] // Each test program uses a part of it.

mod pickle;
mod road;

use std::fmt::Write as _;

use pickle::{Value, dict, text};
use road::{Feature, Motion};
use sage_core::seed::Rng;

/// A parameter: its name and its values. The first is the plain one.
pub type Parameter = (&'static str, &'static [&'static str]);

/// All parameters.
pub const PARAMETERS: &[Parameter] = &[
    ("length", &["91", "90", "81", "66", "50", "31", "21", "20", "121"]),
    ("now", &["10", "20", "30", "last"]),
    ("times", &["seconds", "none", "constant", "one-step", "two-steps", "milliseconds", "epoch"]),
    ("format", &["pickle", "pickle-20hz", "json", "json-20hz", "pickle-single"]),
    ("edges", &["boundary", "none", "sidewalk", "guardrail", "median", "at-0-under-35", "4m-above", "open"]),
    (
        "lanes",
        &["linked", "unlinked", "polygons", "none", "short-0", "short-0.05", "short-0.15", "short-0.5"],
    ),
    (
        "lights",
        &[
            "none",
            "names",
            "numbers",
            "number-list",
            "texts",
            "inside-state",
            "odd",
            "odd-length",
            "none-states",
        ],
    ),
    ("level", &["flat", "over-6m", "under-6m", "over-4m", "over-now", "same-speed", "slope"]),
    ("sizes", &["columns", "constants", "absent", "zero", "row", "no-height"]),
    ("ids", &["texts", "integers", "long", "unicode", "slashes"]),
    ("named", &["none", "vehicle", "pedestrian", "cyclist", "cone", "absent"]),
    ("heading", &["right", "flipped-now", "flipped-1s", "ego-at-0", "ego-now", "all-flipped"]),
    ("reversing", &["no", "driveway", "along", "rolls-back", "from-rest"]),
    ("gaps", &["none", "unseen-3s", "flickers", "moving-flickers", "appears", "adversary"]),
    ("standing", &["steady", "spins", "flips", "drifts", "absent"]),
    ("trailer", &["none", "touching", "half-metre", "of-the-ego", "parked"]),
    ("recording", &["on-the-road", "entrance", "over-the-median", "kerb-at-start", "across"]),
    ("frame", &["origin", "turned", "far", "far-and-turned"]),
];

/// A scene by the number of the value of each parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct OddScene {
    values: Vec<usize>,
    /// Seed of the noise.
    pub seed: u64,
}

impl OddScene {
    /// The plain scene.
    pub fn plain() -> Self {
        Self { values: vec![0; PARAMETERS.len()], seed: 0 }
    }

    /// A random scene: each parameter is odd with a probability.
    pub fn draw(rng: &mut Rng, oddness: f64) -> Self {
        let value = |(_, values): &Parameter| {
            if rng.unit() < oddness { rng.below(values.len()) } else { 0 }
        };
        let values = PARAMETERS.iter().map(value).collect();
        Self { values, seed: rng.bits() }
    }

    /// The scene with one value of a parameter.
    pub fn with(mut self, parameter: &str, value: &str) -> Self {
        let number = PARAMETERS.iter().position(|(name, _)| *name == parameter);
        let number = number.unwrap_or_else(|| panic!("no parameter `{parameter}`"));
        let found = PARAMETERS[number].1.iter().position(|known| *known == value);
        self.values[number] = found.unwrap_or_else(|| panic!("`{parameter}` has no value `{value}`"));
        self
    }

    /// The value of a parameter.
    pub fn value(&self, parameter: &str) -> &'static str {
        let mut both = PARAMETERS.iter().zip(&self.values);
        both.find(|((name, _), _)| *name == parameter).map_or("", |((_, values), k)| values[*k])
    }

    fn is(&self, parameter: &str, value: &str) -> bool {
        self.value(parameter) == value
    }

    /// What is odd, for messages.
    pub fn describe(&self) -> String {
        let odd = PARAMETERS.iter().zip(&self.values).filter(|(_, k)| **k > 0);
        odd.map(|((name, values), k)| format!("{name}={}", values[*k])).collect::<Vec<_>>().join(" ")
    }

    /// Number of frames of the file.
    pub fn frames(&self) -> usize {
        self.value("length").parse().unwrap_or(91)
    }

    /// Time between frames, seconds.
    fn step(&self) -> f64 {
        if self.value("format").ends_with("20hz") { 0.05 } else { 0.1 }
    }

    /// The option `--now`, if the scene has those frames.
    pub fn now(&self) -> Option<usize> {
        let at_ten_hertz = ((self.frames() - 1) as f64 * self.step() / 0.1).floor() as usize;
        let now = match self.value("now") {
            "10" => return None,
            "last" => at_ten_hertz,
            number => number.parse().ok()?,
        };
        (10..=at_ten_hertz).contains(&now).then_some(now)
    }

    /// The option `--rate`, if the file has no times and another rate.
    pub fn rate(&self) -> Option<f64> {
        let has_no_times = self.is("format", "json-20hz") || self.is("times", "none") && self.step() < 0.1;
        (has_no_times && self.step() < 0.1).then_some(20.0)
    }

    /// Ending of its file.
    pub fn ending(&self) -> &'static str {
        if self.value("format").starts_with("json") { "json" } else { "pkl" }
    }

    /// The bytes of its file.
    pub fn bytes(&self) -> Vec<u8> {
        if self.ending() == "json" { self.json().into_bytes() } else { pickle::pickle(&self.values()) }
    }

    fn id(&self, name: &str) -> String {
        let number = name.bytes().fold(7u64, |sum, byte| (sum * 31 + u64::from(byte)) % 100_000);
        match self.value("ids") {
            "integers" => number.to_string(),
            "long" => format!("{name}-{}", "x".repeat(300)),
            "unicode" => format!("{name}-é車\u{200b}"),
            "slashes" => format!("../{name}/\\\"<b>"),
            _ => name.to_owned(),
        }
    }

    fn position_in_world(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (offset, angle) = self.frame();
        let (sin, cos) = angle.sin_cos();
        [offset[0] + x * cos - y * sin, offset[1] + x * sin + y * cos]
    }

    fn frame(&self) -> ([f64; 2], f64) {
        match self.value("frame") {
            "turned" => ([0.0; 2], 2.1),
            "far" => ([-8000.0, 33_000.0], 0.0),
            "far-and-turned" => ([9000.0, -120.0], -1.3),
            _ => ([0.0; 2], 0.0),
        }
    }

    fn motions(&self) -> Vec<Motion> {
        let mut rng = Rng::new(self.seed, "odd", "noise");
        road::motions(self, self.frames(), self.step(), &mut rng)
    }

    fn features(&self) -> Vec<Feature> {
        road::features(self)
    }

    // --- as a pickle ---

    fn values(&self) -> Value {
        let single = self.is("format", "pickle-single");
        let motions = self.motions();
        let ids: Vec<String> = motions.iter().map(|motion| self.id(motion.name)).collect();
        let key = |id: &String| match id.parse::<i64>() {
            Ok(number) if self.seed.is_multiple_of(2) => Value::Int(number),
            _ => text(id.clone()),
        };
        let tracks = motions.iter().zip(&ids).map(|(motion, id)| (key(id), self.track(motion, single)));
        let features = self.features();
        let features =
            features.iter().map(|feature| (text(feature.id.clone()), self.feature(feature, single)));
        let mut metadata = vec![
            ("sdc_id", text(ids[0].clone())),
            ("coordinate", text("waymo")),
            ("metadrive_processed", Value::Bool(false)),
            ("current_time_index", Value::Int(10)),
        ];
        if let Some(times) = self.times() {
            metadata.push(("ts", Value::Floats(false, times, 0)));
        }
        let named = match self.value("named") {
            "vehicle" => Some("b"),
            "pedestrian" => Some("person"),
            "cyclist" => Some("bike"),
            "cone" => Some("cone"),
            "absent" => Some("nobody"),
            _ => None,
        };
        if let Some(name) = named {
            metadata.push(("objects_of_interest", Value::List(vec![key(&ids[0]), key(&self.id(name))])));
        }
        dict([
            ("id", text("odd")),
            ("version", text("odd")),
            ("length", Value::Int(self.frames() as i64)),
            ("tracks", Value::Dict(tracks.collect())),
            ("dynamic_map_states", self.lights()),
            ("map_features", Value::Dict(features.collect())),
            ("metadata", dict(metadata)),
        ])
    }

    fn times(&self) -> Option<Vec<f64>> {
        let (n, step) = (self.frames(), self.step());
        let at = |start: f64, unit: f64| (0..n).map(|k| start + unit * step * k as f64).collect();
        let coarse =
            |changes: usize| (0..n).map(|k| 1.5e9 + 128.0 * ((k * (changes + 1)) / n) as f64).collect();
        match self.value("times") {
            "none" => None,
            // Only clocks that say nothing of 10 Hz are read so.
            "constant" if step == 0.1 => Some(vec![1.5e9; n]),
            "one-step" if step == 0.1 => Some(coarse(1)),
            "two-steps" if step == 0.1 => Some(coarse(2)),
            "milliseconds" => Some(at(1000.0, 1e3)),
            "epoch" => Some(at(1.6e9, 1.0)),
            _ => Some(at(0.0, 1.0)),
        }
    }

    fn track(&self, motion: &Motion, single: bool) -> Value {
        let n = motion.poses.len();
        let mut position = Vec::with_capacity(3 * n);
        let (mut velocity, mut heading) = (Vec::with_capacity(2 * n), Vec::with_capacity(n));
        let angle = self.frame().1;
        let (sin, cos) = angle.sin_cos();
        for (k, pose) in motion.poses.iter().enumerate() {
            let seen = motion.valid[k];
            let [x, y] = self.position_in_world(pose.position);
            let [vx, vy] = pose.velocity;
            let numbers = [x, y, motion.height];
            position.extend(numbers.map(|number| if seen { number } else { 0.0 }));
            velocity.extend(if seen { [vx * cos - vy * sin, vx * sin + vy * cos] } else { [0.0; 2] });
            heading.push(if seen { pose.heading + angle } else { 0.0 });
        }
        let mut state = vec![
            ("position", Value::Floats(single, position, 3)),
            ("velocity", Value::Floats(single, velocity, 2)),
            ("heading", Value::Floats(single, heading, 0)),
            ("valid", Value::Bools(motion.valid.clone())),
        ];
        let column = |x: f64| {
            let of_frame = |seen: &bool| if *seen { x } else { 0.0 };
            Value::Floats(single, motion.valid.iter().map(of_frame).collect(), 0)
        };
        let [length, width, height] = motion.size;
        match self.value("sizes") {
            "absent" => {}
            "constants" => {
                let all = [("length", length), ("width", width), ("height", height)];
                state.extend(all.map(|(key, x)| (key, Value::Float(x))));
            }
            "row" => state.push(("size", Value::List([length, width, height].map(Value::Float).to_vec()))),
            "no-height" => state.extend([("length", column(length)), ("width", column(width))]),
            _ => {
                let all = [("length", length), ("width", width), ("height", height)];
                state.extend(all.map(|(key, x)| (key, column(x))));
            }
        }
        dict([("type", text(motion.kind)), ("state", dict(state))])
    }

    fn feature(&self, feature: &Feature, single: bool) -> Value {
        let points = feature.points.iter().flat_map(|[x, y, z]| {
            let [x, y] = self.position_in_world([*x, *y]);
            [x, y, *z]
        });
        let points = Value::Floats(single, points.collect(), 3);
        let mut entries = vec![
            ("type", text(feature.kind)),
            (if feature.is_area { "polygon" } else { "polyline" }, points),
        ];
        if feature.kind.starts_with("LANE") {
            let list = |ids: &[String]| Value::List(ids.iter().map(|id| text(id.clone())).collect());
            entries.extend([
                ("entry_lanes", list(&feature.entries)),
                ("exit_lanes", list(&feature.exits)),
                ("speed_limit_kmh", Value::Int(50)),
            ]);
        }
        dict(entries)
    }

    fn lights(&self) -> Value {
        let n = self.frames();
        let (x, y) = (70.0, -1.75);
        let [x, y] = self.position_in_world([x, y]);
        let (lane, stop) = (road::EGO_LANE, Value::Floats(false, vec![x, y, 0.0], 0));
        let names = |name: &str| Value::List(vec![text(name); n]);
        let beside = |states: Value| {
            dict([
                ("state", dict([("object_state", states)])),
                ("lane", text(lane)),
                ("stop_point", stop.clone()),
            ])
        };
        let red = "LANE_STATE_STOP";
        let light = match self.value("lights") {
            "none" => return Value::Dict(Vec::new()),
            "names" => beside(names(red)),
            "numbers" => beside(Value::Ints(vec![4; n])),
            "number-list" => beside(Value::List(vec![Value::Int(4); n])),
            "texts" => beside(Value::Texts(vec![red.to_owned(); n])),
            "none-states" => beside(Value::List(vec![Value::None; n])),
            "odd" => beside(Value::List(vec![Value::Dict(Vec::new()); n])),
            "odd-length" => beside(Value::List(vec![text(red); n / 2])),
            _ => {
                let points = (0..n).flat_map(|_| [x, y, 0.0]).collect();
                let states = dict([
                    ("object_state", names(red)),
                    ("lane", Value::List(vec![text(lane); n])),
                    ("stop_point", Value::Floats(true, points, 3)),
                ]);
                dict([("state", states)])
            }
        };
        Value::Dict(vec![(text(lane), light)])
    }

    // --- as JSON of GPUDrive ---

    fn json(&self) -> String {
        let angle = self.frame().1;
        let (sin, cos) = angle.sin_cos();
        let motions = self.motions();
        let object = |(number, motion): (usize, &Motion)| {
            let mut out = String::from("{");
            let joined =
                |of: &dyn Fn(usize) -> String| (0..motion.poses.len()).map(of).collect::<Vec<_>>().join(",");
            let position = joined(&|k| {
                let [x, y] = self.position_in_world(motion.poses[k].position);
                format!(r#"{{"x":{x},"y":{y},"z":{}}}"#, motion.height)
            });
            let velocity = joined(&|k| {
                let [x, y] = motion.poses[k].velocity;
                format!(r#"{{"x":{},"y":{}}}"#, x * cos - y * sin, x * sin + y * cos)
            });
            let heading = joined(&|k| (motion.poses[k].heading + angle).to_string());
            let valid = joined(&|k| motion.valid[k].to_string());
            let _ = write!(
                out,
                r#""position":[{position}],"velocity":[{velocity}],"heading":[{heading}],"valid":[{valid}],"#
            );
            let [length, width, height] = motion.size;
            let is_zero = self.is("sizes", "zero") && number > 0;
            match self.value("sizes") {
                "absent" => {}
                _ if is_zero => out += r#""length":0.0,"width":0.0,"height":0.0,"#,
                _ => drop(write!(out, r#""length":{length},"width":{width},"height":{height},"#)),
            }
            let kind = match motion.kind {
                "VEHICLE" => "vehicle",
                "PEDESTRIAN" => "pedestrian",
                "CYCLIST" => "cyclist",
                _ => "other",
            };
            let _ = write!(
                out,
                r#""goalPosition":{{"x":0.0,"y":0.0,"z":0.0}},"type":"{kind}","id":{},"mark_as_expert":false}}"#,
                number + 1
            );
            out
        };
        let objects: Vec<String> = motions.iter().enumerate().map(object).collect();
        let features = self.features();
        let road = |(number, feature): (usize, &Feature)| {
            let points = feature.points.iter().map(|[x, y, z]| {
                let [x, y] = self.position_in_world([*x, *y]);
                format!(r#"{{"x":{x},"y":{y},"z":{z}}}"#)
            });
            let (kind, element) = match feature.kind {
                kind if kind.starts_with("LANE") => ("lane", 2),
                "ROAD_EDGE_MEDIAN" => ("road_edge", 16),
                kind if kind.starts_with("ROAD_EDGE") || kind == "GUARDRAIL" => ("road_edge", 15),
                _ => ("road_line", 12),
            };
            format!(
                r#"{{"geometry":[{}],"type":"{kind}","id":{},"map_element_id":{element}}}"#,
                points.collect::<Vec<_>>().join(","),
                100 + number
            )
        };
        let roads: Vec<String> = features.iter().enumerate().map(road).collect();
        format!(
            r#"{{"name":"odd.json","scenario_id":"odd","objects":[{}],"roads":[{}],"tl_states":{{}},"metadata":{{"sdc_track_index":0,"objects_of_interest":[],"tracks_to_predict":[]}}}}"#,
            objects.join(","),
            roads.join(",")
        )
    }
}
