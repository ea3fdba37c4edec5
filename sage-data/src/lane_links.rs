//! Links between lanes for maps that have none.
//!
//! A lane leads into another one if it ends where the other begins, in about the same direction and at the same height.
//! Maps in which any lane has a link are left as they are: what they do not link is not linked.

use std::collections::HashMap;

use sage_core::{
    geometry::{Point, distance, wrap_angle},
    scene::Note,
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
pub(crate) fn derive(map: &mut Map, notes: &mut Vec<Note>) {
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
    let how = format!("from lanes that end within {GAP} m of the start of another");
    notes.push(Note::derived_links(links.len(), &how));
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

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::scene::{Lane, MapFeature};

    fn map(lanes: &[(&str, &[[f64; 3]])]) -> Map {
        let mut map = Map::default();
        for (k, (kind, line)) in lanes.iter().enumerate() {
            let first = map.points.len();
            map.points.extend(*line);
            let kind = MapKind::from_name(kind);
            let lane = kind.is_lane().then(Box::<Lane>::default);
            map.features.push(MapFeature { id: k.to_string(), kind, points: first..map.points.len(), lane });
        }
        map
    }

    const STREET: &str = "LANE_SURFACE_STREET";
    /// A lane of 20 m along x that ends at the origin.
    const FIRST: [[f64; 3]; 3] = [[-20.0, 0.0, 0.0], [-10.0, 0.0, 0.0], [0.0, 0.0, 0.0]];

    /// A lane of 10 m that starts at a place, with a heading in degrees.
    fn from([x, y, z]: [f64; 3], degrees: f64) -> Vec<[f64; 3]> {
        let (sin, cos) = degrees.to_radians().sin_cos();
        (0..=5).map(|k| 2.0 * f64::from(k)).map(|s| [x + s * cos, y + s * sin, z]).collect()
    }

    #[test]
    fn a_lane_leads_into_those_that_start_at_its_end_in_its_direction() {
        let cases: [(&str, [f64; 3], f64, bool); 20] = [
            ("LANE_SURFACE_STREET", [0.0, 0.0, 0.0], 0.0, true),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 0.0], 29.0, true),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 0.0], -29.0, true),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 0.0], 31.0, false),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 0.0], 90.0, false),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 0.0], 180.0, false),
            ("LANE_SURFACE_STREET", [0.4, 0.0, 0.0], 0.0, true),
            ("LANE_SURFACE_STREET", [-0.4, 0.0, 0.0], 0.0, true),
            ("LANE_SURFACE_STREET", [0.3, 0.3, 0.0], 0.0, true),
            ("LANE_SURFACE_STREET", [0.4, 0.4, 0.0], 0.0, false),
            ("LANE_SURFACE_STREET", [0.0, 0.6, 0.0], 0.0, false),
            ("LANE_SURFACE_STREET", [0.0, 3.5, 0.0], 0.0, false),
            ("LANE_SURFACE_STREET", [-10.0, 0.0, 0.0], 0.0, false),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 1.0], 0.0, true),
            ("LANE_SURFACE_STREET", [0.0, 0.0, 6.0], 0.0, false),
            ("LANE_FREEWAY", [0.0, 0.0, 0.0], 0.0, true),
            ("LANE_SURFACE_UNSTRUCTURE", [0.0, 0.0, 0.0], 0.0, true),
            ("LANE_BIKE_LANE", [0.0, 0.0, 0.0], 0.0, false),
            ("ROAD_LINE_SOLID_SINGLE_WHITE", [0.0, 0.0, 0.0], 0.0, false),
            ("CROSSWALK", [0.0, 0.0, 0.0], 0.0, false),
        ];
        for (kind, start, degrees, expected) in cases {
            let mut map = map(&[(STREET, &FIRST), (kind, &from(start, degrees))]);
            let mut notes = Vec::new();
            derive(&mut map, &mut notes);
            let exits = |k: usize| map.features[k].lane.as_deref().map(|lane| lane.exits.clone());
            let what = format!("{kind} {start:?} {degrees}");
            assert_eq!(exits(0), Some(if expected { vec![1] } else { vec![] }), "{what}");
            assert_eq!(notes.len(), usize::from(expected), "{what}");
            let entries = map.features[1].lane.as_deref().map(|lane| &lane.entries[..]).unwrap_or_default();
            assert_eq!(entries == [0], expected, "{what}");
        }
    }

    #[test]
    fn a_fork_and_a_merge_have_all_their_links() {
        let (left, right) = (from([0.0, 0.0, 0.0], 20.0), from([0.0, 0.1, 0.0], -20.0));
        let after: Vec<[f64; 3]> = from([left[5][0], left[5][1], 0.0], 10.0);
        let mut map = map(&[(STREET, &after), (STREET, &left), (STREET, &FIRST), (STREET, &right)]);
        let mut notes = Vec::new();
        derive(&mut map, &mut notes);
        let lane = |k: usize| map.features[k].lane.as_deref().unwrap();
        assert_eq!(
            (&lane(2).exits[..], &lane(1).exits[..], &lane(3).exits[..]),
            (&[1, 3][..], &[0][..], &[][..])
        );
        assert_eq!((&lane(0).entries[..], &lane(3).entries[..]), (&[1][..], &[2][..]));
        assert!(
            matches!(notes[0], Note::DerivedLinks(_)) && notes[0].text().contains("3 links"),
            "{notes:?}"
        );
    }

    #[test]
    fn a_map_with_a_link_and_lanes_without_length_are_left_as_they_are() {
        let next = from([0.0, 0.0, 0.0], 0.0);
        let mut linked = map(&[(STREET, &FIRST), (STREET, &next), (STREET, &next)]);
        linked.features[0].lane.as_deref_mut().unwrap().exits = vec![1];
        let before = linked.clone();
        let mut notes = Vec::new();
        derive(&mut linked, &mut notes);
        assert_eq!((linked, notes.len()), (before, 0));
        // A single point, points in one place, a lane that ends where it starts.
        let point = [[0.0, 0.0, 0.0]];
        let still = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]];
        let ring = [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 9.0, 0.0], [0.0, 0.0, 0.0]];
        for other in [&point[..], &still, &ring] {
            let mut map = map(&[(STREET, &FIRST), (STREET, other)]);
            derive(&mut map, &mut notes);
            assert_eq!(map.features[0].lane.as_deref().unwrap().exits.len(), usize::from(other.len() == 4));
            assert!(map.features[1].lane.as_deref().unwrap().exits.is_empty());
        }
        // Noise at the joint does not hide the direction.
        let noisy = [[0.0, 0.0, 0.0], [-0.02, 0.03, 0.0], [5.0, 0.0, 0.0]];
        let mut map = map(&[(STREET, &FIRST), (STREET, &noisy)]);
        derive(&mut map, &mut notes);
        assert_eq!(map.features[0].lane.as_deref().unwrap().exits, [1]);
    }
}
