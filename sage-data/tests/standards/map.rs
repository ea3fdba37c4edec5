//! A reader of road networks for tests: reference lines, lane borders and links.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use sage_core::geometry::Point;

use super::xml::Element;

/// A road with one lane on the right.
#[derive(Debug)]
pub struct Road {
    pub id: String,
    pub name: String,
    /// The junction of a connecting road.
    pub junction: Option<String>,
    pub length: f64,
    pub pieces: Vec<Piece>,
    /// Start, height and slope of each piece of the elevation.
    pub elevation: Vec<[f64; 3]>,
    /// Offset of the lane's left border at the start, and its slope.
    pub offset: [f64; 2],
    /// Width of the lane at the start, and its slope.
    pub width: [f64; 2],
    pub predecessor: Option<Link>,
    pub successor: Option<Link>,
    /// Whether the lane has links to a lane before and after.
    pub lane_links: [bool; 2],
}

/// An end of a link between roads.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    pub to_junction: bool,
    pub id: String,
    pub contact: Option<String>,
}

/// A piece of a reference line.
#[derive(Debug)]
pub struct Piece {
    pub s: f64,
    pub length: f64,
    start: Point,
    heading: f64,
    /// Coefficients of u and v; none of a straight line.
    cubic: Option<[[f64; 4]; 2]>,
}

impl Piece {
    fn of(geometry: &Element) -> Self {
        let cubic = geometry.child("paramPoly3").map(|curve| {
            assert_eq!(curve.at("pRange"), "normalized");
            [["aU", "bU", "cU", "dU"], ["aV", "bV", "cV", "dV"]].map(|names| names.map(|k| curve.number(k)))
        });
        assert!(cubic.is_some() || geometry.child("line").is_some());
        Self {
            s: geometry.number("s"),
            length: geometry.number("length"),
            start: [geometry.number("x"), geometry.number("y")],
            heading: geometry.number("hdg"),
            cubic,
        }
    }

    /// Place and direction at a share of the piece.
    pub fn at(&self, p: f64) -> (Point, f64) {
        let straight = [[0.0, self.length, 0.0, 0.0], [0.0; 4]];
        let [u, v] = self
            .cubic
            .unwrap_or(straight)
            .map(|[a, b, c, d]| [a + p * (b + p * (c + p * d)), b + p * (2.0 * c + 3.0 * p * d)]);
        let (sin, cos) = self.heading.sin_cos();
        let place = [self.start[0] + u[0] * cos - v[0] * sin, self.start[1] + u[0] * sin + v[0] * cos];
        (place, self.heading + v[1].atan2(u[1]))
    }

    /// Length of a fine polyline through the piece.
    pub fn measured(&self) -> f64 {
        let steps = 500;
        let at = |k: i32| self.at(f64::from(k) / f64::from(steps)).0;
        (0..steps).map(|k| gap(at(k), at(k + 1))).sum()
    }
}

impl Road {
    fn of(road: &Element) -> Self {
        let side = |tag| road.find(&["link", tag]).map(Link::of);
        let lane = road.find(&["lanes", "laneSection", "right", "lane"]).unwrap();
        assert_eq!((lane.at("id"), road.at("rule")), ("-1", "RHT"));
        let linear = |element: &Element| [element.number("a"), element.number("b")];
        let elevation = road.child("elevationProfile").unwrap().all("elevation");
        Self {
            id: road.at("id").to_owned(),
            name: road.at("name").to_owned(),
            junction: Some(road.at("junction")).filter(|id| *id != "-1").map(str::to_owned),
            length: road.number("length"),
            pieces: road.child("planView").unwrap().all("geometry").map(Piece::of).collect(),
            elevation: elevation.map(|e| ["s", "a", "b"].map(|name| e.number(name))).collect(),
            offset: linear(road.find(&["lanes", "laneOffset"]).unwrap()),
            width: linear(lane.child("width").unwrap()),
            predecessor: side("predecessor"),
            successor: side("successor"),
            lane_links: ["predecessor", "successor"].map(|tag| {
                let link = lane.find(&["link", tag]);
                assert!(link.is_none_or(|link| link.at("id") == "-1"));
                link.is_some()
            }),
        }
    }

