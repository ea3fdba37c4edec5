//! Sidewalks: closed edges whose inside is not road, whatever the direction of their outline.
//!
//! The inside is off the road whatever its winding, because MetaDrive and ScenarioNet write either. Only closed sidewalks and
//! guard rails are areas; other closed edges may enclose the road.

use super::Map;
use crate::geometry::{Aabb, OrientedBox, Point, cross, sub};

/// One area.
#[derive(Clone, Debug)]
struct Area {
    feature: u32,
    bounds: Aabb,
    /// The outline; the last point repeats the first.
    ring: Vec<Point>,
    /// Mean height of the outline, metres.
    height: f64,
}

/// The sidewalks of a map that are areas.
#[derive(Clone, Debug, Default)]
pub struct Sidewalks(Vec<Area>);

impl Sidewalks {
    /// All areas of a map.
    pub(super) fn of(map: &Map) -> Self {
        let features = map.features.iter().enumerate().filter(|(_, feature)| map.is_sidewalk_area(feature));
        Self(features.map(|(k, feature)| Area::of(k as u32, map.points_of(feature))).collect())
    }

    /// Whether the map has none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Number of the areas whose bounds meet `bounds`, for searches that visit only these.
    pub fn near(&self, bounds: &Aabb) -> Vec<usize> {
        (0..self.0.len()).filter(|k| self.0[*k].bounds.meets(bounds)).collect()
    }

    /// Index of an area's feature in [`Map::features`].
    pub fn feature(&self, area: usize) -> u32 {
        self.0[area].feature
    }

    /// Mean height of an area's outline, metres.
    pub fn height(&self, area: usize) -> f64 {
        self.0[area].height
    }

    /// Whether a point lies inside an area: its outline winds around the point.
    pub fn holds(&self, area: usize, p: Point) -> bool {
        self.0[area].holds(p)
    }

    /// Whether a closed box and a closed area share a point.
    pub fn meets(&self, area: usize, b: &OrientedBox) -> bool {
        let area = &self.0[area];
        area.bounds.meets(&b.aabb())
            && (area.ring.windows(2).any(|pair| b.intersects_segment(pair[0], pair[1]))
                || area.holds(b.center))
    }
}

impl Area {
    fn of(feature: u32, points: &[[f64; 3]]) -> Self {
        let ring: Vec<Point> = points.iter().map(|[x, y, _]| [*x, *y]).collect();
        let height = points.iter().map(|p| p[2]).sum::<f64>() / points.len() as f64;
        Self { feature, bounds: Aabb::of(ring.iter().copied()), ring, height }
    }

