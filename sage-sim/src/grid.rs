//! Uniform grid over boxes: box queries, and rays that visit cells from near to far.

use sage_core::geometry::{Aabb, Point};

/// Side of a cell, metres.
const CELL: f64 = 4.0;
/// Largest number of cells; larger areas get larger cells.
const MAX_CELLS: f64 = 1e6;

/// Boxes by cell.
#[derive(Clone, Debug)]
pub struct Grid {
    origin: Point,
    cell: f64,
    size: [usize; 2],
    /// Items of cell `k` are `items[starts[k]..starts[k + 1]]`.
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Grid {
    /// A grid over boxes, numbered in their order.
    pub fn of(boxes: impl Iterator<Item = Aabb> + Clone) -> Self {
        let all = boxes.clone().fold(Aabb::EMPTY, |all, b| all.union(&b));
        let extent = [0, 1].map(|k| (all.max[k] - all.min[k]).max(0.0));
        if boxes.clone().next().is_none() {
            return Self { origin: [0.0; 2], cell: CELL, size: [0, 0], starts: vec![0], items: vec![] };
        }
        let cell = CELL.max((extent[0] * extent[1] / MAX_CELLS).sqrt()).max(extent[0].max(extent[1]) / 1e5);
        let size = extent.map(|e| (e / cell) as usize + 1);
        let mut grid = Self { origin: all.min, cell, size, starts: Vec::new(), items: Vec::new() };
        let mut counts = vec![0u32; size[0] * size[1] + 1];
        for b in boxes.clone() {
            grid.cells(&b, |k| counts[k + 1] += 1);
        }
        for k in 1..counts.len() {
            counts[k] += counts[k - 1];
        }
        let mut next = counts.clone();
        let mut items = vec![0; counts[counts.len() - 1] as usize];
        for (item, b) in boxes.enumerate() {
            grid.cells(&b, |k| {
                items[next[k] as usize] = item as u32;
                next[k] += 1;
            });
        }
        (grid.starts, grid.items) = (counts, items);
        grid
    }

    /// Calls `found` with every item whose box may meet `bounds`; an item may come several times.
    pub fn near(&self, bounds: &Aabb, mut found: impl FnMut(usize)) {
        self.cells(bounds, |k| {
            for &item in &self.items[self.starts[k] as usize..self.starts[k + 1] as usize] {
                found(item as usize);
            }
        });
    }

    /// The smallest distance that `hit` gives along a ray, at most `reach` metres. `hit` gets an item and
    /// the smallest distance so far, and returns a smaller one or `None`.
    pub fn cast(
        &self,
        from: Point,
        direction: Point,
        reach: f64,
        mut hit: impl FnMut(usize, f64) -> Option<f64>,
    ) -> f64 {
        let mut nearest = reach;
        // The part of the ray inside the grid.
        let (mut enter, mut leave) = (0.0f64, reach);
        for k in 0..2 {
            let [low, high] = [self.origin[k], self.origin[k] + self.size[k] as f64 * self.cell];
            if direction[k].abs() < 1e-12 {
                if from[k] < low || from[k] > high {
                    return nearest;
                }
                continue;
            }
            let [a, b] = [(low - from[k]) / direction[k], (high - from[k]) / direction[k]];
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        if !(enter < leave) {
            return nearest;
        }
        let start = [0, 1].map(|k| (from[k] + enter * direction[k] - self.origin[k]) / self.cell);
        let mut cell = [0, 1].map(|k| (start[k] as isize).clamp(0, self.size[k] as isize - 1));
        let step = direction.map(|d| if d > 0.0 { 1 } else { -1 });
        let per_cell = direction.map(|d| if d.abs() < 1e-12 { f64::INFINITY } else { self.cell / d.abs() });
        let mut next = [0, 1].map(|k| {
            if direction[k].abs() < 1e-12 {
                return f64::INFINITY;
            }
            let edge = self.origin[k] + (cell[k] + isize::from(step[k] > 0)) as f64 * self.cell;
            (edge - from[k]) / direction[k]
        });
        loop {
            let at = cell[1] as usize * self.size[0] + cell[0] as usize;
            for &item in &self.items[self.starts[at] as usize..self.starts[at + 1] as usize] {
                if let Some(distance) = hit(item as usize, nearest) {
                    nearest = distance;
                }
            }
            let axis = usize::from(next[1] < next[0]);
            // A hit in a later cell cannot be nearer than its entry.
            if next[axis] >= nearest.min(leave) {
                return nearest;
            }
            cell[axis] += step[axis];
            if cell[axis] < 0 || cell[axis] >= self.size[axis] as isize {
                return nearest;
            }
            next[axis] += per_cell[axis];
        }
    }

    fn cells(&self, bounds: &Aabb, mut each: impl FnMut(usize)) {
        let range = |k: usize| {
            let cell = |x: f64| (x - self.origin[k]) / self.cell;
            let (low, high) = (cell(bounds.min[k]), cell(bounds.max[k]));
            if self.size[k] == 0 || high < 0.0 || low >= self.size[k] as f64 {
                return 0..0;
            }
            low.max(0.0) as usize..(high as usize + 1).min(self.size[k])
        };
        let columns = range(0);
        for row in range(1) {
            for column in columns.clone() {
                each(row * self.size[0] + column);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::{geometry::OrientedBox, seed::Rng};

    #[test]
    fn rays_and_queries_find_what_a_scan_finds() {
        let mut rng = Rng::new(5, "grid", "rays");
        let mut uniform = |r: f64| rng.uniform(-r, r);
        let boxes: Vec<OrientedBox> = (0..400)
            .map(|_| OrientedBox::new([uniform(90.0), uniform(70.0)], uniform(3.0), 1.5, 0.1))
            .collect();
        let grid = Grid::of(boxes.iter().map(OrientedBox::aabb));
        let mut hits = 0;
        for _ in 0..500 {
            let (from, angle) = ([uniform(120.0), uniform(90.0)], uniform(3.2));
            let direction = [angle.cos(), angle.sin()];
            let cast = |b: &OrientedBox| crate::rays::to_box(from, direction, b);
            let scan = boxes.iter().filter_map(cast).fold(50.0, f64::min);
            let found =
                grid.cast(from, direction, 50.0, |k, nearest| cast(&boxes[k]).filter(|d| *d < nearest));
            assert_eq!(found, scan);
            hits += usize::from(scan < 50.0);
            let area = Aabb::around(from, 5.0);
            let mut near = Vec::new();
            grid.near(&area, |k| near.push(k));
            assert!((0..400).filter(|&k| boxes[k].aabb().meets(&area)).all(|k| near.contains(&k)));
        }
        assert!(hits > 50, "{hits}");
    }

    #[test]
    fn a_grid_of_nothing_finds_nothing() {
        let grid = Grid::of(std::iter::empty());
        assert_eq!(grid.cast([0.0; 2], [1.0, 0.0], 50.0, |_, _| Some(0.0)), 50.0);
        grid.near(&Aabb::around([0.0; 2], 10.0), |_| panic!("nothing is there"));
    }
}
