//! One road of the file: a reference line with one lane on its right (ASAM OpenDRIVE 1.7, chapters 8 to 10).

use sage_core::{
    geometry::{Point, cross, distance, dot, norm, sub},
    scene::MapKind,
};

use super::{
    CURVE,
    center_line::{CenterLine, TOLERANCE, plane},
    curve::Piece,
    elevation,
    width::RoadMark,
};
use crate::xml::{Xml, rounded};

/// Width of a painted line, metres.
const MARK_WIDTH: f64 = 0.12;
/// km/h in one m/s.
const KMH: f64 = 3.6;

/// What an end of a road is linked to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Joint {
    Open,
    /// The end or start of another road.
    Road {
        id: usize,
        at: &'static str,
    },
    Junction(usize),
}

/// A road to write.
pub(super) struct Road<'l> {
    pub(super) id: usize,
    pub(super) name: &'l str,
    /// The junction of a connecting road.
    pub(super) junction: Option<usize>,
    pub(super) line: &'l CenterLine,
    /// Width to the left and to the right of the line at the start and at the end, metres.
    pub(super) widths: [[f64; 2]; 2],
    /// Links at the start and at the end.
    pub(super) joints: [Joint; 2],
    pub(super) kind: &'l MapKind,
    /// Speed limit, m/s.
    pub(super) speed_limit: Option<f64>,
    /// Marks on the left and on the right.
    pub(super) marks: [RoadMark; 2],
    pub(super) signals: &'l [Signal],
}

/// A traffic light beside a road.
#[derive(Clone, Debug)]
pub(super) struct Signal {
    pub(super) id: usize,
    pub(super) name: String,
    /// Where vehicles stop, if it is known; else the start of the lane.
    pub(super) stop: Option<Point>,
}

impl Road<'_> {
    pub(super) fn write(&self, xml: &mut Xml) {
        let layout = Layout::of(self.line);
        xml.element("road", |xml| {
            xml.integer("id", self.id as i64).text("name", self.name);
            xml.number("length", layout.length(), CURVE);
            xml.integer("junction", self.junction.map_or(-1, |id| id as i64)).text("rule", "RHT");
            self.write_links(xml);
            self.write_type(xml);
            xml.element("planView", |xml| {
                layout.pieces.iter().zip(&layout.along).for_each(|(piece, s)| piece.write(xml, *s));
            });
            elevation::write(xml, &layout.heights(self.line));
            xml.element("lanes", |xml| self.write_lanes(xml, layout.length()));
            if !self.signals.is_empty() {
                xml.element("signals", |xml| {
                    self.signals.iter().for_each(|signal| self.write_signal(xml, signal, &layout));
                });
            }
        });
    }

    fn write_links(&self, xml: &mut Xml) {
        if self.joints == [Joint::Open; 2] {
            return;
        }
        xml.element("link", |xml| {
            for (tag, joint) in ["predecessor", "successor"].into_iter().zip(self.joints) {
                match joint {
                    Joint::Open => {}
                    Joint::Road { id, at } => xml.element(tag, |xml| {
                        xml.text("elementType", "road").integer("elementId", id as i64);
                        xml.text("contactPoint", at);
                    }),
                    Joint::Junction(id) => xml.element(tag, |xml| {
                        xml.text("elementType", "junction").integer("elementId", id as i64);
                    }),
                }
            }
        });
    }

    fn write_type(&self, xml: &mut Xml) {
        let kind = match self.kind {
            MapKind::LaneBike => "bicycle",
            MapKind::LaneFreeway => "motorway",
            _ => "town",
        };
        xml.element("type", |xml| {
            xml.integer("s", 0).text("type", kind);
            if let Some(limit) = self.speed_limit.filter(|limit| *limit > 0.0) {
                xml.element("speed", |xml| {
                    xml.number("max", KMH * limit, 4).text("unit", "km/h");
                });
            }
        });
    }

    fn write_lanes(&self, xml: &mut Xml, length: f64) {
        let [start, end] = self.widths;
        let (width, end_width) = (start[0] + start[1], end[0] + end[1]);
        let linear = |xml: &mut Xml, at: f64, slope: f64| {
            xml.number("a", at, CURVE).number("b", slope, CURVE).integer("c", 0).integer("d", 0);
        };
        // The recorded line is the centre of the lane, so the lane starts half a width to its left.
        xml.element("laneOffset", |xml| {
            xml.integer("s", 0);
            linear(xml, start[0], (end[0] - start[0]) / length);
        });
        xml.element("laneSection", |xml| {
            xml.integer("s", 0);
            xml.nested(&["center", "lane"], |xml| {
                xml.integer("id", 0).text("type", "none").text("level", "false");
                write_mark(xml, self.marks[0]);
            });
            xml.nested(&["right", "lane"], |xml| {
                let kind = if *self.kind == MapKind::LaneBike { "biking" } else { "driving" };
                xml.integer("id", -1).text("type", kind).text("level", "false");
                self.write_lane_links(xml);
                xml.element("width", |xml| {
                    xml.integer("sOffset", 0);
                    linear(xml, width, (end_width - width) / length);
                });
                write_mark(xml, self.marks[1]);
            });
        });
    }

    /// Links to lanes of roads. Lanes at a junction are linked by the junction.
    fn write_lane_links(&self, xml: &mut Xml) {
        let is_road = |joint: &Joint| matches!(joint, Joint::Road { .. });
        if !self.joints.iter().any(is_road) {
            return;
        }
        xml.element("link", |xml| {
            for (tag, joint) in ["predecessor", "successor"].into_iter().zip(&self.joints) {
                if is_road(joint) {
                    xml.element(tag, |xml| {
                        xml.integer("id", -1);
                    });
                }
            }
        });
    }

    fn write_signal(&self, xml: &mut Xml, signal: &Signal, layout: &Layout) {
        xml.element("signal", |xml| {
            let s = signal.stop.map_or(0.0, |stop| layout.nearest(self.line, stop));
            let beside = -self.widths[0][1] - 0.5;
            xml.number("s", s, CURVE).number("t", beside, 3).integer("id", signal.id as i64);
            xml.text("name", &signal.name).text("dynamic", "yes").text("orientation", "+");
            xml.integer("zOffset", 5).text("type", "1000001").text("subtype", "-1");
            xml.text("country", "OpenDRIVE").integer("height", 1).number("width", 0.4, 1);
            xml.element("validity", |xml| {
                xml.integer("fromLane", -1).integer("toLane", -1);
            });
        });
    }
}

