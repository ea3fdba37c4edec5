//! How tightly a car turns, and how fast it takes a turn.
//!
//! *Turn per metre*: change of the direction of motion within 2 m of path, divided by 2 m, from the heading at *now* on. The path
//! goes from point to point 0.5 m apart, so that noise of a slow or standing car does not count; one that drives backwards
//! moves opposite to its heading. A car of at most 6 m may turn by 0.25 rad a metre (a radius of its centre of 4 m), a longer
//! one by less in proportion to its length: a bus of 12 m by 0.125, 8 m, which fits the circle of 12.5 m around its outer
//! corner that EU Directive 97/27/EC asks for. *Lateral acceleration*: speed times turn between the half seconds before and
//! after a step.
//!
//! Of 888 moving vehicles recorded in the scenes of the choice 1.9 % turn more tightly, and none takes a turn with more than
//! 5.1 m/s² (`cargo run --release -p sage-data --example recorded_limits`).

use super::{Candidate, Convention};
use crate::{
    geometry::{Point, dot, norm, sub},
    motion::{DT, HORIZON},
};

/// Largest turn per metre of a car, rad/m.
pub const TURN: f64 = 0.25;
/// Largest lateral acceleration, m/s²: the threshold of the kinematic penalty.
pub const LATERAL: f64 = 6.0;
/// Length from which on a vehicle turns less tightly, metres.
const LONG: f64 = 6.0;
/// Path within which a turn counts, metres.
const WINDOW: f64 = 2.0;
/// Distance of two points of the path, metres …
const APART: f64 = 0.5;
/// … and of the last one.
const LAST_APART: f64 = 0.4;
/// Steps before and after one between which its lateral acceleration is measured.
const HALF: usize = 5;

/// A limit that a plan exceeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// First step at which the limit is exceeded, 1 to the horizon.
    pub step: usize,
    /// Largest value over the whole plan: rad/m, m/s² or m/s.
    pub value: f64,
    /// The limit.
    pub limit: f64,
}

impl Excess {
    pub(super) fn of(values: impl Iterator<Item = (usize, f64)>, limit: f64) -> Option<Self> {
        let beyond = values.filter(|(_, value)| *value > limit);
        beyond.fold(None, |found: Option<Self>, (step, value)| match found {
            None => Some(Self { step, value, limit }),
            Some(first) => Some(Self { value: first.value.max(value), ..first }),
        })
    }
}

/// Whether a candidate turns by more than a limit, rad/m, that of a car of at most 6 m. The published code knows no heading
/// *now*.
pub fn tight_turn(candidate: &Candidate, limit: f64) -> Option<Excess> {
    if candidate.convention() == Convention::Release {
        return None;
    }
    let length = 2.0 * candidate.box_now().half_length;
    Excess::of(turns_per_metre(candidate), limit * (LONG / length).min(1.0))
}

/// Whether a candidate takes a turn with more than a lateral acceleration, m/s².
pub fn fast_turn(candidate: &Candidate, limit: f64) -> Option<Excess> {
    if candidate.convention() == Convention::Release {
        return None;
    }
    Excess::of(lateral_accelerations(candidate), limit)
}

/// A direction of motion at a place of the path.
#[derive(Clone, Copy)]
struct Direction {
    /// Step at which it is known.
    step: usize,
    /// Path since *now*, metres.
    along: f64,
    axis: Point,
    /// Turn since *now*, rad.
    turned: f64,
}

/// The largest turn per metre that ends at each point of the path, rad/m.
fn turns_per_metre(candidate: &Candidate) -> impl Iterator<Item = (usize, f64)> {
    let directions = directions(candidate);
    let mut first = 0;
    (1..directions.len()).map(move |k| {
        let last = directions[k];
        while last.along - directions[first].along > WINDOW {
            first += 1;
        }
        let turn = directions[first..k].iter().map(|before| (last.turned - before.turned).abs());
        (last.step, turn.fold(0.0, f64::max) / WINDOW)
    })
}

/// The directions of motion from point to point, each in the middle between two; first the heading at *now*.
fn directions(candidate: &Candidate) -> Vec<Direction> {
    let axis = candidate.box_now().axis;
    let mut all = Vec::with_capacity(HORIZON + 1);
    all.push(Direction { step: 0, along: 0.0, axis, turned: 0.0 });
    let (mut at, mut along) = (candidate.start().position, 0.0);
    let mut farthest = (0, LAST_APART);
    let points = candidate.points();
    for (step, point) in (1..).zip(points) {
        let length = norm(sub(*point, at));
        if length >= APART {
            all.push(next_direction(candidate, &all[all.len() - 1], step, at, along + 0.5 * length));
            (at, along, farthest) = (*point, along + length, (0, LAST_APART));
        } else if length >= farthest.1 {
            farthest = (step, length);
        }
    }
    if let (step @ 1.., length) = farthest {
        all.push(next_direction(candidate, &all[all.len() - 1], step, at, along + 0.5 * length));
    }
    all
}

/// The direction from a point to that of a step.
fn next_direction(
    candidate: &Candidate,
    before: &Direction,
    step: usize,
    from: Point,
    along: f64,
) -> Direction {
    let way = sub(candidate.points()[step - 1], from);
    let mut axis = way.map(|x| x / norm(way));
    // Where motion and heading are opposite it drives backwards.
    if dot(axis, before.axis) < 0.0 && dot(axis, candidate.profile().axis[step - 1]) < 0.0 {
        axis = axis.map(|x| -x);
    }
    Direction { step, along, axis, turned: before.turned + angle(before.axis, axis) }
}

/// The lateral acceleration at each step with half a second before and after it, m/s².
fn lateral_accelerations(candidate: &Candidate) -> impl Iterator<Item = (usize, f64)> {
    let at = |step: usize| match step {
        0 => candidate.start().position,
        step => candidate.points()[step - 1],
    };
    let seconds = HALF as f64 * DT;
    (HALF..(candidate.horizon() + 1).saturating_sub(HALF)).filter_map(move |step| {
        let before = sub(at(step), at(step - HALF));
        let after = sub(at(step + HALF), at(step));
        let lengths = [norm(before), norm(after)];
        // A change of direction without room for a curve is no lateral acceleration: `half_turn` and the turn per metre.
        if lengths.iter().any(|length| *length < APART) || dot(before, after) < 0.0 {
            return None;
        }
        let speed = 0.5 * (lengths[0] + lengths[1]) / seconds;
        Some((step, speed * angle(before, after).abs() / seconds))
    })
}

/// Angle from one direction to another, −π to π.
fn angle(from: Point, to: Point) -> f64 {
    (from[0] * to[1] - from[1] * to[0]).atan2(dot(from, to))
}
