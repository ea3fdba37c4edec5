//! The line that an evasive manoeuvre is measured from: where the ego went, continued along the lanes.

use sage_core::{
    geometry::{Point, cross, dot, norm, sub},
    scene::SceneIndex,
};

use crate::route::{Route, resampled};

/// Distance of its points, metres.
const SPACING: f64 = 0.5;
/// Length beyond the recorded path, metres: eight seconds at 30 m/s.
const BEYOND: f64 = 240.0;
/// A path shorter than this has no direction of its own, metres.
const SHORTEST: f64 = 1.0;
/// Points on each side over which directions are averaged.
const SMOOTH: usize = 2;

/// A polyline with points of equal spacing, directions and curvatures.
pub(super) struct ReferenceLine {
    points: Vec<Point>,
    /// Unit directions.
    along: Vec<Point>,
    /// 1/m, positive to the left.
    curvature: Vec<f64>,
}

/// A place relative to the line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Distance along the line, metres.
    pub(super) station: f64,
    /// Distance from it, metres, positive to the left.
    pub(super) offset: f64,
    /// Direction of the line there.
    pub(super) along: Point,
    pub(super) curvature: f64,
}

impl ReferenceLine {
    /// The line through positions; `axis` is the direction of a car that does not move.
    pub(super) fn new(positions: &[Point], axis: Point, index: &SceneIndex) -> Self {
        let first = positions[0];
        let reach = positions.iter().map(|p| norm(sub(*p, first))).fold(0.0, f64::max);
        let ahead = |p: Point, length: f64| [p[0] + length * axis[0], p[1] + length * axis[1]];
        let route = if reach < SHORTEST {
            Route::new(&[first, ahead(first, SHORTEST + 0.5)])
        } else {
            Route::new(positions)
        };
        let mut all: Vec<Point> = route.continued(index, BEYOND).points().collect();
        // Straight on where no lane leads on.
        if let [.., before, last] = all[..] {
            let d = sub(last, before);
            let unit = d.map(|x| x / norm(d).max(1e-9));
            all.push([last[0] + BEYOND * unit[0], last[1] + BEYOND * unit[1]]);
        }
        let points = resampled(&all, SPACING);
        let count = points.len();
        let along: Vec<Point> = (0..count)
            .map(|k| {
                let (a, b) = (k.saturating_sub(SMOOTH), (k + SMOOTH).min(count - 1));
                let d = sub(points[b], points[a]);
                d.map(|x| x / norm(d).max(1e-9))
            })
            .collect();
        let curvature = (0..count)
            .map(|k| {
                let (a, b) = (k.saturating_sub(SMOOTH), (k + SMOOTH).min(count - 1));
                let turn = cross(along[a], along[b]).atan2(dot(along[a], along[b]));
                turn / (SPACING * (b - a).max(1) as f64)
            })
            .collect();
        Self { points, along, curvature }
    }

    /// The place of a point near a station.
    pub(super) fn place(&self, p: Point, near: f64) -> Place {
        let last = self.points.len() - 1;
        let mut station = near;
        // The second step corrects for the curvature between the guess and the place.
        let mut k = 0;
        for _ in 0..2 {
            k = ((station / SPACING).round().max(0.0) as usize).min(last);
            station = k as f64 * SPACING + dot(sub(p, self.points[k]), self.along[k]);
        }
        let offset = cross(self.along[k], sub(p, self.points[k]));
        Place { station, offset, along: self.along[k], curvature: self.curvature[k] }
    }

    /// The station of the point nearest to `p` of the whole line.
    pub(super) fn station_of(&self, p: Point) -> f64 {
        let gap = |k: &usize| norm(sub(p, self.points[*k]));
        let nearest = (0..self.points.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(0);
        self.place(p, nearest as f64 * SPACING).station
    }
}
