//! The three paths of the planner: the route, and the route shifted by a metre to each side.

use sage_core::geometry::{Aabb, OrientedBox, Point, cross, distance, dot, norm, sub};

use crate::route::{Route, resampled};

/// Offsets of the paths, metres, positive to the left.
pub(super) const OFFSETS: [f64; 3] = [0.0, -1.0, 1.0];
/// Distance of the points, metres.
const SPACING: f64 = 0.5;
/// Straight continuation of the route, metres.
const BEYOND: f64 = 200.0;
/// Points on each side over which positions are averaged, and over which directions are compared for a curvature.
const SMOOTH: usize = 3;
const CURVE: usize = 6;
/// Deceleration before curves, m/s².
const CURVE_BRAKING: f64 = 2.0;
/// Every so many points are looked at first in a search of the nearest one.
const STRIDE: usize = 4;
/// Length of the pieces of a corridor, metres.
const PIECE: f64 = 1.0;
/// Points with common bounds, a multiple of [`STRIDE`]: most of a path is far from a point, and not looked at.
const RUN: usize = 16;
/// Length of the cells by which the points at a distance along the path are found, metres.
const CELL: f64 = 1.0;
/// Distance by which bounds may be wrong without any effect, metres: far more than rounding.
const SLACK: f64 = 0.01;

/// A path: points with directions, curvatures and speeds.
#[derive(Clone)]
pub(super) struct Path {
    points: Vec<Point>,
    /// Unit directions, those of the route at all offsets.
    axes: Vec<Point>,
    /// 1/m, positive to the left.
    curvatures: Vec<f64>,
    /// Distances along the path, metres.
    along: Vec<f64>,
    /// Largest speeds for the curves ahead, m/s.
    speeds: Vec<f64>,
    /// Bounds of each [`RUN`] points and of the next one, so that they hold the way to it.
    runs: Vec<Aabb>,
    /// Number of points before each cell, and the one before it.
    cells: Vec<usize>,
}

/// A place on a path.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Place {
    pub(super) position: Point,
    pub(super) axis: Point,
    /// 1/m, positive to the left.
    pub(super) curvature: f64,
}

impl Path {
    /// All paths along a route. `curves` is the lateral acceleration in curves, m/s²; `None` for no limit of the speed.
    pub(super) fn all(route: &Route, curves: Option<f64>) -> [Self; 3] {
        let mut corners: Vec<Point> = route.points().collect();
        if let [.., before, last] = corners[..] {
            let d = sub(last, before);
            let unit = d.map(|x| x / norm(d).max(1e-9));
            corners.push([last[0] + BEYOND * unit[0], last[1] + BEYOND * unit[1]]);
        }
        let center = smoothed(&resampled(&corners, SPACING));
        let last = center.len() - 1;
        let axes: Vec<Point> = (0..=last)
            .map(|k| {
                let d = sub(center[(k + 1).min(last)], center[k.saturating_sub(1)]);
                d.map(|x| x / norm(d).max(1e-9))
            })
            .collect();
        OFFSETS.map(|offset| Self::new(&center, &axes, offset, curves))
    }

