//! Distances along rays.

use sage_core::geometry::{OrientedBox, Point, cross, dot, sub};

/// Distance from `from` along the unit vector `direction` to a box, metres; 0 inside of it.
#[inline]
pub fn to_box(from: Point, direction: Point, target: &OrientedBox) -> Option<f64> {
    let d = sub(from, target.center);
    let axis = target.axis;
    let origin = [dot(d, axis), cross(axis, d)];
    let along = [dot(direction, axis), cross(axis, direction)];
    let half = [target.half_length, target.half_width];
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for k in 0..2 {
        if along[k].abs() < 1e-12 {
            if origin[k].abs() > half[k] {
                return None;
            }
            continue;
        }
        let inverse = 1.0 / along[k];
        let [a, b] = [(-half[k] - origin[k]) * inverse, (half[k] - origin[k]) * inverse];
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    (enter <= leave).then_some(enter)
}

/// Distance from `from` along the unit vector `direction` to a disc, metres; 0 inside of it.
#[inline]
pub fn to_disc(from: Point, direction: Point, center: Point, radius: f64) -> Option<f64> {
    let d = sub(center, from);
    let (ahead, aside) = (dot(d, direction), cross(direction, d));
    if aside.abs() > radius {
        return None;
    }
    let half = (radius * radius - aside * aside).sqrt();
    (ahead + half >= 0.0).then_some((ahead - half).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_ray_meets_the_near_side() {
        let target = OrientedBox::new([10.0, 0.5], 0.0, 4.0, 2.0);
        assert_relative_eq!(to_box([0.0, 0.0], [1.0, 0.0], &target).unwrap(), 8.0);
        assert_eq!(to_box([0.0, 0.0], [-1.0, 0.0], &target), None);
        assert_eq!(to_box([0.0, -1.0], [1.0, 0.0], &target), None);
        assert_eq!(to_box([10.0, 0.0], [1.0, 0.0], &target), Some(0.0));
        assert_relative_eq!(to_disc([0.0, 0.0], [0.0, 1.0], [0.0, 5.0], 0.35).unwrap(), 4.65);
        assert_eq!(to_disc([0.0, 0.0], [0.0, 1.0], [0.4, 5.0], 0.35), None);
    }
}
