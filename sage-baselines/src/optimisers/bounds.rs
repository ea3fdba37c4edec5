//! Bounds of a motion: speed, acceleration and jerk along and across the path.

use sage_core::{
    geometry::{Point, norm, sub},
    motion::DT,
};

/// Mean + 3 σ of recorded moving vehicles: speed, m/s; acceleration along and across, m/s²; jerk along and across, m/s³.
pub(crate) const RECORDED: [f64; 5] = [23.5, 13.3, 3.8, 221.0, 56.0];
/// A motion may exceed its own greatest values by this factor.
const OWN: f64 = 1.001;
/// Speed that is added in the direction of a motion, so that a standing car has one, m/s.
const STANDING: f64 = 0.01;

/// Greatest values of a motion, in the order of [`RECORDED`]. `before` are the positions one and two frames before the
/// points.
pub(crate) fn greatest(before: [Point; 2], points: impl Iterator<Item = Point>) -> [f64; 5] {
    let mut most = [0.0f64; 5];
    let mut all = [before[1], before[0]].into_iter().chain(points);
    let (Some(mut last), mut velocity, mut acceleration) = (all.next(), None::<Point>, None::<Point>) else {
        return most;
    };
    // Differences lie at the earlier of their points: the direction is that of the earlier velocity.
    let mut earlier: Option<Point> = None;
    for point in all {
        let v = sub(point, last).map(|d| d / DT);
        most[0] = most[0].max(norm(v));
        if let Some(known) = velocity {
            let a = sub(v, known).map(|d| d / DT);
            let (along, across) = parts(a, known);
            (most[1], most[2]) = (most[1].max(along), most[2].max(across));
            if let (Some(before), Some(direction)) = (acceleration, earlier) {
                let j = sub(a, before).map(|d| d / DT);
                let (along, across) = parts(j, direction);
                (most[3], most[4]) = (most[3].max(along), most[4].max(across));
            }
            acceleration = Some(a);
            earlier = Some(known);
        }
        velocity = Some(v);
        last = point;
    }
    most
}

/// Parts of a vector along and across a velocity.
fn parts(x: Point, v: Point) -> (f64, f64) {
    let scale = 1.0 / (norm(v) + STANDING);
    let u = v.map(|c| c * scale);
    ((x[0] * u[0] + x[1] * u[1]).abs(), (x[0] * u[1] - x[1] * u[0]).abs())
}

/// The recorded bounds, raised to those of a motion.
pub(crate) fn raised(own: [f64; 5]) -> [f64; 5] {
    std::array::from_fn(|k| RECORDED[k].max(OWN * own[k]))
}

/// Whether no value exceeds its bound.
pub(crate) fn are_kept(values: [f64; 5], bounds: [f64; 5]) -> bool {
    values.iter().zip(bounds).all(|(value, bound)| *value <= bound)
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn a_circle_has_speed_and_lateral_acceleration() {
        let at = |k: f64| [30.0 * (k / 30.0).sin(), 30.0 * (1.0 - (k / 30.0).cos())];
        let [speed, along, across, _, jerk] =
            greatest([at(-1.0), at(-2.0)], (0..80).map(|k| at(f64::from(k))));
        assert_relative_eq!(speed, 10.0, epsilon = 1e-3);
        assert_relative_eq!(across, 10.0 * 10.0 / 30.0, epsilon = 0.01);
        assert!(along < 0.1 && jerk < 1.2, "{along} {jerk}");
    }

    #[test]
    fn a_kink_breaks_the_bounds() {
        let at = |k: i32| [f64::from(k), if k == 40 { 0.2 } else { 0.0 }];
        let found = greatest([at(-1), at(-2)], (0..80).map(at));
        assert!(!are_kept(found, RECORDED), "{found:?}");
        assert!(are_kept(found, raised(found)));
        assert!(are_kept(greatest([at(-1), at(-2)], (0..30).map(at)), RECORDED));
    }
}