    fn new(center: &[Point], axes: &[Point], offset: f64, curves: Option<f64>) -> Self {
        let shifted = center.iter().zip(axes).map(|(p, a)| [p[0] - offset * a[1], p[1] + offset * a[0]]);
        let points: Vec<Point> = shifted.collect();
        let last = points.len() - 1;
        let mut along = vec![0.0; points.len()];
        for k in 1..=last {
            along[k] = along[k - 1] + distance(points[k - 1], points[k]);
        }
        let curvature = |k: usize| {
            let (a, b) = (k.saturating_sub(CURVE), (k + CURVE).min(last));
            let turn = cross(axes[a], axes[b]).atan2(dot(axes[a], axes[b]));
            turn / (along[b] - along[a]).max(SPACING)
        };
        let curvatures: Vec<f64> = (0..=last).map(curvature).collect();
        let mut speeds = vec![f64::INFINITY; points.len()];
        if let Some(lateral) = curves {
            let mut squared = f64::INFINITY;
            for k in (0..=last).rev() {
                let ahead = along.get(k + 1).map_or(0.0, |next| next - along[k]);
                squared =
                    (lateral / curvatures[k].abs().max(1e-9)).min(squared + 2.0 * CURVE_BRAKING * ahead);
                speeds[k] = squared.sqrt();
            }
        }
        let run = |start: usize| {
            let end = (start + RUN).min(last);
            Aabb::of(points[start..=end].iter().copied())
        };
        let runs = (0..points.len()).step_by(RUN).map(run).collect();
        let before = |cell: usize| {
            let start = CELL * (cell as f64 - 1.0);
            along.partition_point(|a| *a <= start)
        };
        let cells = (0..=(along[last] / CELL) as usize).map(before).collect();
        Self { points, axes: axes.to_vec(), curvatures, along, speeds, runs, cells }
    }

    /// Length, metres.
    pub(super) fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// The number of the last point, but one, that is not beyond a distance along the path.
    fn before(&self, along: f64) -> usize {
        // The cell is rounded, and 0 before the path; so the search begins a cell before it.
        let cell = ((along / CELL) as usize).min(self.cells.len() - 1);
        let mut k = self.cells[cell];
        while self.along.get(k).is_some_and(|a| *a <= along) {
            k += 1;
        }
        k.clamp(1, self.points.len() - 1) - 1
    }

    /// The place at a distance along the path; beyond the ends it continues straight.
    #[inline]
    pub(super) fn at(&self, along: f64) -> Place {
        let k = self.before(along);
        let length = (self.along[k + 1] - self.along[k]).max(1e-9);
        let share = (along - self.along[k]) / length;
        let inner = share.clamp(0.0, 1.0);
        let between = |a: Point, b: Point, share: f64| [0, 1].map(|i| a[i] + share * (b[i] - a[i]));
        let axis = between(self.axes[k], self.axes[k + 1], inner);
        Place {
            position: between(self.points[k], self.points[k + 1], share),
            axis: axis.map(|x| x / norm(axis).max(1e-9)),
            curvature: self.curvatures[k],
        }
    }

    /// Largest speed for the curves ahead at a distance along the path, m/s.
    pub(super) fn speed(&self, along: f64) -> f64 {
        self.speeds[self.before(along)]
    }

    /// The distance along the path of its point nearest to `p`.
    pub(super) fn project(&self, p: Point) -> f64 {
        let starts = (0..self.points.len()).step_by(RUN).map(|k| gap(self.points[k], p));
        self.project_within(p, starts.fold(f64::INFINITY, f64::min)).0
    }

    /// The same with the number of the nearest point, which the search looks at first for a place near the last one.
    pub(super) fn project_near(&self, p: Point, last: &mut usize) -> f64 {
        let compared = *last - *last % STRIDE;
        let (along, k) = self.project_within(p, gap(self.points[compared], p));
        *last = k;
        along
    }

    /// The distance along the path of its point nearest to `p`, and the number of that point. The gap of one of the
    /// compared points, or a larger one, is `least`.
    fn project_within(&self, p: Point, mut least: f64) -> (f64, usize) {
        let last = self.points.len() - 1;
        // A run whose bounds are farther than a point that is compared cannot hold the nearest one. The same
        // operations give bounds and gaps, so no rounding brings a point before its bounds.
        let mut coarse = (f64::INFINITY, 0);
        for (number, run) in self.runs.iter().enumerate() {
            if run.squared_distance(p) > least {
                continue;
            }
            let start = number * RUN;
            for k in (start..(start + RUN).min(self.points.len())).step_by(STRIDE) {
                let found = gap(self.points[k], p);
                if found < coarse.0 {
                    coarse = (found, k);
                    least = least.min(found);
                }
            }
        }
        let from = coarse.1.saturating_sub(STRIDE);
        let mut nearest = (f64::INFINITY, 0);
        for (k, point) in (from..).zip(&self.points[from..=(coarse.1 + STRIDE).min(last)]) {
            let found = gap(*point, p);
            if found < nearest.0 {
                nearest = (found, k);
            }
        }
        let k = nearest.1;
        (self.along[k] + dot(sub(p, self.points[k]), self.axes[k]), k)
    }

