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
}

/// A place on a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) position: Point,
    pub(super) axis: Point,
    /// 1/m, positive to the left.
    pub(super) curvature: f64,
    /// Largest speed for the curves ahead, m/s.
    pub(super) speed: f64,
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
        Self { points, axes: axes.to_vec(), curvatures, along, speeds }
    }

    /// Length, metres.
    pub(super) fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// The place at a distance along the path; beyond the ends it continues straight.
    pub(super) fn at(&self, along: f64) -> Place {
        let last = self.points.len() - 1;
        let k = self.along.partition_point(|a| *a <= along).clamp(1, last) - 1;
        let length = (self.along[k + 1] - self.along[k]).max(1e-9);
        let share = (along - self.along[k]) / length;
        let inner = share.clamp(0.0, 1.0);
        let between = |a: Point, b: Point, share: f64| [0, 1].map(|i| a[i] + share * (b[i] - a[i]));
        let axis = between(self.axes[k], self.axes[k + 1], inner);
        Place {
            position: between(self.points[k], self.points[k + 1], share),
            axis: axis.map(|x| x / norm(axis).max(1e-9)),
            curvature: self.curvatures[k],
            speed: self.speeds[k],
        }
    }

    /// The distance along the path of its point nearest to `p`.
    pub(super) fn project(&self, p: Point) -> f64 {
        let last = self.points.len() - 1;
        let gap = |k: usize| {
            let d = sub(self.points[k], p);
            dot(d, d)
        };
        let nearest = |range: &mut dyn Iterator<Item = usize>| {
            range
                .map(|k| (gap(k), k))
                .fold((f64::INFINITY, 0), |best, one| if one.0 < best.0 { one } else { best })
        };
        let (_, coarse) = nearest(&mut (0..=last).step_by(STRIDE));
        let (_, k) = nearest(&mut (coarse.saturating_sub(STRIDE)..=(coarse + STRIDE).min(last)));
        self.along[k] + dot(sub(p, self.points[k]), self.axes[k])
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
        let inside =
            (0..self.points.len()).filter(|&k| (from - SPACING..=to + SPACING).contains(&self.along[k]));
        let ends = [self.at(from).position, self.at(to).position];
        let all = Aabb::of(inside.map(|k| self.points[k]).chain(ends));
        Aabb { min: all.min.map(|x| x - reach), max: all.max.map(|x| x + reach) }
    }
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
    fn a_bend_has_its_curvature_and_limits_the_speed_before_it() {
        let [center, ..] = bend();
        assert_relative_eq!(center.at(45.0).curvature, 0.05, epsilon = 2e-3);
        assert_relative_eq!(center.at(45.0).speed, (2.5f64 * 20.0).sqrt(), epsilon = 0.2);
        // 20 m before the bend the car may still brake.
        let before = center.at(10.0).speed;
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
