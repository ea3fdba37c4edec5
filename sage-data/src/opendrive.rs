//! The map of a scene as an ASAM OpenDRIVE 1.7 road network.
//!
//! A recorded map holds the centre lines of lanes and which lane follows which. Each lane becomes a road with
//! one lane, whose centre is the recorded line:
//!
//! - The reference line consists of straight lines and cubic curves. They pass the recorded points within 3 cm.
//! - Two lanes that have only each other at their ends are joined directly. All other links pass through a
//!   junction: the first 2 m of the later lane become one connecting road per link.
//! - A traffic light is a signal beside the lane that it controls.
//!
//! Recorded maps do not say which lanes form a carriageway. One road per lane keeps every line and link, at the price of lane
//! changes.
//!
//! A map without links has those that the ends of its lanes give, with a note.
//!
//! Not written: neighbours as lane changes, crosswalks, speed bumps and road edges. [`RoadNetwork::notes`]
//! names lanes, links and lights that are left out.

mod center_line;
mod curve;
mod elevation;
mod lanes;
mod links;
mod road;
mod simplify;
mod width;

use std::collections::HashMap;

use sage_core::{scene::Note, scene::Scene};

use crate::xml::{Xml, number_text};
use center_line::{COORDINATE, CenterLine, plane};
use lanes::RoadLane;
use links::Link;
use road::{Joint, Road, Signal};
use width::RoadMark;

/// Decimals of lengths, headings and coefficients. Numbers are rounded before others are computed from them,
/// so the file is consistent far below the tolerances of readers.
const CURVE: usize = 9;
/// Id of the first junction; more if there are as many roads.
const FIRST_JUNCTION: usize = 100_001;

/// A road network that a scenario refers to.
///
/// ```
/// use sage_data::{opendrive::RoadNetwork, procedural};
///
/// let scene = procedural::generate(procedural::Kind::FourWay, 1, 0).ok_or("no scene for this seed")?;
/// let [x, y] = scene.ego().point(10);
/// let network = RoadNetwork::of(&scene, [x.round(), y.round(), 0.0], None);
/// assert!(network.xml.contains("<OpenDRIVE>"));
/// // The name is a hash of the content: scenes on one map share the file.
/// assert_eq!(network.file_name(), RoadNetwork::of(&scene, [x.round(), y.round(), 0.0], None).file_name());
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct RoadNetwork {
    /// The OpenDRIVE file.
    pub xml: String,
    /// `map-` and 16 hex digits, a hash of the file: scenes with equal maps, lights and origins share it.
    pub name: String,
    /// What is left out, in words.
    pub notes: Vec<String>,
    /// Point of the scene's world frame that is the origin of the file, metres.
    pub origin: [f64; 3],
    /// For each light of the scene the id of its signal; `None` if its lane is left out.
    pub signals: Vec<Option<usize>>,
}

impl RoadNetwork {
    /// The road network of a scene's map and lights, relative to an origin (world frame, metres).
    ///
    /// `license` is the notice that the file carries, if it needs one. The result depends on nothing else.
    pub fn of(scene: &Scene, origin: [f64; 3], license: Option<&str>) -> Self {
        let map = &*scene.map;
        let derived = scene.notes.iter().filter(|note| matches!(note, Note::DerivedLinks(_)));
        let mut notes: Vec<String> = derived.map(Note::to_string).collect();
        let (mut lanes, written) = lanes::collect(map, origin, &mut notes);
        let junctions = links::join(map, &mut lanes, &written, &mut notes);
        let (placed, signals) = place_signals(scene, origin, &lanes, &mut notes);
        let points: usize = lanes.iter().map(|lane| lane.line.points.len()).sum();
        // Measured on recorded maps: up to 80 bytes a point, and 1000 bytes a road.
        let mut xml = Xml::with_capacity(4096 + 80 * points + 1500 * lanes.len());
        xml.element("OpenDRIVE", |xml| {
            write_header(xml, &lanes, origin, license);
            Network { scene, lanes: &lanes, signals: &placed }.write(xml, &junctions, &mut notes);
            notes.iter().for_each(|note| write_user_data(xml, "sage:note", note));
        });
        let xml = xml.finish();
        let name = format!("map-{}", &blake3::hash(xml.as_bytes()).to_hex()[..16]);
        Self { xml, name, notes, origin, signals }
    }

    /// Name of the file that scenarios refer to.
    pub fn file_name(&self) -> String {
        format!("{}.xodr", self.name)
    }
}

/// The origin as text: three numbers.
pub(crate) fn origin_text(origin: [f64; 3]) -> String {
    origin.map(|x| number_text(x, COORDINATE)).join(" ")
}

fn write_header(xml: &mut Xml, lanes: &[RoadLane], origin: [f64; 3], license: Option<&str>) {
    let mut bounds: Option<[[f64; 2]; 2]> = None;
    for point in lanes.iter().flat_map(|lane| &lane.line.points) {
        let [x, y] = plane(*point);
        let [low, high] = bounds.unwrap_or([[x, y]; 2]);
        bounds = Some([[low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)]]);
    }
    let [[west, south], [east, north]] = bounds.unwrap_or_default();
    xml.element("header", |xml| {
        xml.integer("revMajor", 1).integer("revMinor", 7).text("name", "").text("version", "1.00");
        xml.number("north", north, COORDINATE).number("south", south, COORDINATE);
        xml.number("east", east, COORDINATE).number("west", west, COORDINATE).text("vendor", "sage");
        write_user_data(xml, "sage:origin", &origin_text(origin));
        license.into_iter().for_each(|notice| write_user_data(xml, "sage:license", notice));
    });
}