    /// Whether a box meets the corridor of a half width around the path between two distances along it. The centre
    /// of the box is at the distance `center` along it.
    pub(super) fn meets(
        &self,
        area: &OrientedBox,
        center: f64,
        half_width: f64,
        [from, to]: [f64; 2],
    ) -> bool {
        let radius = area.radius();
        if distance(self.at(center).position, area.center) > radius + half_width {
            return false;
        }
        let (from, to) = (from.max(center - radius - PIECE), to.min(center + radius + PIECE));
        let mut start = from;
        while start < to {
            let end = (start + PIECE).min(to);
            let middle = self.at(0.5 * (start + end));
            let half_length = 0.5 * (end - start);
            let piece = OrientedBox { center: middle.position, axis: middle.axis, half_length, half_width };
            if piece.intersects(area) {
                return true;
            }
            start = end;
        }
        false
    }

    /// Bounds of the part between two distances along the path, grown by a reach.
    pub(super) fn bounds(&self, [from, to]: [f64; 2], reach: f64) -> Aabb {
        // The distances along the path never fall.
        let first = self.along.partition_point(|a| *a < from - SPACING);
        let end = self.along.partition_point(|a| *a <= to + SPACING).max(first);
        let ends = [self.at(from).position, self.at(to).position];
        let all = Aabb::of(self.points[first..end].iter().copied().chain(ends));
        all.grown(reach)
    }

    /// Bounds of all runs of points between two distances along the path, and of the straight ways before and beyond
    /// the path: a box farther than `half_width` and its radius from each of them does not meet the corridor
    /// ([`Path::meets`]).
    pub(super) fn corridor(&self, [from, to]: [f64; 2], half_width: f64) -> Vec<Aabb> {
        let last = self.points.len() - 1;
        let runs = &self.runs[self.before(from) / RUN..=self.before(to) / RUN];
        let beyond = (to > self.along[last]).then(|| Aabb::of([self.points[last], self.at(to).position]));
        let before = (from < self.along[0]).then(|| Aabb::of([self.points[0], self.at(from).position]));
        // A piece reaches half its length farther than its place on the path.
        let reach = half_width + 0.5 * PIECE + SLACK;
        let all = runs.iter().copied().chain(beyond).chain(before);
        all.map(|bounds| bounds.grown(reach)).collect()
    }
}

/// Squared distance of two points, m².
#[inline]
fn gap(a: Point, b: Point) -> f64 {
    let d = sub(a, b);
    dot(d, d)
}

