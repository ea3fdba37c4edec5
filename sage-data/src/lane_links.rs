//! Links between lanes for maps that have none.
//!
//! A lane leads into another one if it ends where the other begins, in about the same direction and at the same height.
//! Maps in which any lane has a link are left as they are: what they do not link is not linked.

use std::collections::HashMap;

use sage_core::{
    geometry::{Point, distance, wrap_angle},
    scene::{Map, MapKind},
};

/// Largest distance between the end of a lane and the start of the next, metres. Lanes of one map end within
/// centimetres of each other; those beside each other are at least 2 m apart.
const GAP: f64 = 0.5;
/// Largest difference of the headings, radians: a coarse curve turns by less between two points, a crossing by more.
const TURN: f64 = 30.0 * std::f64::consts::PI / 180.0;
/// Largest difference of the heights, metres: less than a bridge has.
const STEP: f64 = 2.0;
/// Length over which the heading of an end is measured, metres: nearer points are noise.
const REACH: f64 = 1.0;
/// Most lanes that follow one lane, and most starts that one place is searched for.
const MOST: usize = 16;

/// An end of a lane.
#[derive(Clone, Copy)]
struct End {
    at: [f64; 3],
    heading: f64,
}

/// Adds the links that the lanes' ends give, if the map has no link, and a note.
pub(crate) fn derive(map: &mut Map, notes: &mut Vec<String>) {
    let mut lanes = map.features.iter().filter_map(|feature| feature.lane.as_deref());
    if lanes.any(|lane| !lane.entries.is_empty() || !lane.exits.is_empty()) {
        return;
    }
    let links = links(map);
    if links.is_empty() {
        return;
    }
    for [from, to] in &links {
        if let Some(lane) = map.features[*from].lane.as_deref_mut() {
            lane.exits.push(*to);
        }
        if let Some(lane) = map.features[*to].lane.as_deref_mut() {
            lane.entries.push(*from);
        }
    }
    let words = if links.len() == 1 { "1 link is" } else { &format!("{} links are", links.len()) };
    notes.push(format!(
        "the map has no links between lanes; {words} derived from lanes that end within {GAP} m of the start of another"
    ));
}

/// Pairs of a lane and one that follows it, by feature.
fn links(map: &Map) -> Vec<[usize; 2]> {
    let lanes: Vec<(usize, [End; 2])> = map
        .features
        .iter()
        .enumerate()
        .filter(|(_, feature)| feature.lane.is_some())
        .filter_map(|(k, feature)| Some((k, ends(map.points_of(feature))?)))
        .collect();
    let cell = |p: Point| p.map(|x| (x / GAP).floor() as i64);
    let mut starts: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
    for (number, (_, [start, _])) in lanes.iter().enumerate() {
        starts.entry(cell(plane(start.at))).or_default().push(number);
    }
    let is_bike = |k: usize| map.features[k].kind == MapKind::LaneBike;
    let mut links = Vec::new();
    for (from, [_, end]) in &lanes {
        let [x, y] = cell(plane(end.at));
        let near = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| [x, y]));
        let near = near.filter_map(|cell| starts.get(&cell)).flat_map(|numbers| numbers.iter().take(MOST));
        let mut next: Vec<usize> = near
            .map(|number| &lanes[*number])
            .filter(|(to, [start, _])| to != from && is_bike(*to) == is_bike(*from) && end.leads_into(start))
            .map(|(to, _)| *to)
            .collect();
        next.sort_unstable();
        links.extend(next.into_iter().take(MOST).map(|to| [*from, to]));
    }
    links
}

impl End {
    fn leads_into(&self, start: &Self) -> bool {
        distance(plane(self.at), plane(start.at)) <= GAP
            && (self.at[2] - start.at[2]).abs() <= STEP
            && wrap_angle(start.heading - self.heading).abs() <= TURN
    }
}

fn plane([x, y, _]: [f64; 3]) -> Point {
    [x, y]
}

/// Start and end of a line; `None` if it has no length.
fn ends(points: &[[f64; 3]]) -> Option<[End; 2]> {
    let (first, last) = (*points.first()?, *points.last()?);
    // The first point far enough from the end, or the farthest of a short line.
    let away = |from: [f64; 3], line: &mut dyn Iterator<Item = &[f64; 3]>| {
        let mut best: Option<([f64; 3], f64)> = None;
        for point in line {
            let apart = distance(plane(from), plane(*point));
            if apart > best.map_or(0.0, |(_, least)| least) {
                best = Some((*point, apart));
            }
            if apart >= REACH {
                break;
            }
        }
        best.map(|(point, _)| point)
    };
    let second = away(first, &mut points.iter().skip(1))?;
    let before = away(last, &mut points.iter().rev().skip(1))?;
    let heading = |from: [f64; 3], to: [f64; 3]| (to[1] - from[1]).atan2(to[0] - from[0]);
    let start = End { at: first, heading: heading(first, second) };
    Some([start, End { at: last, heading: heading(before, last) }])
}
