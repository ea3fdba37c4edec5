//! Mirror images about the x axis of the curve's frame: what a policy learns on one side of the road holds on the other.

use super::{curve::CONTROL_POINTS, features::NUMBERS};
use crate::goose::networks::{ACTION, Features, REST};

/// Numbers of an agent that change their sign: positions and velocities to the left, and headings.
const OF_AGENT: [usize; 3] = [1, 3, 4];
/// Number of weights, and of each coordinate, in states and actions.
const CHANGED: usize = CONTROL_POINTS - 1;

/// The rows of a mirrored drive.
pub fn mirrored_rows(rows: &[Features]) -> Vec<Features> {
    let mut rows = rows.to_vec();
    for agent in rows.iter_mut().flat_map(|row| row.chunks_exact_mut(NUMBERS)) {
        OF_AGENT.iter().for_each(|k| agent[*k] = -agent[*k]);
    }
    rows
}

/// The rest of a mirrored state: points of the curve are x, y in turn, after the weights.
pub fn mirrored_rest(rest: &[f32; REST]) -> [f32; REST] {
    let mut rest = *rest;
    (0..CHANGED).for_each(|k| rest[CHANGED + 2 * k + 1] = -rest[CHANGED + 2 * k + 1]);
    rest
}

/// A mirrored action: changes of y come after those of weights and of x.
pub fn mirrored_action(action: &[f64; ACTION]) -> [f64; ACTION] {
    std::array::from_fn(|k| if k < 2 * CHANGED { action[k] } else { -action[k] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goose::Curve;

    #[test]
    fn a_mirrored_curve_changes_as_the_mirror_image_of_a_curve() {
        let path: Vec<[f64; 2]> = (0..81).map(|k| [0.5 * f64::from(k), 0.003 * f64::from(k * k)]).collect();
        let flipped: Vec<[f64; 2]> = path.iter().map(|[x, y]| [*x, -y]).collect();
        let [curve, mirrored] = [&path, &flipped].map(|path| Curve::fit(path).unwrap());
        let action = std::array::from_fn(|k| 0.07 * k as f64 - 0.4);
        let (changed, expected) = (curve.changed(&action), mirrored.changed(&mirrored_action(&action)));
        let rest = |curve: &Curve| {
            let mut rest = [0.25; REST];
            rest.iter_mut().zip(curve.state()).for_each(|(to, x)| *to = x as f32);
            rest
        };
        let distance =
            |a: [f32; REST], b: [f32; REST]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(distance(mirrored_rest(&rest(&changed)), rest(&expected)) < 1e-4);
        assert!(distance(rest(&changed), rest(&expected)) > 0.1);
    }

    #[test]
    fn twice_mirrored_rows_are_the_rows() {
        let row: Features = std::array::from_fn(|k| k as f32 + 1.0);
        let mirrored = mirrored_rows(&[row]);
        assert_eq!(mirrored_rows(&mirrored), [row]);
        // Position and velocity to the left, and heading, of each of the five road users.
        let changed: Vec<usize> = (0..row.len()).filter(|k| mirrored[0][*k] == -row[*k]).collect();
        assert_eq!(changed.len(), 15);
        assert_eq!(changed[..4], [1, 3, 4, 9]);
    }
}
