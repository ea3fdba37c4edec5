//! The ego on a manoeuvre, step by step.

use sage_core::geometry::{OrientedBox, norm, sub};

use super::{Avoidance, car::CarState, manoeuvres::Manoeuvre};

/// The ego on a manoeuvre.
pub(super) enum Motion<'m> {
    /// Steered along the line, at an offset.
    Steered { state: CarState, manoeuvre: &'m Manoeuvre, offset: f64 },
    /// On the recorded path: step of the path, metres beyond it, speed and acceleration.
    OnPath { manoeuvre: &'m Manoeuvre, step: usize, beyond: f64, speed: f64, acceleration: f64 },
}

impl<'m> Motion<'m> {
    pub(super) fn new(avoidance: &Avoidance, start: usize, manoeuvre: &'m Manoeuvre) -> Self {
        let speed = avoidance.speed(start);
        match manoeuvre.sidestep {
            None => Self::OnPath { manoeuvre, step: start, beyond: 0.0, speed, acceleration: 0.0 },
            Some(sidestep) => {
                let area = &avoidance.path[start];
                let state = avoidance.car.state(area, speed, avoidance.stations[start]);
                let place = avoidance.line.place(state.axle, state.station);
                Self::Steered { state, manoeuvre, offset: place.offset + sidestep }
            }
        }
    }

    /// Box and speed after the next step, `time` seconds after the start.
    pub(super) fn step(&mut self, avoidance: &Avoidance, time: f64) -> (OrientedBox, f64) {
        let acts = time + 1e-9 >= avoidance.options.dead_time;
        let time = time - avoidance.options.dead_time;
        match self {
            Self::Steered { state, manoeuvre, offset } => {
                let command = if acts { manoeuvre.acceleration(time) } else { 0.0 };
                let line = &avoidance.line;
                let offset = if acts { *offset } else { line.place(state.axle, state.station).offset };
                avoidance.car.step(state, command, offset, line);
                (avoidance.car.area(state), state.speed)
            }
            Self::OnPath { manoeuvre, step, beyond, speed, acceleration } => {
                let command = if acts { manoeuvre.acceleration(time) } else { 0.0 };
                let (a, next, length) = avoidance.car.along(*speed, *acceleration, command);
                (*speed, *acceleration) = (next, a);
                *beyond += length;
                let path = &avoidance.path;
                while let Some(ahead) = path.get(*step + 1) {
                    let leg = norm(sub(ahead.center, path[*step].center));
                    if *beyond < leg {
                        let share = *beyond / leg;
                        return (avoidance.car.grown(&path[*step].between(ahead, share)), next);
                    }
                    *beyond -= leg;
                    *step += 1;
                }
                let end = &path[*step];
                let center = [end.center[0] + *beyond * end.axis[0], end.center[1] + *beyond * end.axis[1]];
                (avoidance.car.grown(&OrientedBox { center, ..*end }), next)
            }
        }
    }
}
