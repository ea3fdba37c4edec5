//! Systematic sampling of plans along a curve: the estimator of a rate.
//!
//! Plans are ordered along a Hilbert curve of their ends, so that neighbours in the order are neighbours on the map and mostly have the
//! same outcome. Each is driven with a probability of inclusion, all by one random start, and its outcome is
//! weighted by the inverse (Horvitz and Thompson 1952): the estimate has no bias, and with enough drives all are driven and it is exact.

use sage_core::geometry::Point;

/// Bits of a coordinate on the curve.
const BITS: u32 = 16;

/// Probabilities of inclusion, proportional to those of the plans and at most 1, that sum to a number of drives; 1 for all if there
/// are no more plans than drives. Plans of probability 0 are never driven.
///
/// ```
/// use sage_sim::rate::inclusions;
///
/// // Twice as likely, twice as often; what is likelier than one of the two drives is driven for sure.
/// assert_eq!(inclusions(&[0.6, 0.2, 0.2], 2), [1.0, 0.5, 0.5]);
/// assert_eq!(inclusions(&[0.6, 0.4], 2), [1.0, 1.0]);
/// ```
pub fn inclusions(probabilities: &[f64], drives: usize) -> Vec<f64> {
    let possible = probabilities.iter().filter(|p| **p > 0.0).count();
    if possible <= drives {
        return probabilities.iter().map(|p| if *p > 0.0 { 1.0 } else { 0.0 }).collect();
    }
    // Those that reach 1 leave the rest of the drives to the others.
    let mut is_sure = vec![false; probabilities.len()];
    loop {
        let sure = is_sure.iter().filter(|is| **is).count();
        let others = || probabilities.iter().zip(&is_sure).filter(|(_, is)| !**is);
        let mass: f64 = others().map(|(p, _)| p).sum();
        let scale = (drives - sure) as f64 / mass;
        let mut has_new = false;
        for (p, is) in probabilities.iter().zip(&mut is_sure) {
            if !*is && scale * p >= 1.0 {
                (*is, has_new) = (true, true);
            }
        }
        if !has_new {
            let inclusion = |(p, is): (&f64, &bool)| if *is { 1.0 } else { scale * p };
            return probabilities.iter().zip(&is_sure).map(inclusion).collect();
        }
    }
}

/// Numbers of the plans that are driven, in the order of the curve: those at which the sum of the inclusions passes a whole number and
/// `start`, 0 to 1.
pub fn systematic(ends: &[Point], inclusions: &[f64], start: f64) -> Vec<usize> {
    let mut next = start;
    let mut sum = 0.0;
    let mut chosen = Vec::new();
    for k in along_curve(ends) {
        // What is driven for sure needs no luck, and takes none from the others.
        if inclusions[k] >= 1.0 {
            chosen.push(k);
            continue;
        }
        sum += inclusions[k];
        if sum > next {
            chosen.push(k);
            next += 1.0;
        }
    }
    chosen
}

/// Numbers of points along a Hilbert curve through their bounds; of equal ones in their order.
fn along_curve(points: &[Point]) -> Vec<usize> {
    let bounds = sage_core::geometry::Aabb::of(points.iter().copied());
    let size = (bounds.max[0] - bounds.min[0]).max(bounds.max[1] - bounds.min[1]).max(1e-9);
    let cells = f64::from((1u32 << BITS) - 1);
    let place = |p: &Point| {
        let [x, y] = [0, 1].map(|axis| ((p[axis] - bounds.min[axis]) / size * cells) as u32);
        hilbert(x, y)
    };
    let places: Vec<u64> = points.iter().map(place).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|k| (places[*k], *k));
    order
}

/// Distance along the Hilbert curve of a cell.
fn hilbert(mut x: u32, mut y: u32) -> u64 {
    let mut distance = 0;
    for bit in (0..BITS).rev() {
        let (right, up) = (x >> bit & 1, y >> bit & 1);
        distance += u64::from((3 * right) ^ up) << (2 * bit);
        if up == 0 {
            if right == 1 {
                let all = (1 << bit) - 1;
                (x, y) = (all - (x & all), all - (y & all));
            }
            (x, y) = (y, x);
        }
        let below = (1u32 << bit) - 1;
        (x, y) = (x & below, y & below);
    }
    distance
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::seed::Rng;

    #[test]
    fn the_curve_visits_every_cell_once_and_neighbours_in_turn() {
        // Within an aligned square of 8 by 8 cells the curve takes 64 steps, each to a neighbour.
        let mut cells: Vec<(u64, [i64; 2])> =
            (0..64).map(|k| [k % 8, k / 8]).map(|[x, y]| (hilbert(x as u32, y as u32), [x, y])).collect();
        cells.sort_unstable();
        assert!(cells.windows(2).all(|w| w[1].0 - w[0].0 == 1));
        let step = |w: &[(u64, [i64; 2])]| (w[1].1[0] - w[0].1[0]).abs() + (w[1].1[1] - w[0].1[1]).abs();
        assert!(cells.windows(2).all(|w| step(w) == 1), "{cells:?}");
    }

    #[test]
    fn inclusions_sum_to_the_drives_and_estimates_have_no_bias() {
        let mut rng = Rng::new(1, "population", "test");
        let ends: Vec<Point> = (0..200).map(|_| [rng.uniform(0.0, 50.0), rng.uniform(0.0, 20.0)]).collect();
        let weights: Vec<f64> = ends.iter().map(|_| rng.unit().powi(6)).collect();
        let mass: f64 = weights.iter().sum();
        let probabilities: Vec<f64> = weights.iter().map(|w| w / mass).collect();
        let fails = |k: usize| ends[k][0] > 35.0;
        let truth: f64 = (0..200).filter(|k| fails(*k)).map(|k| probabilities[k]).sum();
        for drives in [1, 8, 64, 199, 200] {
            let inclusions = inclusions(&probabilities, drives);
            assert!((inclusions.iter().sum::<f64>() - drives as f64).abs() < 1e-9, "{drives}");
            let (mut sum, mut squares, starts) = (0.0, 0.0, 1000);
            for k in 0..starts {
                let chosen = systematic(&ends, &inclusions, (f64::from(k) + rng.unit()) / f64::from(starts));
                assert!(chosen.len().abs_diff(drives) <= 1);
                let one: f64 =
                    chosen.iter().filter(|k| fails(**k)).map(|k| probabilities[*k] / inclusions[*k]).sum();
                sum += one;
                squares += one * one;
            }
            let mean = sum / f64::from(starts);
            let error = ((squares / f64::from(starts) - mean * mean).max(0.0) / f64::from(starts)).sqrt();
            assert!((mean - truth).abs() < 4.0 * error + 1e-9, "{drives}: {mean} and {truth}, {error}");
        }
    }
}
