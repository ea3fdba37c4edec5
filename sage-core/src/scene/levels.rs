//! Levels: whether a road passes above another one, and which of them a road user is on.
//!
//! Levels come from the map. Heights of road users alone say nothing, because many files have none; a map on which something
//! passes 3 m above something else does. Heights are followed only where two boxes meet in the plane.

use std::{cell::OnceCell, collections::HashMap};

use super::{Map, Track};

/// Height difference above which two objects are on different levels, metres.
pub const LEVEL_GAP: f64 = 3.0;

/// Width of a cell of the plane, metres. On a slope of 10 % heights in a cell differ by less than 1.2 m.
const CELL: f64 = 8.0;
/// Largest number of sampled points; segments longer than expected are then sampled more coarsely.
const MOST: f64 = 1e6;

/// Whether heights of the ground (metres) are those of one level.
pub fn is_one_level(a: f64, b: f64) -> bool {
    (a - b).abs() <= LEVEL_GAP
}

/// Tells road users of a map apart that are on different levels. On a map with one level nobody is: there heights may be
/// missing or mean nothing.
pub struct Levels<'m> {
    map: &'m Map,
    has_levels: OnceCell<bool>,
}

impl<'m> Levels<'m> {
    /// Those of a map, which is looked at when two heights differ.
    pub fn of(map: &'m Map) -> Self {
        Self { map, has_levels: OnceCell::new() }
    }

    /// Whether two heights of the ground (metres) belong to different levels.
    pub fn differ(&self, a: f64, b: f64) -> bool {
        !is_one_level(a, b) && *self.has_levels.get_or_init(|| largest_step(self.map) > LEVEL_GAP)
    }

    /// Whether two road users are on different levels at a frame at which both are valid.
    pub fn differ_at(&self, frame: usize, a: &Track, b: &Track) -> bool {
        self.differ(a.ground(frame), b.ground(frame))
    }
}

/// Greatest difference of the heights in one cell of the plane, metres; 0 for an empty map.
pub(super) fn largest_step(map: &Map) -> f64 {
    let (lo, hi) = span(map.points.iter().map(|p| p[2]));
    // The common case of a level map needs no cells.
    if hi - lo <= f64::EPSILON {
        return 0.0;
    }
    let segments = || map.features.iter().flat_map(|f| map.points[f.points.clone()].windows(2));
    let total: f64 = segments().map(|pair| length(pair[0], pair[1])).sum();
    let spacing = (0.5 * CELL).max(total / MOST);
    let mut cells: HashMap<[i64; 2], [f64; 2]> = HashMap::new();
    for pair in segments() {
        let count = (length(pair[0], pair[1]) / spacing).ceil().max(1.0);
        for k in 0..=count as usize {
            let share = k as f64 / count;
            let [x, y, z] = [0, 1, 2].map(|axis| pair[0][axis] + share * (pair[1][axis] - pair[0][axis]));
            let cell = [x, y].map(|at| (at / CELL).floor() as i64);
            let heights = cells.entry(cell).or_insert([z, z]);
            *heights = [heights[0].min(z), heights[1].max(z)];
        }
    }
    cells.values().map(|[lo, hi]| hi - lo).fold(0.0, f64::max)
}

fn span(heights: impl Iterator<Item = f64>) -> (f64, f64) {
    heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), z| (lo.min(z), hi.max(z)))
}

fn length(a: [f64; 3], b: [f64; 3]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{MapFeature, MapKind};

    fn map(lines: &[[[f64; 3]; 2]]) -> Map {
        let mut map = Map::default();
        for (k, line) in lines.iter().enumerate() {
            map.points.extend(line);
            let points = 2 * k..2 * k + 2;
            let kind = MapKind::EdgeBoundary;
            map.features.push(MapFeature { id: k.to_string(), kind, points, lane: None });
        }
        map
    }

    #[test]
    fn a_bridge_is_a_level_and_a_slope_is_not() {
        let road = [[-100.0, 3.0, 0.0], [100.0, 3.0, 0.0]];
        assert_eq!(largest_step(&map(&[])), 0.0);
        assert_eq!(largest_step(&map(&[road])), 0.0);
        let slope = [[0.0, 3.0, 0.0], [200.0, 3.0, 20.0]];
        assert!(largest_step(&map(&[slope])) < 1.2);
        let bridge = [[3.0, -100.0, 6.0], [3.0, 100.0, 6.0]];
        assert_eq!(largest_step(&map(&[road, bridge])), 6.0);
    }
}
