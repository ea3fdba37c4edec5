//! A lattice around the target that stores the lane of each cell.

use sage_core::{
    geometry::Point,
    scene::{Map, Scene},
};

use super::{Frame, Routes};
use crate::nn::wide;

/// Spacing of the lattice, metres.
pub const CELL: f64 = 2.0;
/// A cell lies on a lane if its centre is within this distance of the centre line, metres.
pub const LANE_REACH: f64 = 2.0;
/// Spacing of the points along a lane that are compared with cells, metres.
const SPACING: f64 = 1.0;
/// Added to the squared distance of lanes that the target cannot reach, metres squared.
const DETOUR: f32 = 4.0;

/// A cell's position relative to its lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct OnLane {
    /// Rank among the lanes of a cell: squared distance, plus [`DETOUR`] for unreachable lanes.
    rank: f32,
    /// Index of the lane's map feature.
    pub lane: u32,
    /// Distance along the lane, metres.
    pub along: f32,
    /// Distance left of the centre line, metres.
    pub offset: f32,
    /// Direction of the lane in the target frame.
    pub direction: [f32; 2],
}

/// The lattice `CELL · (i, j)` over a rectangle of the target frame.
pub(super) struct Grid {
    min: [i32; 2],
    size: [i32; 2],
    cells: Vec<OnLane>,
    /// Cells that lie on a lane, in the order in which they were marked.
    marked: Vec<u32>,
}

const EMPTY: OnLane =
    OnLane { rank: f32::INFINITY, lane: u32::MAX, along: 0.0, offset: 0.0, direction: [1.0, 0.0] };

impl Grid {
    /// A lattice over x from `min[0]` to `max[0]` and y from `min[1]` to `max[1]`, metres.
    pub(super) fn new(min: Point, max: Point) -> Self {
        let first = min.map(|m| (m / CELL).ceil() as i32);
        let last = max.map(|m| (m / CELL).floor() as i32);
        let size = [(last[0] - first[0] + 1).max(0), (last[1] - first[1] + 1).max(0)];
        let cells = vec![EMPTY; size[0] as usize * size[1] as usize];
        Self { min: first, size, cells, marked: Vec::new() }
    }

    /// Index of a lattice point, if it is inside.
    pub(super) fn index(&self, [i, j]: [i32; 2]) -> Option<usize> {
        let [a, b] = [i - self.min[0], j - self.min[1]];
        let inside = a >= 0 && b >= 0 && a < self.size[0] && b < self.size[1];
        inside.then(|| a as usize * self.size[1] as usize + b as usize)
    }

    /// The cell around a position, if it is inside and on a lane.
    pub(super) fn at(&self, position: Point) -> Option<&OnLane> {
        let cell = self.index(position.map(|x| (x / CELL).round() as i32))?;
        Some(&self.cells[cell]).filter(|on| on.rank.is_finite())
    }

    /// The lattice point of an index.
    pub(super) fn point(&self, index: usize) -> [i32; 2] {
        let columns = self.size[1] as usize;
        [self.min[0] + (index / columns) as i32, self.min[1] + (index % columns) as i32]
    }

    /// A cell's position relative to its lane, if it is on one.
    pub(super) fn cell(&self, index: usize) -> Option<&OnLane> {
        Some(&self.cells[index]).filter(|on| on.rank.is_finite())
    }

    /// Indices of the cells on lanes, in the order of the lattice.
    pub(super) fn marked(&mut self) -> &[u32] {
        self.marked.sort_unstable();
        &self.marked
    }

    /// Marks the cells along all motor lanes.
    pub(super) fn mark_lanes(&mut self, scene: &Scene, routes: &Routes, frame: &Frame) {
        let map: &Map = &scene.map;
        wide(
            #[inline(always)]
            || {
                for (k, feature) in map.features.iter().enumerate() {
                    if feature.kind.is_motor_lane() {
                        self.mark_lane(k, map.points_of(feature), routes.reach(k).is_some(), frame);
                    }
                }
            },
        );
    }

    #[inline(always)]
    fn mark_lane(&mut self, lane: usize, line: &[[f64; 3]], reachable: bool, frame: &Frame) {
        let Some(first) = line.first() else { return };
        let mut along = 0.0;
        // Distance from the start of a segment to the next point to mark.
        let mut next = 0.0;
        let mut a = frame.frame_from_world([first[0], first[1]]);
        for point in &line[1..] {
            let b = frame.frame_from_world([point[0], point[1]]);
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            let length = (dx * dx + dy * dy).sqrt();
            if length > 0.0 {
                let direction = [dx / length, dy / length];
                let (from, to) = self.within(a, b, direction, length);
                let mut t = f64::max(next, from);
                while t <= to {
                    let point = [a[0] + t * direction[0], a[1] + t * direction[1]];
                    self.mark(lane, point, along + t, direction, reachable);
                    t += SPACING;
                }
                next = (t - length).clamp(0.0, SPACING);
            }
            along += length;
            a = b;
        }
    }

    /// The part of a segment that lies over the lattice, metres from its start; an empty interval if none
    /// does.
    #[inline(always)]
    fn within(&self, a: Point, b: Point, direction: Point, length: f64) -> (f64, f64) {
        let mut part = (0.0_f64, length);
        for k in 0..2 {
            let low = f64::from(self.min[k]) * CELL - LANE_REACH;
            let high = f64::from(self.min[k] + self.size[k]) * CELL + LANE_REACH;
            let is_inside = |x: f64| low <= x && x <= high;
            if is_inside(a[k]) && is_inside(b[k]) {
                continue;
            }
            if direction[k].abs() < 1e-9 {
                if !is_inside(a[k]) {
                    return (length, 0.0);
                }
                continue;
            }
            let [s, t] = [(low - a[k]) / direction[k], (high - a[k]) / direction[k]];
            part = (part.0.max(s.min(t)), part.1.min(s.max(t)));
        }
        part
    }

    #[inline(always)]
    fn mark(&mut self, lane: usize, point: Point, along: f64, direction: Point, reachable: bool) {
        // Lattice points within reach; none if `last` is less than `first`.
        let [first, last] = [
            [0, 1].map(|k| (((point[k] - LANE_REACH) / CELL).ceil() as i32 - self.min[k]).max(0)),
            [0, 1].map(|k| {
                (((point[k] + LANE_REACH) / CELL).floor() as i32 - self.min[k]).min(self.size[k] - 1)
            }),
        ];
        let base = if reachable { 0.0 } else { DETOUR };
        for i in first[0]..=last[0] {
            let x = f64::from(self.min[0] + i) * CELL - point[0];
            for j in first[1]..=last[1] {
                let y = f64::from(self.min[1] + j) * CELL - point[1];
                let squared = (x * x + y * y) as f32;
                let index = i as usize * self.size[1] as usize + j as usize;
                let cell = &mut self.cells[index];
                if squared > (LANE_REACH * LANE_REACH) as f32 || base + squared >= cell.rank {
                    continue;
                }
                if cell.rank.is_infinite() {
                    self.marked.push(index as u32);
                }
                *cell = OnLane {
                    rank: base + squared,
                    lane: lane as u32,
                    along: (along + x * direction[0] + y * direction[1]) as f32,
                    offset: (y * direction[0] - x * direction[1]) as f32,
                    direction: direction.map(|x| x as f32),
                };
            }
        }
    }
}