/// Positions averaged over their neighbours; the ends stay.
fn smoothed(points: &[Point]) -> Vec<Point> {
    let last = points.len() - 1;
    let mean = |k: usize| {
        let reach = SMOOTH.min(k).min(last - k);
        let window = &points[k - reach..=k + reach];
        [0, 1].map(|i| window.iter().map(|p| p[i]).sum::<f64>() / window.len() as f64)
    };
    (0..=last).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use sage_core::seed::Rng;

    use super::*;

    /// A quarter of a circle to the left, radius 20 m, after 30 m straight on.
    fn bend() -> [Path; 3] {
        let straight = (0..=30).map(|k| [f64::from(k), 0.0]);
        let arc = (1..=31).map(|k| {
            let angle = f64::from(k) / 20.0;
            [30.0 + 20.0 * angle.sin(), 20.0 - 20.0 * angle.cos()]
        });
        Path::all(&Route::new(&straight.chain(arc).collect::<Vec<_>>()), Some(2.5))
    }

    #[test]
    fn places_come_back_and_offsets_are_to_the_left() {
        for (path, offset) in bend().iter().zip(OFFSETS) {
            for along in [3.0, 20.0, 33.0, 45.0] {
                assert_relative_eq!(path.project(path.at(along).position), along, epsilon = 0.02);
            }
            assert_relative_eq!(path.at(10.0).position[1], offset, epsilon = 1e-9);
        }
    }

    #[test]
    fn searches_find_what_a_scan_of_all_points_finds() {
        let mut rng = Rng::new(0, "pdm path", "searches");
        for path in bend() {
            let (last, mut near) = (path.points.len() - 1, 0);
            for _ in 0..2_000 {
                let along = rng.uniform(-20.0, path.length() + 20.0);
                let k = path.along.partition_point(|a| *a <= along).clamp(1, last) - 1;
                assert_eq!(path.before(along), k);
                let p = [rng.uniform(-60.0, 120.0), rng.uniform(-60.0, 300.0)];
                let first_least = |range: &mut dyn Iterator<Item = usize>| {
                    range.reduce(|a, b| if gap(path.points[b], p) < gap(path.points[a], p) { b } else { a })
                };
                let coarse = first_least(&mut (0..=last).step_by(STRIDE)).unwrap();
                let around = coarse.saturating_sub(STRIDE)..=(coarse + STRIDE).min(last);
                let k = first_least(&mut around.into_iter()).unwrap();
                let found = path.along[k] + dot(sub(p, path.points[k]), path.axes[k]);
                assert_eq!(path.project(p), found);
                assert_eq!(path.project_near(p, &mut near), found);
            }
        }
    }

    #[test]
    fn what_meets_a_corridor_is_near_its_parts() {
        let mut rng = Rng::new(0, "pdm path", "corridor");
        let mut met = 0;
        for path in bend() {
            for _ in 0..2_000 {
                let from = rng.uniform(-20.0, path.length());
                let range = [from, from + rng.uniform(1.0, 120.0)];
                let p = path.at(rng.uniform(-30.0, path.length() + 100.0)).position;
                let center = p.map(|x| x + rng.uniform(-6.0, 6.0));
                let area = OrientedBox::new(center, rng.uniform(-3.0, 3.0), 5.0, 2.0);
                if path.meets(&area, path.project(center), 1.0, range) {
                    met += 1;
                    let radius = area.radius();
                    let parts = path.corridor(range, 1.0);
                    assert!(parts.iter().any(|part| part.squared_distance(center) <= radius * radius));
                }
            }
        }
        assert!(met > 500, "{met}");
    }

    #[test]
    fn a_bend_has_its_curvature_and_limits_the_speed_before_it() {
        let [center, ..] = bend();
        assert_relative_eq!(center.at(45.0).curvature, 0.05, epsilon = 2e-3);
        assert_relative_eq!(center.speed(45.0), (2.5f64 * 20.0).sqrt(), epsilon = 0.2);
        // 20 m before the bend the car may still brake.
        let before = center.speed(10.0);
        assert!(before > 9.0 && before < 13.0, "{before}");
        assert_relative_eq!(center.at(90.0).curvature, 0.0, epsilon = 1e-9);
    }

    #[test]
    fn a_corridor_is_as_wide_as_asked_for() {
        let [center, ..] = bend();
        let car = |y: f64| OrientedBox::new([15.0, y], 0.0, 4.0, 2.0);
        let meets = |y, range| center.meets(&car(y), center.project([15.0, y]), 1.0, range);
        assert!(meets(1.99, [0.0, 40.0]) && !meets(2.01, [0.0, 40.0]));
        assert!(!meets(0.0, [17.1, 40.0]) && meets(0.0, [16.9, 40.0]));
    }
}
