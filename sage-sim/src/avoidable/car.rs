//! The ego as a kinematic bicycle within limits.

use sage_core::{
    geometry::{OrientedBox, Point, cross, dot},
    motion::DT,
};

use super::{
    limits::AvoidanceOptions,
    reference_line::{Place, ReferenceLine},
    surroundings::MARGIN,
};

/// Rear axle behind the centre of the box, and wheelbase, as shares of the length.
const REAR: f64 = 0.3;
const WHEELBASE: f64 = 0.6;
/// Share of the lateral limit that a sidestep plans with; the rest corrects.
const PLANNED: f64 = 0.85;
/// Time constant of a sidestep near its end, seconds.
const SETTLING: f64 = 0.25;
/// Largest angle of a sidestep to the line: its sine.
const STEEPEST: f64 = 0.7;
/// Speed below which a car does not sidestep, m/s.
const CRAWLING: f64 = 0.3;

/// Size and limits of the ego.
#[derive(Clone, Copy)]
pub(super) struct Car {
    half: [f64; 2],
    /// Distance of the rear axle behind the centre, metres.
    pub(super) rear: f64,
    largest_curvature: f64,
    options: AvoidanceOptions,
}

/// State of the car.
#[derive(Clone, Copy)]
pub(super) struct CarState {
    /// Centre of the rear axle.
    pub(super) axle: Point,
    /// Unit direction.
    pub(super) axis: Point,
    pub(super) speed: f64,
    /// Acceleration of the step before, m/s².
    acceleration: f64,
    /// Distance along the reference line, metres.
    pub(super) station: f64,
}

impl Car {
    pub(super) fn new(area: &OrientedBox, options: AvoidanceOptions) -> Self {
        let length = 2.0 * area.half_length;
        Self {
            half: [area.half_length, area.half_width],
            rear: REAR * length,
            largest_curvature: options.steering.tan() / (WHEELBASE * length),
            options,
        }
    }

    /// The state with the box at a place, at a station of the line.
    pub(super) fn state(&self, area: &OrientedBox, speed: f64, station: f64) -> CarState {
        CarState { axle: self.axle(area), axis: area.axis, speed, acceleration: 0.0, station }
    }

    /// The rear axle of a box.
    pub(super) fn axle(&self, area: &OrientedBox) -> Point {
        [area.center[0] - self.rear * area.axis[0], area.center[1] - self.rear * area.axis[1]]
    }

    /// The box of a state, grown by the margin.
    pub(super) fn area(&self, state: &CarState) -> OrientedBox {
        let center = [state.axle[0] + self.rear * state.axis[0], state.axle[1] + self.rear * state.axis[1]];
        let [half_length, half_width] = self.half.map(|half| half + MARGIN);
        OrientedBox { center, axis: state.axis, half_length, half_width }
    }

    /// A recorded box, grown by the margin.
    pub(super) fn grown(&self, area: &OrientedBox) -> OrientedBox {
        let [half_length, half_width] = self.half.map(|half| half + MARGIN);
        OrientedBox { half_length, half_width, ..*area }
    }

    /// Acceleration and length of a step towards a commanded acceleration; the speed never falls below 0.
    pub(super) fn along(&self, speed: f64, before: f64, command: f64) -> (f64, f64, f64) {
        let o = &self.options;
        let command = command.clamp(-o.brake, o.accelerate);
        let a = o.jerk.map_or(command, |jerk| command.clamp(before - jerk * DT, before + jerk * DT));
        let next = speed + a * DT;
        if next >= 0.0 { (a, next, 0.5 * (speed + next) * DT) } else { (a, 0.0, 0.5 * speed * speed / -a) }
    }

    /// One step with a commanded acceleration, towards an offset from the line (metres, positive to the left).
    pub(super) fn step(&self, state: &mut CarState, command: f64, offset: f64, line: &ReferenceLine) {
        let (a, next, length) = self.along(state.speed, state.acceleration, command);
        let place = line.place(state.axle, state.station);
        let curvature = self.curvature(state, &place, offset, state.speed.max(next), a);
        let turn = curvature * length;
        // The chord of an arc.
        let half = 0.5 * turn;
        let chord = if half.abs() > 1e-6 { length * half.sin() / half } else { length };
        let (sin, cos) = half.sin_cos();
        let mid = [state.axis[0] * cos - state.axis[1] * sin, state.axis[0] * sin + state.axis[1] * cos];
        let axis = [mid[0] * cos - mid[1] * sin, mid[0] * sin + mid[1] * cos];
        let axle = [state.axle[0] + chord * mid[0], state.axle[1] + chord * mid[1]];
        let station = place.station + chord * dot(mid, place.along);
        *state = CarState { axle, axis, speed: next, acceleration: a, station };
    }

    /// Curvature towards an offset from the line, as fast as the limits allow, levelling off along the line.
    fn curvature(&self, state: &CarState, place: &Place, offset: f64, speed: f64, a: f64) -> f64 {
        let o = &self.options;
        if speed < CRAWLING {
            return 0.0;
        }
        let grip = if o.ellipse {
            let share = a / if a < 0.0 { o.brake } else { o.accelerate.max(o.brake) };
            o.lateral * (1.0 - share * share).max(0.0).sqrt()
        } else {
            o.lateral
        };
        let most = (grip / (speed * speed)).min(o.yaw_rate / speed).min(self.largest_curvature);
        let error = place.offset - offset;
        // The speed across from which the rest of the way just suffices to stop.
        let brakes = PLANNED * most * speed * speed;
        let across = -error.signum() * (2.0 * brakes * error.abs()).sqrt().min(error.abs() / SETTLING);
        let sine = (across / speed).clamp(-STEEPEST, STEEPEST);
        let wanted = sine.asin();
        let angle = cross(place.along, state.axis).atan2(dot(place.along, state.axis));
        (place.curvature + (wanted - angle) / (speed * DT)).clamp(-most, most)
    }
}
