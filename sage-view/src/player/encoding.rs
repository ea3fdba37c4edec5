//! Motions of road users as small integers.

use std::f64::consts::TAU;

use sage_core::geometry::{Point, norm};
use sage_sim::vehicle::Motion;
use serde::Serialize;

/// State at one frame.
#[derive(Clone, Copy)]
pub(super) struct FrameState {
    /// Position, metres.
    pub(super) at: Point,
    heading: f64,
    speed: f64,
}

impl FrameState {
    /// The state of a motion, relative to an origin.
    pub(super) fn of_motion(motion: &Motion, origin: Point) -> Self {
        let at = [0, 1].map(|k| motion.position[k] - origin[k]);
        Self { at, heading: motion.heading, speed: norm(motion.velocity) }
    }
}

/// A road user: its box in centimetres, and its motion in runs of consecutive frames.
#[derive(Default, Serialize)]
pub(crate) struct EncodedBody {
    length: i64,
    width: i64,
    kind: &'static str,
    runs: Vec<Run>,
}

/// Consecutive frames: each number is the difference to the one before.
#[derive(Default, Serialize)]
struct Run {
    first: usize,
    x: Vec<i64>,
    y: Vec<i64>,
    h: Vec<i64>,
    v: Vec<i64>,
}

impl EncodedBody {
    /// Encodes states at increasing frames; `None` without any.
    pub(super) fn of(
        states: impl Iterator<Item = (usize, FrameState)>,
        [length, width]: [f64; 2],
        kind: &'static str,
    ) -> Option<Self> {
        let mut runs: Vec<Run> = Vec::new();
        let mut last: Option<(usize, [i64; 4], f64)> = None;
        for (frame, state) in states {
            let before = last.filter(|(at, ..)| at + 1 == frame);
            // Headings go on without jumps, so that the page can interpolate.
            let turned = before.map_or(state.heading, |(_, _, heading)| {
                heading + (state.heading - heading + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU
            });
            let [x, y] = state.at.map(hundredths);
            let numbers = [x, y, (1e3 * turned).round() as i64, hundredths(state.speed)];
            let from = before.map_or([0; 4], |(_, numbers, _)| numbers);
            if before.is_none() {
                runs.push(Run { first: frame, ..Run::default() });
            }
            if let Some(run) = runs.last_mut() {
                for (k, column) in [&mut run.x, &mut run.y, &mut run.h, &mut run.v].into_iter().enumerate() {
                    column.push(numbers[k] - from[k]);
                }
            }
            last = Some((frame, numbers, turned));
        }
        let [length, width] = [length, width].map(hundredths);
        (!runs.is_empty()).then_some(Self { length, width, kind, runs })
    }
}

/// A number in hundredths.
pub(super) fn hundredths(x: f64) -> i64 {
    (100.0 * x).round() as i64
}

/// Integers as differences to the one before.
pub(super) fn differences(numbers: impl Iterator<Item = f64>) -> Vec<i64> {
    let mut before = 0;
    numbers.map(hundredths).map(|n| n - std::mem::replace(&mut before, n)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_start_new_runs_and_headings_do_not_jump() {
        let state = |x: f64, heading: f64| FrameState { at: [x, -x], heading, speed: 2.0 };
        let states = [(3, state(1.0, 3.1)), (4, state(1.5, -3.1)), (7, state(2.0, 0.1))];
        let body = EncodedBody::of(states.into_iter(), [4.5, 1.9], "vehicle").unwrap();
        let runs: Vec<_> = body.runs.iter().map(|r| (r.first, &r.x[..], &r.h[..], &r.v[..])).collect();
        // 2π − 6.2 = 0.083 rad on from 3.1 rad.
        assert_eq!(runs[0], (3, &[100, 50][..], &[3100, 83][..], &[200, 0][..]));
        assert_eq!(runs[1], (7, &[200][..], &[100][..], &[200][..]));
        assert_eq!((body.length, body.width, runs.len()), (450, 190, 2));
        assert!(EncodedBody::of(std::iter::empty(), [1.0, 1.0], "other").is_none());
    }
}