fn write_user_data(xml: &mut Xml, code: &str, value: &str) {
    xml.element("userData", |xml| {
        xml.text("code", code).text("value", value);
    });
}

/// Signals by written lane, and the id of each light's signal.
fn place_signals(
    scene: &Scene,
    origin: [f64; 3],
    lanes: &[RoadLane],
    notes: &mut Vec<String>,
) -> (Vec<Vec<Signal>>, Vec<Option<usize>>) {
    let id_of = |lane: &RoadLane| scene.map.features[lane.feature].id.as_str();
    let by_id: HashMap<&str, usize> = lanes.iter().enumerate().map(|(k, lane)| (id_of(lane), k)).collect();
    let mut placed = vec![Vec::new(); lanes.len()];
    let signals = scene.lights.iter().enumerate().map(|(k, light)| {
        let Some(&lane) = by_id.get(light.lane.as_str()) else {
            notes.push(format!("light of lane `{}`: left out, the map has no such road", light.lane));
            return None;
        };
        let stop = light.stop_point.map(|[x, y, _]| [x - origin[0], y - origin[1]]);
        placed[lane].push(Signal { id: k + 1, name: format!("light of lane {}", light.lane), stop });
        Some(k + 1)
    });
    let signals = signals.collect();
    (placed, signals)
}

/// The parts of a network on their way into the file.
struct Network<'n> {
    scene: &'n Scene,
    lanes: &'n [RoadLane<'n>],
    signals: &'n [Vec<Signal>],
}

impl Network<'_> {
    fn write(&self, xml: &mut Xml, junctions: &[Vec<Link>], notes: &mut Vec<String>) {
        if self.lanes.is_empty() {
            notes.push("the map has no lane; the file holds a road of 1 m without lanes".to_owned());
            write_placeholder(xml);
        }
        let connections: usize = junctions.iter().map(Vec::len).sum();
        let mut first_junction = FIRST_JUNCTION;
        while first_junction <= self.lanes.len() + connections {
            first_junction *= 10;
        }
        for lane in 0..self.lanes.len() {
            self.write_lane(xml, lane, first_junction);
        }
        let mut id = self.lanes.len();
        for (junction, links) in junctions.iter().enumerate() {
            for link in links {
                id += 1;
                self.write_connecting_road(xml, id, first_junction + junction, *link);
            }
        }
        let mut id = self.lanes.len();
        for (junction, links) in junctions.iter().enumerate() {
            xml.element("junction", |xml| {
                xml.integer("id", (first_junction + junction) as i64);
                xml.text("name", &format!("junction {}", junction + 1));
                for (number, [from, _]) in links.iter().enumerate() {
                    id += 1;
                    write_connection(xml, number, from + 1, id);
                }
            });
        }
    }

    fn name(&self, lane: usize) -> &str {
        &self.scene.map.features[self.lanes[lane].feature].id
    }

    fn write_lane(&self, xml: &mut Xml, index: usize, first_junction: usize) {
        let lane = &self.lanes[index];
        let joint = |road: Option<usize>, junction: Option<usize>, at| match (road, junction) {
            (Some(lane), _) => Joint::Road { id: lane + 1, at },
            (None, Some(junction)) => Joint::Junction(first_junction + junction),
            (None, None) => Joint::Open,
        };
        let road = Road {
            id: index + 1,
            name: self.name(index),
            junction: None,
            line: &lane.line,
            widths: [lane.start, lane.end],
            joints: [
                joint(lane.previous_road, lane.previous_junction, "end"),
                joint(lane.next_road, lane.next_junction, "start"),
            ],
            kind: lane.kind,
            speed_limit: lane.recorded.speed_limit,
            marks: [0, 1].map(|side| RoadMark::of(&self.scene.map, &lane.recorded.boundaries[side])),
            signals: &self.signals[index],
        };
        road.write(xml);
    }

    fn write_connecting_road(&self, xml: &mut Xml, id: usize, junction: usize, link: Link) {
        let [from, to] = link.map(|lane| &self.lanes[lane]);
        let road = Road {
            id,
            name: &format!("{} to {}", self.name(link[0]), self.name(link[1])),
            junction: Some(junction),
            line: &CenterLine::connecting(&from.line, &to.line),
            widths: [from.end, to.start],
            joints: [
                Joint::Road { id: link[0] + 1, at: "end" },
                Joint::Road { id: link[1] + 1, at: "start" },
            ],
            kind: to.kind,
            speed_limit: to.recorded.speed_limit,
            marks: [RoadMark::NONE; 2],
            signals: &[],
        };
        road.write(xml);
    }
}

fn write_connection(xml: &mut Xml, number: usize, incoming: usize, connecting: usize) {
    xml.element("connection", |xml| {
        xml.integer("id", number as i64).integer("incomingRoad", incoming as i64);
        xml.integer("connectingRoad", connecting as i64).text("contactPoint", "start");
        xml.element("laneLink", |xml| {
            xml.integer("from", -1).integer("to", -1);
        });
    });
}

/// The road that a map without lanes consists of, because the standard wants at least one.
fn write_placeholder(xml: &mut Xml) {
    xml.element("road", |xml| {
        xml.integer("id", 1).text("name", "no lanes").integer("length", 1).integer("junction", -1);
        xml.nested(&["planView", "geometry"], |xml| {
            xml.integer("s", 0).integer("x", 0).integer("y", 0).integer("hdg", 0).integer("length", 1);
            xml.element("line", |_| {});
        });
        xml.nested(&["lanes", "laneSection"], |xml| {
            xml.integer("s", 0);
            xml.nested(&["center", "lane"], |xml| {
                xml.integer("id", 0).text("type", "none").text("level", "false");
            });
        });
    });
}