    /// Whether the outline winds around a point. Overlapping parts of an outline count once, and a hole that a
    /// cut joins to the outline is outside.
    fn holds(&self, p: Point) -> bool {
        if !self.bounds.meets(&Aabb { min: p, max: p }) {
            return false;
        }
        let turns = self.ring.windows(2).map(|pair| {
            let side = || cross(sub(pair[1], pair[0]), sub(p, pair[0]));
            match (pair[0][1] <= p[1], pair[1][1] <= p[1]) {
                (true, false) if side() > 0.0 => 1,
                (false, true) if side() < 0.0 => -1,
                _ => 0,
            }
        });
        turns.sum::<i32>() != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{MapFeature, MapKind};

    fn sidewalks(kind: &str, ring: &[[f64; 2]]) -> Sidewalks {
        let points: Vec<[f64; 3]> = ring.iter().map(|[x, y]| [*x, *y, 2.0]).collect();
        let range = 0..points.len();
        let feature =
            MapFeature { id: "s".into(), kind: MapKind::from_name(kind), points: range, lane: None };
        Sidewalks::of(&Map { points, features: vec![feature] })
    }

    const SQUARE: [[f64; 2]; 5] = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0], [0.0, 0.0]];
    const LETTER_L: [[f64; 2]; 7] =
        [[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [2.0, 2.0], [2.0, 6.0], [0.0, 6.0], [0.0, 0.0]];
    /// A square of 10 m with a hole of 2 m, which a cut joins to the outline.
    const WITH_HOLE: [[f64; 2]; 11] = [
        [0.0, 0.0],
        [10.0, 0.0],
        [10.0, 10.0],
        [0.0, 10.0],
        [0.0, 0.0],
        [4.0, 4.0],
        [4.0, 6.0],
        [6.0, 6.0],
        [6.0, 4.0],
        [4.0, 4.0],
        [0.0, 0.0],
    ];
    const BOW_TIE: [[f64; 2]; 5] = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0], [0.0, 0.0]];

    #[test]
    fn a_point_inside_is_inside_whatever_the_winding() {
        let cases: [(&[[f64; 2]], Point, bool); 15] = [
            (&SQUARE, [2.0, 1.0], true),
            (&SQUARE, [2.0, 3.5], false),
            (&SQUARE, [-1.0, 1.0], false),
            (&SQUARE, [5.0, 3.0], false),
            (&SQUARE, [0.1, 2.9], true),
            (&LETTER_L, [1.0, 5.0], true),
            (&LETTER_L, [5.0, 1.0], true),
            (&LETTER_L, [4.0, 4.0], false),
            (&LETTER_L, [1.0, 1.0], true),
            (&WITH_HOLE, [5.0, 5.0], false),
            (&WITH_HOLE, [2.0, 8.0], true),
            (&WITH_HOLE, [8.0, 2.0], true),
            (&BOW_TIE, [3.5, 2.0], true),
            (&BOW_TIE, [0.5, 2.0], true),
            (&BOW_TIE, [2.0, 0.5], false),
        ];
        for (ring, p, expected) in cases {
            let backwards: Vec<[f64; 2]> = ring.iter().rev().copied().collect();
            for ring in [ring, &backwards] {
                assert_eq!(sidewalks("ROAD_EDGE_SIDEWALK", ring).holds(0, p), expected, "{ring:?} {p:?}");
            }
        }
    }

    #[test]
    fn a_box_meets_an_area_by_its_outline_or_from_inside() {
        let big: Vec<[f64; 2]> = SQUARE.iter().map(|[x, y]| [10.0 * x, 10.0 * y]).collect();
        let area = sidewalks("ROAD_EDGE_SIDEWALK", &big);
        let car = |x, y| OrientedBox::new([x, y], 0.3, 4.5, 2.0);
        for (x, y, expected) in [
            (20.0, 15.0, true),
            (0.0, 15.0, true),
            (-1.5, 15.0, true),
            (-4.0, 15.0, false),
            (20.0, 33.0, false),
        ] {
            assert_eq!(area.meets(0, &car(x, y)), expected, "{x} {y}");
        }
        assert_eq!(
            (area.near(&car(-4.0, 15.0).aabb()).len(), area.near(&car(1.0, 1.0).aabb()).len()),
            (0, 1)
        );
        assert_eq!((area.feature(0), area.height(0)), (0, 2.0));
    }

    #[test]
    fn only_closed_sidewalks_are_areas() {
        for (kind, ring, expected) in [
            ("ROAD_EDGE_SIDEWALK", &SQUARE[..], true),
            ("GUARDRAIL", &SQUARE[..], true),
            ("ROAD_EDGE_SIDEWALK", &SQUARE[..4], false),
            ("ROAD_EDGE_SIDEWALK", &[[0.0, 0.0], [4.0, 0.0], [0.0, 0.0]][..], false),
            ("ROAD_EDGE_SIDEWALK", &[[0.0, 0.0]][..], false),
            ("ROAD_EDGE_SIDEWALK", &[][..], false),
            ("ROAD_EDGE_BOUNDARY", &SQUARE[..], false),
            ("ROAD_EDGE_MEDIAN", &SQUARE[..], false),
            ("ROAD_EDGE_UNKNOWN", &SQUARE[..], false),
            ("CROSSWALK", &SQUARE[..], false),
        ] {
            assert_eq!(!sidewalks(kind, ring).is_empty(), expected, "{kind} {ring:?}");
        }
    }
}