fn write_mark(xml: &mut Xml, mark: RoadMark) {
    xml.element("roadMark", |xml| {
        xml.integer("sOffset", 0).text("type", mark.kind).text("color", mark.color);
        xml.number("width", MARK_WIDTH, 2);
    });
}

/// The pieces of a reference line and their distances along it.
struct Layout {
    /// Indices of the points between the pieces.
    kept: Vec<usize>,
    pieces: Vec<Piece>,
    /// Distance of each kept point along the line, metres: the running sum of the written lengths.
    along: Vec<f64>,
}

impl Layout {
    fn of(line: &CenterLine) -> Self {
        let chords = line.kept();
        let mut layout = Self { kept: vec![0], pieces: Vec::with_capacity(chords.len()), along: vec![0.0] };
        // Stretches to come, the next one last.
        let mut stretches: Vec<[usize; 2]> = chords.windows(2).rev().map(|pair| [pair[0], pair[1]]).collect();
        while let Some([from, to]) = stretches.pop() {
            let [start, end] = [from, to].map(|index| plane(line.points[index]));
            let piece = Piece::between(start, end, [line.headings[from], line.headings[to]]);
            // On a long stretch a small error of a heading leads the curve away from the points.
            if leaves_points(&piece, line, [from, to]) {
                let middle = (from + to) / 2;
                stretches.extend([[middle, to], [from, middle]]);
                continue;
            }
            layout.push(line, [from, to], piece);
        }
        layout
    }

    /// Appends a piece. A straight one that goes on in the direction of a straight one before it replaces both: two
    /// would be redundant.
    fn push(&mut self, line: &CenterLine, [mut from, to]: [usize; 2], mut piece: Piece) {
        while let Some(longer) =
            self.pieces.last().and_then(|last| last.extended_by(&piece, plane(line.points[to])))
        {
            let start = self.kept[self.kept.len() - 2];
            if leaves_points(&longer, line, [start, to]) {
                break;
            }
            self.pieces.pop();
            self.kept.pop();
            self.along.pop();
            (from, piece) = (start, longer);
        }
        debug_assert_eq!(self.kept.last(), Some(&from));
        self.kept.push(to);
        self.along.push(rounded(self.length() + piece.length, CURVE));
        self.pieces.push(piece);
    }

    fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// Distance along the road and height of every point. Points within a piece lie where their share of its
    /// polyline puts them.
    fn heights(&self, line: &CenterLine) -> Vec<[f64; 2]> {
        let mut heights = Vec::with_capacity(line.points.len());
        heights.push([0.0, line.points[0][2]]);
        let step = |k: usize| distance(plane(line.points[k - 1]), plane(line.points[k]));
        for (pair, s) in self.kept.windows(2).zip(self.along.windows(2)) {
            let total: f64 = (pair[0] + 1..=pair[1]).map(step).sum();
            let mut sum = 0.0;
            for k in pair[0] + 1..=pair[1] {
                sum += step(k);
                let share = if k == pair[1] { 1.0 } else { sum / total };
                heights.push([s[0] + share * (s[1] - s[0]), line.points[k][2]]);
            }
        }
        heights
    }

    /// Distance along the road of the place nearest to a point.
    fn nearest(&self, line: &CenterLine, to: Point) -> f64 {
        let mut best = (f64::INFINITY, 0.0);
        for (pair, s) in self.kept.windows(2).zip(self.along.windows(2)) {
            let [start, end] = [pair[0], pair[1]].map(|index| plane(line.points[index]));
            let chord = sub(end, start);
            let share = (dot(sub(to, start), chord) / dot(chord, chord)).clamp(0.0, 1.0);
            let at = [start[0] + share * chord[0], start[1] + share * chord[1]];
            let away = distance(at, to);
            if away < best.0 {
                best = (away, s[0] + share * (s[1] - s[0]));
            }
        }
        best.1
    }
}

/// Whether a piece passes one of the points between its ends at more than the tolerance, to the side.
fn leaves_points(piece: &Piece, line: &CenterLine, [from, to]: [usize; 2]) -> bool {
    let place = |k: usize| plane(line.points[k]);
    let chord = sub(place(to), place(from));
    let total: f64 = (from + 1..=to).map(|k| distance(place(k - 1), place(k))).sum();
    let mut sum = 0.0;
    (from + 1..to).any(|k| {
        sum += distance(place(k - 1), place(k));
        let off = cross(chord, sub(piece.at(sum / total), place(k))).abs();
        off > TOLERANCE * norm(chord)
    })
}
