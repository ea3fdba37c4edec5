//! Limits on the maps of files: without them a small file could make every search slow.

use std::{collections::HashMap, path::Path};

use sage_core::{geometry::distance, scene::Scene};

use crate::Error;

/// Limit of the total length of the lines of a map, metres. None of 30 public maps has more than 21 km.
/// Without a limit a small file could make every search among lines slow.
const MAX_LINES: f64 = 16e6;

/// Side of the squares in which points of a map are counted, metres.
const SQUARE: f64 = 4.0;
/// Limit of the number of points of a map in a square. None of 430 recorded maps has more than 83. Without a limit
/// thousands of lines could lie below one car, and every test of a car against the map would look at all of them.
const MOST_POINTS: u32 = 4000;

/// Refuses a map whose lines are too long, or that has too many points in one place.
///
/// *Errors*: [`Error::Field`].
pub(crate) fn check(scene: &Scene, path: &Path) -> Result<(), Error> {
    check_lines(scene, path)?;
    check_density(scene, path)
}

/// Refuses a map whose lines exceed [`MAX_LINES`].
fn check_lines(scene: &Scene, path: &Path) -> Result<(), Error> {
    let map = &scene.map;
    if bound_of_lines(&map.points) <= MAX_LINES {
        return Ok(());
    }
    let lines = map.features.iter().flat_map(|feature| map.points[feature.points.clone()].windows(2));
    let length: f64 = lines.map(|w| distance([w[0][0], w[0][1]], [w[1][0], w[1][1]])).sum();
    if length <= MAX_LINES {
        return Ok(());
    }
    Err(Error::Field {
        path: path.to_owned(),
        field: "map_features".to_owned(),
        found: format!("lines of {:.0} km in total", 1e-3 * length),
        expected: format!("at most {:.0} km", 1e-3 * MAX_LINES),
    })
}

/// Refuses a map with more than [`MOST_POINTS`] points in a square.
fn check_density(scene: &Scene, path: &Path) -> Result<(), Error> {
    let points = &scene.map.points;
    if most_in_slot(points) <= MOST_POINTS / 4 {
        return Ok(());
    }
    let square = |p: &[f64; 3]| [p[0], p[1]].map(|x| (x / SQUARE).floor() as i64);
    let mut squares: HashMap<[i64; 2], u32> = HashMap::new();
    points.iter().for_each(|p| *squares.entry(square(p)).or_default() += 1);
    let Some((at, count)) = squares.into_iter().max_by_key(|(at, count)| (*count, *at)) else {
        return Ok(());
    };
    if count <= MOST_POINTS {
        return Ok(());
    }
    let [x, y] = at.map(|k| k as f64 * SQUARE);
    Err(Error::Field {
        path: path.to_owned(),
        field: "map_features".to_owned(),
        found: format!("{count} points within {SQUARE} m of [{x}, {y}]"),
        expected: format!("at most {MOST_POINTS} points in a square of {SQUARE} m"),
    })
}

/// A quarter of an upper bound on the number of points in a square, fast to compute.
///
/// Squares shifted by half their side share slots. Four of them cover any square.
fn most_in_slot(points: &[[f64; 3]]) -> u32 {
    const SLOTS: usize = 4096;
    // Added to a number it rounds it to a whole one, in the lowest bits: faster than `floor`, which is a call.
    const ROUND: f64 = 1.5 * (1u64 << 52) as f64;
    let whole = |x: f64| (x / SQUARE + ROUND).to_bits() as u32;
    // Two tables in turn, because a count waits for the one before it.
    let mut slots = [[0u32; SLOTS]; 2];
    for (k, [x, y, _]) in points.iter().enumerate() {
        let slot = whole(*x).wrapping_mul(73) ^ whole(*y).wrapping_mul(179);
        slots[k % 2][slot as usize % SLOTS] += 1;
    }
    let [even, odd] = &slots;
    even.iter().zip(odd).map(|(a, b)| a + b).max().unwrap_or(0)
}

/// Upper bound on the total length of the lines, fast to compute: the sum of the steps along each axis,
/// including the steps from one feature to the next.
fn bound_of_lines(points: &[[f64; 3]]) -> f64 {
    let from = points.as_flattened();
    let to = from.get(3..).unwrap_or_default();
    let (mut from, mut to) = (from[..to.len()].chunks_exact(8), to.chunks_exact(8));
    // Eight independent sums, because each addition depends on the previous one.
    let mut sums = [0.0f64; 8];
    for (from, to) in from.by_ref().zip(to.by_ref()) {
        for lane in 0..8 {
            sums[lane] += (to[lane] - from[lane]).abs();
        }
    }
    let rest: f64 = from.remainder().iter().zip(to.remainder()).map(|(a, b)| (b - a).abs()).sum();
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_with_many_points_in_one_place_is_refused() {
        use sage_core::scene::{MapFeature, MapKind};
        let mut scene = crate::procedural::generate(crate::procedural::Kind::Straight, 0, 0).unwrap();
        let with = |scene: &mut Scene, count: usize, step: f64| {
            let map = std::sync::Arc::make_mut(&mut scene.map);
            let first = map.points.len();
            map.points.extend((0..count).map(|k| [step * k as f64, 500.0, 0.0]));
            let points = first..map.points.len();
            map.features.push(MapFeature { id: "many".into(), kind: MapKind::StopSign, points, lane: None });
        };
        with(&mut scene, 30_000, 0.01);
        check_density(&scene, Path::new("x")).unwrap();
        with(&mut scene, 4001, 1e-6);
        let error = check_density(&scene, Path::new("x")).unwrap_err().to_string();
        assert!(error.contains("at most 4000 points in a square of 4 m"), "{error}");
    }

    #[test]
    fn the_bound_of_lines_is_the_sum_of_steps_along_the_axes() {
        for n in 0..40 {
            let points: Vec<[f64; 3]> = (0..n).map(|k| [f64::from(k * k), f64::from(-3 * k), 0.0]).collect();
            let step = |w: &[[f64; 3]]| (w[1][0] - w[0][0]).abs() + (w[1][1] - w[0][1]).abs();
            let expected: f64 = points.windows(2).map(step).sum();
            assert_eq!(bound_of_lines(&points), expected, "{n} points");
        }
    }
}
