//! Widths and road marks of a lane, from what the recording says of its sides.

use sage_core::{
    scene::{Boundary, Lane, Map, MapKind},
    statistics::median,
};

/// Recorded half widths outside this range say nothing, metres.
const PLAUSIBLE: std::ops::Range<f64> = 0.5..3.0;
/// Half width of a lane whose width is unknown, metres.
const UNKNOWN: f64 = 1.75;
/// Half width of a bike lane whose width is unknown, metres.
const UNKNOWN_BIKE: f64 = 0.9;

/// Width to the left and to the right of the centre line, metres: the median of the plausible widths on each
/// side. Widths of single points are not used, because they jump where a neighbour starts or ends.
pub(super) fn halves(lane: &Lane, is_bike: bool) -> [f64; 2] {
    [0, 1].map(|side| {
        let widths = lane.width.iter().map(|widths| widths[side]);
        let plausible: Vec<f64> =
            widths.filter(|width| *width > PLAUSIBLE.start && *width < PLAUSIBLE.end).collect();
        median(&plausible).unwrap_or(if is_bike { UNKNOWN_BIKE } else { UNKNOWN })
    })
}

/// Type and colour of a road mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RoadMark {
    pub(super) kind: &'static str,
    pub(super) color: &'static str,
}

impl RoadMark {
    /// No mark.
    pub(super) const NONE: Self = Self { kind: "none", color: "standard" };

    /// The mark of the longest boundary on one side of a lane.
    pub(super) fn of(map: &Map, boundaries: &[Boundary]) -> Self {
        let span = |boundary: &Boundary| boundary.own[1].saturating_sub(boundary.own[0]);
        // Of several equally long ones the first.
        let longest = boundaries.iter().rev().max_by_key(|boundary| span(boundary));
        let feature = longest.and_then(|boundary| map.features.get(boundary.feature));
        feature.map_or(Self::NONE, |feature| Self::of_kind(&feature.kind))
    }

    fn of_kind(kind: &MapKind) -> Self {
        let MapKind::Line(name) = kind else {
            let curb = Self { kind: "curb", color: "standard" };
            return if kind.is_edge() { curb } else { Self::NONE };
        };
        let name = name.strip_prefix("ROAD_LINE_").unwrap_or(name);
        let (kind, color) = match name {
            "BROKEN_SINGLE_WHITE" => ("broken", "white"),
            "SOLID_SINGLE_WHITE" => ("solid", "white"),
            "SOLID_DOUBLE_WHITE" => ("solid solid", "white"),
            "BROKEN_SINGLE_YELLOW" => ("broken", "yellow"),
            "BROKEN_DOUBLE_YELLOW" => ("broken broken", "yellow"),
            "SOLID_SINGLE_YELLOW" => ("solid", "yellow"),
            "SOLID_DOUBLE_YELLOW" => ("solid solid", "yellow"),
            "PASSING_DOUBLE_YELLOW" => ("solid broken", "yellow"),
            _ => return Self::NONE,
        };
        Self { kind, color }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn implausible_widths_are_left_out_of_the_median() {
        let width = vec![[0.0, 1.5], [1.8, 40.0], [1.6, 1.7], [1.9, -1.0]];
        let lane = Lane { width, ..Lane::default() };
        assert_eq!(halves(&lane, false), [1.8, 1.6]);
        assert_eq!(halves(&Lane::default(), false), [UNKNOWN; 2]);
        assert_eq!(halves(&Lane::default(), true), [UNKNOWN_BIKE; 2]);
    }

    #[test]
    fn lines_have_their_mark_and_edges_are_curbs() {
        let line = MapKind::from_name("ROAD_LINE_PASSING_DOUBLE_YELLOW");
        assert_eq!(RoadMark::of_kind(&line), RoadMark { kind: "solid broken", color: "yellow" });
        assert_eq!(RoadMark::of_kind(&MapKind::EdgeMedian).kind, "curb");
        assert_eq!(RoadMark::of_kind(&MapKind::LaneFreeway), RoadMark::NONE);
    }
}
