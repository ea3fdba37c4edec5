//! The same way driven at another pace: earlier or later in the middle, there at the same time.

use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
};

/// How much the pace of each variant bends; 0 is the path itself. With b the share of the way's time
/// that has passed at share u is `u + b u² (1 − u)`: a path starts as it did, is ahead of itself by an
/// eighth of b of the whole time in the middle, and ends at `1 − b` of its last speed.
pub(crate) const PACES: [f64; 3] = [0.0, 0.5, -0.5];

/// A path from `start` at another pace.
///
/// *Errors*: a path so near the bounds of coordinates that its cubic goes beyond them.
pub(crate) fn at_pace(path: &Trajectory, start: Point, bend: f64) -> Result<Trajectory, sage_core::Error> {
    if bend == 0.0 {
        return Ok(path.clone());
    }
    let known = |k: isize| match k {
        // Before the start as after the end the path goes straight on.
        ..0 => extrapolated(start, path.points()[0]),
        0 => start,
        k if k as usize <= HORIZON => path.points()[k as usize - 1],
        _ => extrapolated(path.points()[HORIZON - 1], path.points()[HORIZON - 2]),
    };
    let at = |step: usize| {
        let u = step as f64 / HORIZON as f64;
        let along = HORIZON as f64 * (u + bend * u * u * (1.0 - u));
        let k = (along.floor() as isize).clamp(0, HORIZON as isize - 1);
        let corners = [-1, 0, 1, 2].map(|d| known(k + d));
        [0, 1].map(|axis| catmull_rom(corners.map(|p| p[axis]), along - k as f64))
    };
    Trajectory::new("retimed path", (1..=HORIZON).map(at).collect())
}

/// The point that lies as far beyond `near` as `other` lies on its other side.
fn extrapolated(near: Point, other: Point) -> Point {
    [2.0 * near[0] - other[0], 2.0 * near[1] - other[1]]
}

/// The cubic through the middle two of four evenly spaced values with the slopes of their neighbours:
/// straight lines between points would jerk.
fn catmull_rom([a, b, c, d]: [f64; 4], t: f64) -> f64 {
    b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn braking() -> Trajectory {
        let at = |k: usize| {
            let t = k as f64 / 10.0;
            [12.0 * t - 0.5 * t * t, 0.3 * t * t]
        };
        Trajectory::new("test", (1..=HORIZON).map(at).collect()).unwrap()
    }

    #[test]
    fn the_plain_pace_is_the_path_and_every_pace_ends_where_it_does() {
        let path = braking();
        assert_eq!(at_pace(&path, [0.0, 0.0], 0.0).unwrap(), path);
        for bend in [0.5, -0.5, 1.0] {
            let other = at_pace(&path, [0.0, 0.0], bend).unwrap();
            let [x, y] = other.points()[HORIZON - 1];
            let [a, b] = path.points()[HORIZON - 1];
            assert!((x - a).abs() < 1e-9 && (y - b).abs() < 1e-9);
        }
    }

    #[test]
    fn a_pace_is_that_of_the_time_it_stands_for() {
        // In the middle half a second ahead; the path is a polynomial, so its places are known.
        let other = at_pace(&braking(), [0.0, 0.0], 0.5).unwrap();
        let [x, y] = other.points()[HORIZON / 2 - 1];
        let t = 4.5;
        assert!((x - (12.0 * t - 0.5 * t * t)).abs() < 1e-9 && (y - 0.3 * t * t).abs() < 1e-9);
        // Smooth: no second difference of a step is far from that of its neighbour.
        let points = other.points();
        let second = |k: usize| (points[k + 1][0] - 2.0 * points[k][0] + points[k - 1][0]) * 100.0;
        for k in 2..HORIZON - 2 {
            assert!((second(k + 1) - second(k)).abs() < 0.3, "step {k}: {} to {}", second(k), second(k + 1));
        }
    }
}