    /// The borders of the lane at the start or at the end, left and right.
    pub fn borders(&self, at_end: bool) -> [Point; 2] {
        let (piece, p, s) = match at_end {
            false => (&self.pieces[0], 0.0, 0.0),
            true => (self.pieces.last().unwrap(), 1.0, self.length),
        };
        let ([x, y], heading) = piece.at(p);
        let left = self.offset[0] + self.offset[1] * s;
        let right = left - self.width[0] - self.width[1] * s;
        [left, right].map(|t| [x - t * heading.sin(), y + t * heading.cos()])
    }

    /// Height at the start or at the end.
    pub fn height(&self, at_end: bool) -> f64 {
        let s = if at_end { self.length } else { 0.0 };
        let [from, height, slope] = if at_end { *self.elevation.last().unwrap() } else { self.elevation[0] };
        height + slope * (s - from)
    }

    /// Places along the reference line, about ten a metre.
    pub fn line(&self) -> Vec<Point> {
        let sample = |piece: &Piece| -> Vec<Point> {
            let steps = (10.0 * piece.length).ceil().max(2.0);
            (0..=steps as usize).map(|k| piece.at(k as f64 / steps).0).collect()
        };
        self.pieces.iter().flat_map(sample).collect()
    }
}

impl Link {
    fn of(link: &Element) -> Self {
        Self {
            to_junction: link.at("elementType") == "junction",
            id: link.at("elementId").to_owned(),
            contact: link.get("contactPoint").map(str::to_owned),
        }
    }
}

/// A connection of a junction.
#[derive(Debug)]
pub struct Connection {
    pub incoming: String,
    pub connecting: String,
    pub contact: String,
    pub links_lanes: bool,
}

/// A road network.
#[derive(Debug)]
pub struct Network {
    pub roads: BTreeMap<String, Road>,
    pub junctions: BTreeMap<String, Vec<Connection>>,
    /// Ids of signals, and the road and place of each.
    pub signals: BTreeMap<String, (String, f64)>,
}

impl Network {
    pub fn of(root: &Element) -> Self {
        let roads = root.all("road").filter(|road| road.at("name") != "no lanes").map(Road::of);
        let connection = |c: &Element| Connection {
            incoming: c.at("incomingRoad").to_owned(),
            connecting: c.at("connectingRoad").to_owned(),
            contact: c.at("contactPoint").to_owned(),
            links_lanes: c.child("laneLink").is_some_and(|l| (l.at("from"), l.at("to")) == ("-1", "-1")),
        };
        let junction = |j: &Element| (j.at("id").to_owned(), j.all("connection").map(connection).collect());
        let signals = root.all("road").flat_map(|road| {
            let signals = road.child("signals").into_iter().flat_map(|signals| signals.all("signal"));
            signals.map(|s| (s.at("id").to_owned(), (road.at("id").to_owned(), s.number("s"))))
        });
        Self {
            roads: roads.map(|road| (road.id.clone(), road)).collect(),
            junctions: root.all("junction").map(junction).collect(),
            signals: signals.collect(),
        }
    }

    /// The lanes that follow each lane, by name: walks successors, directly or over a connecting road.
    pub fn links(&self) -> BTreeSet<(String, String)> {
        let mut links = BTreeSet::new();
        let roads = self.roads.values().filter(|road| road.junction.is_none());
        for road in roads {
            let Some(next) = &road.successor else { continue };
            let mut followers = vec![&next.id];
            if next.to_junction {
                let through = self.junctions[&next.id].iter().filter(|c| c.incoming == road.id);
                let after = |c: &Connection| &self.roads[&c.connecting].successor.as_ref().unwrap().id;
                followers =
                    self.junctions[&next.id].iter().filter(|c| c.incoming == road.id).map(after).collect();
                assert_eq!(followers.len(), through.count());
            }
            links.extend(followers.iter().map(|id| (road.name.clone(), self.roads[*id].name.clone())));
        }
        links
    }
}

/// What can be reached from a lane over links, the lane included.
pub fn reachable(from: &str, links: &BTreeSet<(String, String)>) -> BTreeSet<String> {
    let mut followers: HashMap<&str, Vec<&str>> = HashMap::new();
    links.iter().for_each(|(a, b)| followers.entry(a).or_default().push(b));
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(lane) = open.pop() {
        if reached.insert(lane.to_owned()) {
            open.extend(followers.get(lane).into_iter().flatten());
        }
    }
    reached
}

pub fn gap(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
