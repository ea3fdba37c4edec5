//! Mirror images about the x axis of the curve's frame: what a policy learns on one side of the road holds on the other.

use sage_backbones::goose::{ACTION, Features, REST};

use super::{curve::CONTROL_POINTS, features::NUMBERS};

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
