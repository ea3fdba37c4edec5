//! Coarse grid of the edges around a target, for a fast contact test of thousands of trajectories.

use sage_core::{
    geometry::{Aabb, Point, SegmentIndex},
    scene::SceneIndex,
};
use serde::{Deserialize, Serialize};

use super::Frame;

/// Map features that bound the road in the features of a network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EdgeKinds {
    /// Road boundaries, as in the paper's feasibility rule.
    #[default]
    Boundaries,
    /// Road boundaries and medians.
    All,
}

impl EdgeKinds {
    /// The edges of a map.
    pub fn of(self, index: &SceneIndex) -> &SegmentIndex {
        match self {
            Self::Boundaries => index.boundaries(),
            Self::All => index.edges(),
        }
    }
}

/// Width of a cell, metres.
const CELL: f32 = 0.5;
/// Distance from the target to each side of the grid, metres.
const REACH: f32 = 128.0;
/// Cells per side.
const CELLS: usize = (2.0 * REACH / CELL) as usize;

/// Width of a coarse cell, metres.
const COARSE: f32 = 2.0;
/// Coarse cells per side.
const COARSE_CELLS: usize = (2.0 * REACH / COARSE) as usize;

/// Grid with one bit per cell: whether an edge passes through the cell.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeGrid {
    bits: Vec<u64>,
    /// For each coarse cell, whether an edge passes within `ring` coarse cells, along and across.
    near: Vec<bool>,
    ring: usize,
}

impl EdgeGrid {
    /// A grid without any edge.
    pub fn empty() -> Self {
        Self { bits: Vec::new(), near: Vec::new(), ring: 0 }
    }

    /// A grid without marked cells.
    fn blank(ring: usize) -> Self {
        Self { bits: vec![0; CELLS * CELLS / 64], near: vec![false; COARSE_CELLS * COARSE_CELLS], ring }
    }

    /// The edges around a frame, for boxes whose corners are `box_reach` metres from their centre.
    pub(super) fn around(edges: &SegmentIndex, frame: &Frame, box_reach: f32) -> Self {
        let mut grid = Self::blank(((box_reach / COARSE) as usize).min(COARSE_CELLS) + 1);
        // The rotated square lies within its circumscribed circle.
        let reach = Aabb::around(frame.origin(), f64::from(REACH) * std::f64::consts::SQRT_2);
        for run in edges.near(&reach) {
            for segment in &edges.segments()[run] {
                grid.mark(frame.frame_from_world(segment.a), frame.frame_from_world(segment.b));
            }
        }
        grid
    }

    fn mark(&mut self, a: Point, b: Point) {
        let is_beside = |k: usize| a[k].max(b[k]) < f64::from(-REACH) || a[k].min(b[k]) > f64::from(REACH);
        if is_beside(0) || is_beside(1) {
            return;
        }
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let length = (dx * dx + dy * dy).sqrt();
        // Of a very long segment, only the part near the target can be inside.
        let reach = f64::from(REACH) * 1.5;
        let (mut from, mut to) = (0.0, length);
        if length > 4.0 * reach {
            let foot = -(a[0] * dx + a[1] * dy) / length;
            (from, to) = ((foot - reach).max(0.0), (foot + reach).min(length));
        }
        let mut t = from;
        while t <= to {
            let share = if length > 0.0 { t / length } else { 0.0 };
            if let Some(cell) = cell((a[0] + share * dx) as f32, (a[1] + share * dy) as f32) {
                self.set(cell);
            }
            t += 0.5 * f64::from(CELL);
        }
    }

    fn set(&mut self, cell: usize) {
        let (word, bit) = (cell / 64, 1 << (cell % 64));
        if self.bits[word] & bit != 0 {
            return;
        }
        self.bits[word] |= bit;
        let [i, j] = [cell / CELLS, cell % CELLS].map(|k| k / (CELLS / COARSE_CELLS));
        let around = |k: usize| k.saturating_sub(self.ring)..(k + self.ring + 1).min(COARSE_CELLS);
        for i in around(i) {
            self.near[i * COARSE_CELLS..][around(j)].fill(true);
        }
    }

    /// Whether an edge may lie under a box with this centre.
    #[inline]
    pub fn is_near(&self, x: f32, y: f32) -> bool {
        let [i, j] = [(x + REACH) / COARSE, (y + REACH) / COARSE];
        // Also for centres outside the grid, because a long vehicle may extend into it.
        let last = COARSE_CELLS as f32 - 1.0;
        let cell = i.clamp(0.0, last) as usize * COARSE_CELLS + j.clamp(0.0, last) as usize;
        self.near.get(cell).is_some_and(|near| *near)
    }

    /// Whether an edge passes through the cell of a position.
    #[inline]
    pub fn holds(&self, x: f32, y: f32) -> bool {
        cell(x, y)
            .is_some_and(|cell| self.bits.get(cell / 64).is_some_and(|bits| bits & (1 << (cell % 64)) != 0))
    }

    /// The grid of the mirrored scene.
    pub(super) fn mirrored(&self) -> Self {
        if self.bits.is_empty() {
            return self.clone();
        }
        let mut mirror = Self::blank(self.ring);
        for cell in (0..CELLS * CELLS).filter(|cell| self.bits[cell / 64] & (1 << (cell % 64)) != 0) {
            let other = cell / CELLS * CELLS + (CELLS - 1 - cell % CELLS);
            mirror.set(other);
        }
        mirror
    }
}

#[inline]
fn cell(x: f32, y: f32) -> Option<usize> {
    let [i, j] = [(x + REACH) / CELL, (y + REACH) / CELL];
    let inside = i >= 0.0 && j >= 0.0 && i < CELLS as f32 && j < CELLS as f32;
    inside.then(|| i as usize * CELLS + j as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::scene::{Map, MapFeature, MapKind};
    use std::sync::Arc;

    #[test]
    fn boundaries_mark_their_cells_also_in_the_mirrored_grid() {
        let points = vec![[-3e6, 5.2, 0.0], [3e6, 5.2, 0.0]];
        let feature = MapFeature { id: "e".into(), kind: MapKind::EdgeBoundary, points: 0..2, lane: None };
        let index = SceneIndex::new(Arc::new(Map { points, features: vec![feature] }));
        let grid = EdgeGrid::around(EdgeKinds::All.of(&index), &Frame::new([0.0, 0.0], 0.0), 3.0);
        for x in [-100.0, 0.0, 77.3] {
            assert!(grid.holds(x, 5.3) && !grid.holds(x, 4.4) && !grid.holds(x, -5.3));
            assert!(grid.mirrored().holds(x, -5.3) && !grid.mirrored().holds(x, 5.3));
        }
        assert!(grid.is_near(0.0, 2.3) && grid.is_near(0.0, 8.2) && !grid.is_near(0.0, -3.0));
        assert!(![f32::NAN, 1e9, -128.1].iter().any(|x| grid.holds(*x, 5.3)));
        assert!(!EdgeGrid::empty().holds(0.0, 5.3));
    }
}
