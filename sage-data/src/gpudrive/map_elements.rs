//! Types of roads: `type` and `map_element_id` of a file, and the words of MetaDrive. The ids are those of Waymax.

use crate::womd::{LANE_TYPES, ROAD_LINE_TYPES};

/// Roads of a type, whose ids follow one another from `first`.
struct Type {
    name: &'static str,
    first: i64,
    /// Words of MetaDrive, by id.
    words: &'static [&'static str],
    /// Word for another id.
    other: &'static str,
    /// Key of the points in MetaDrive values.
    points: &'static str,
}

const LINE: &str = "polyline";
const AREA: &str = "polygon";

const TYPES: [Type; 7] = [
    Type { name: "lane", first: 0, words: &LANE_TYPES, other: "LANE_UNKNOWN", points: LINE },
    Type { name: "road_line", first: 5, words: &ROAD_LINE_TYPES, other: "UNKNOWN", points: LINE },
    Type {
        name: "road_edge",
        first: 14,
        words: &["ROAD_EDGE_UNKNOWN", "ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN"],
        other: "ROAD_EDGE_BOUNDARY",
        points: LINE,
    },
    Type { name: "stop_sign", first: 17, words: &["STOP_SIGN"], other: "STOP_SIGN", points: "position" },
    Type { name: "crosswalk", first: 18, words: &["CROSSWALK"], other: "CROSSWALK", points: AREA },
    Type { name: "speed_bump", first: 19, words: &["SPEED_BUMP"], other: "SPEED_BUMP", points: AREA },
    Type { name: "driveway", first: 20, words: &["DRIVEWAY"], other: "DRIVEWAY", points: AREA },
];

/// Word and key of the points of a road; `None` for a type that is not known. `true` if its id is not one of the type.
pub(super) fn read(name: &str, id: Option<i64>) -> Option<(&'static str, &'static str, bool)> {
    let found = TYPES.iter().find(|one| one.name == name)?;
    let word = id.and_then(|id| found.words.get(usize::try_from(id.checked_sub(found.first)?).ok()?));
    // The old dialect gives driveways −1.
    let is_odd = id.is_some() && word.is_none() && (name, id) != ("driveway", Some(-1));
    Some((word.unwrap_or(&found.other), found.points, is_odd))
}

/// Type and id of a map feature by its word; `None` for a word that the format does not have.
///
/// What has no type at all (`UNKNOWN`) is a road line there.
pub(super) fn written(word: &str, is_edge: bool, is_lane: bool) -> Option<(&'static str, i64)> {
    let at = |found: &'static Type| {
        let position = found.words.iter().position(|known| *known == word);
        position.map(|position| (found.name, found.first + position as i64))
    };
    let [lane, line, edge, ..] = &TYPES;
    // The first id of these is that of an unknown type.
    let first = |of: &'static Type| Some((of.name, of.first));
    match (is_lane, is_edge, word.starts_with("ROAD_LINE_")) {
        (true, ..) => at(lane).or_else(|| first(lane)),
        (_, true, _) => at(edge).or_else(|| first(edge)),
        (.., true) => at(line).or_else(|| first(line)),
        _ => TYPES.iter().find_map(at),
    }
}

/// Whether the format has a word for a kind of its own, not the one for unknown ones.
pub(super) fn has(word: &str) -> bool {
    TYPES.iter().any(|one| one.words.contains(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_those_of_waymax() {
        assert_eq!(read("lane", Some(2)), Some(("LANE_SURFACE_STREET", "polyline", false)));
        assert_eq!(read("road_line", Some(12)), Some(("ROAD_LINE_SOLID_DOUBLE_YELLOW", "polyline", false)));
        assert_eq!(read("road_edge", Some(16)), Some(("ROAD_EDGE_MEDIAN", "polyline", false)));
        assert_eq!(read("driveway", Some(-1)), Some(("DRIVEWAY", "polygon", false)));
        assert_eq!(read("lane", Some(15)), Some(("LANE_UNKNOWN", "polyline", true)));
        assert_eq!(read("road_edge", None), Some(("ROAD_EDGE_BOUNDARY", "polyline", false)));
        assert_eq!(read("tunnel", Some(1)), None);
    }

    #[test]
    fn what_is_written_is_read_again() {
        for one in &TYPES {
            for (id, word) in (one.first..).zip(one.words) {
                let found = written(word, one.name == "road_edge", one.name == "lane");
                assert_eq!(found, Some((one.name, id)), "{word}");
                assert_eq!(read(one.name, Some(id)), Some((*word, one.points, false)));
            }
        }
        assert_eq!(written("ROAD_LINE_DOTTED", false, false), Some(("road_line", 5)));
        assert_eq!(written("SIDEWALK", false, false), None);
    }
}
