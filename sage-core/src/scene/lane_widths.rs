//! How wide lanes are: distances from their centre lines to the lines and edges that bound them.
//!
//! Recorded widths are not used: converters measure them between points of the same number, and are wrong by tens of metres where a line
//! has other points than the lane.

use super::{Lane, Map};
use crate::geometry::{SegmentIndex, distance};

/// Lines farther than this bound no lane, metres.
const REACH: f64 = 10.0;

/// Distance from each point of a lane to what bounds it on the left and on the right, metres; `None` where nothing does.
pub type LaneWidths = Vec<[Option<f64>; 2]>;

/// The widths of all features of a map; empty for those that are no lanes.
pub(super) fn lane_widths(map: &Map) -> Vec<LaneWidths> {
    let lanes = || map.features.iter().filter_map(|feature| feature.lane.as_deref());
    let mut bounds = vec![false; map.features.len()];
    for boundary in lanes().flat_map(|lane| lane.boundaries.iter().flatten()) {
        if let Some(is_bound) = bounds.get_mut(boundary.feature) {
            *is_bound = true;
        }
    }
    let lines = map.features.iter().enumerate().filter(|(k, _)| bounds[*k]);
    let index = SegmentIndex::build(lines.map(|(k, feature)| (k as u32, map.points_of(feature))));
    let of = |points: &[[f64; 3]], lane: &Lane| -> LaneWidths {
        let width = |k: usize, side: usize| {
            let mut here =
                lane.boundaries[side].iter().filter(|bound| (bound.own[0]..=bound.own[1]).contains(&k));
            // Where two meet, the first.
            let feature = here.next()?.feature;
            let point = [points[k][0], points[k][1]];
            let nearest = index.nearest(point, REACH, |segment| segment.feature as usize == feature)?;
            Some(distance(point, index.segments()[nearest.segment].at(nearest.share)))
        };
        (0..points.len()).map(|k| [width(k, 0), width(k, 1)]).collect()
    };
    let of_feature = |feature: &super::MapFeature| {
        feature.lane.as_deref().map_or_else(Vec::new, |lane| of(map.points_of(feature), lane))
    };
    map.features.iter().map(of_feature).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Boundary, MapFeature, MapKind};

    #[test]
    fn widths_are_distances_to_what_bounds_the_lane_there() {
        let mut map = Map::default();
        let mut add = |id: &str, kind, line: &[[f64; 2]], lane: Option<Lane>| {
            let first = map.points.len();
            map.points.extend(line.iter().map(|[x, y]| [*x, *y, 0.0]));
            let points = first..map.points.len();
            map.features.push(MapFeature { id: id.into(), kind, points, lane: lane.map(Box::new) });
        };
        // The lines have fewer points than the lane, and one is far away.
        let boundaries =
            [vec![Boundary { feature: 1, own: [0, 1] }], vec![Boundary { feature: 2, own: [0, 2] }]];
        let lane = Lane { boundaries, ..Lane::default() };
        add("lane", MapKind::LaneSurfaceStreet, &[[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]], Some(lane));
        add("left", MapKind::EdgeBoundary, &[[-5.0, 1.8], [30.0, 1.8]], None);
        add("right", MapKind::EdgeBoundary, &[[-5.0, -1.7], [12.0, -1.7], [20.0, -30.0]], None);
        let widths = lane_widths(&map);
        assert_eq!(widths[0][0], [Some(1.8), Some(1.7)]);
        assert_eq!(widths[0][1], [Some(1.8), Some(1.7)]);
        assert_eq!(widths[0][2][0], None, "nothing bounds it there");
        assert!(widths[0][2][1].is_some_and(|width| width > 3.0));
        assert!(widths[1].is_empty());
        assert_eq!(lane_widths(&Map::default()), Vec::<LaneWidths>::new());
    }
}
