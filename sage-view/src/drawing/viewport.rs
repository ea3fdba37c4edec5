//! Maps metres to pixels.

use sage_core::geometry::{Aabb, Point};

/// A window on the world: x to the right, y up, one scale.
#[derive(Clone, Copy, Debug)]
pub(super) struct Viewport {
    bounds: Aabb,
    /// Pixels per metre.
    pub(super) scale: f64,
    /// Width of the window, pixels.
    pub(super) width: f64,
    /// Height of the window, pixels.
    pub(super) height: f64,
}

impl Viewport {
    /// The smallest window of this size in pixels that shows `area` with a margin (m) and is at least
    /// `least` metres wide.
    pub(super) fn on(area: &Aabb, margin: f64, least: f64, [width, height]: [f64; 2]) -> Self {
        let center = [0.5 * (area.min[0] + area.max[0]), 0.5 * (area.min[1] + area.max[1])];
        let span = [area.max[0] - area.min[0] + 2.0 * margin, area.max[1] - area.min[1] + 2.0 * margin];
        let scale = (width / span[0].max(least)).min(height / span[1].max(least * height / width));
        let half = [0.5 * width / scale, 0.5 * height / scale];
        let bounds = Aabb {
            min: [center[0] - half[0], center[1] - half[1]],
            max: [center[0] + half[0], center[1] + half[1]],
        };
        Self { bounds, scale, width, height }
    }

    /// Pixel of a point.
    pub(super) fn pixel(&self, p: Point) -> Point {
        [(p[0] - self.bounds.min[0]) * self.scale, (self.bounds.max[1] - p[1]) * self.scale]
    }

    /// True if the bounds intersect the window.
    pub(super) fn shows(&self, bounds: &Aabb) -> bool {
        self.bounds.meets(bounds)
    }

    /// The visible parts of a polyline, in pixels, without points that make no visible difference. A
    /// segment that crosses the window's border keeps both ends.
    pub(super) fn parts(&self, points: &[[f64; 3]]) -> Vec<Vec<Point>> {
        let mut parts: Vec<Vec<Point>> = Vec::new();
        let mut open = false;
        for pair in points.windows(2) {
            let (a, b) = ([pair[0][0], pair[0][1]], [pair[1][0], pair[1][1]]);
            let visible = self.shows(&Aabb::of([a, b]));
            if visible && !open {
                parts.push(vec![self.pixel(a)]);
            }
            if let Some(part) = parts.last_mut().filter(|_| visible) {
                part.push(self.pixel(b));
            }
            open = visible;
        }
        parts.iter().map(|part| simplified(part)).collect()
    }
}

/// Simplifies a line by Douglas and Peucker's method with a tolerance of a third of a pixel. It works in
/// chunks, because its worst case is quadratic in the number of points.
fn simplified(points: &[Point]) -> Vec<Point> {
    const TOLERANCE: f64 = 0.33;
    const CHUNK: usize = 2048;
    let mut keep = vec![false; points.len()];
    let end = points.len().saturating_sub(1);
    let mut open: Vec<(usize, usize)> =
        (0..=end).step_by(CHUNK).map(|first| (first, (first + CHUNK).min(end))).collect();
    while let Some((first, last)) = open.pop() {
        (keep[first], keep[last]) = (true, true);
        let (a, b) = (points[first], points[last]);
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].hypot(along[1]);
        let off = |k: usize| {
            let d = [points[k][0] - a[0], points[k][1] - a[1]];
            if length > 0.0 { (along[0] * d[1] - along[1] * d[0]).abs() / length } else { d[0].hypot(d[1]) }
        };
        let farthest = (first + 1..last).map(|k| (k, off(k))).max_by(|x, y| x.1.total_cmp(&y.1));
        if let Some((k, _)) = farthest.filter(|(_, d)| *d > TOLERANCE) {
            open.extend([(first, k), (k, last)]);
        }
    }
    points.iter().zip(keep).filter(|(_, keep)| *keep).map(|(p, _)| *p).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_keeps_its_proportions_and_shows_the_area() {
        let area = Aabb { min: [0.0, 0.0], max: [100.0, 10.0] };
        let viewport = Viewport::on(&area, 10.0, 60.0, [900.0, 600.0]);
        assert_eq!(viewport.scale, 7.5);
        assert_eq!(viewport.pixel([50.0, 5.0]), [450.0, 300.0]);
        assert_eq!(viewport.pixel([-10.0, 5.0])[0], 0.0);
    }

    #[test]
    fn straight_lines_need_two_points_and_corners_stay() {
        let viewport = Viewport::on(&Aabb { min: [0.0, 0.0], max: [100.0, 100.0] }, 0.0, 1.0, [100.0, 100.0]);
        let line: Vec<[f64; 3]> =
            (0..=50).map(|k| [f64::from(k), 0.0, 0.0]).chain([[50.0, 50.0, 0.0]]).collect();
        assert_eq!(viewport.parts(&line), [vec![[0.0, 100.0], [50.0, 100.0], [50.0, 50.0]]]);
        let outside = [[-50.0, 0.0, 0.0], [-40.0, 0.0, 0.0]];
        assert!(viewport.parts(&outside).is_empty());
    }
}
