//! Which red lights a driver minds.

use std::sync::Arc;

use super::View;
use crate::{
    red_lights::{CREEPING, front},
    route::Localization,
    route_lights::{RouteLights, StopPlace},
};

/// A car that stops has missed the stop point if it is farther past it, metres.
const OVERSHOOT: f64 = 1.0;

/// How a driver stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Braking {
    /// Its strongest deceleration, m/s², > 0.
    pub deceleration: f64,
    /// Time by which the speed lags behind at the end, s, ≥ 0: it brakes by at most its speed through this time.
    pub lag: f64,
}

impl Braking {
    /// Distance in which a car of a speed (m/s) stands, metres.
    pub fn distance(&self, speed: f64) -> f64 {
        let slow = speed.min(self.deceleration * self.lag);
        (speed * speed - slow * slow) / (2.0 * self.deceleration) + slow * self.lag
    }
}

/// The red lights that a driver minds. It stops at a light that is red if it is not past the stop point and can stop before
/// it by its [`Braking`], or creeps. Otherwise it goes on, unless something slows it down until it can stop. Once it stops
/// at a light, it does so until the light is not red any more, or until it is a metre past the stop point, for example after
/// a push.
#[derive(Clone, Debug)]
pub struct RedLights {
    braking: Braking,
    /// Found at the first step.
    lights: Option<Arc<RouteLights>>,
    /// For each stop place, whether it stops there.
    stops: Vec<bool>,
}

impl RedLights {
    /// The red lights of a driver that brakes like this.
    pub fn new(braking: Braking) -> Self {
        Self { braking, lights: None, stops: Vec::new() }
    }

    /// The nearest stop place at which the car has to stop now.
    pub fn stop(&mut self, view: &View) -> Option<RedStop> {
        let lights = self.lights.get_or_insert_with(|| view.route_lights()).clone();
        if lights.stops().is_empty() {
            return None;
        }
        let front = view.route().locate(front(view.area()), Localization::Nearest).along;
        let speed = view.motion().body_velocity()[0].max(0.0);
        let is_red = |stop: &StopPlace| view.light(stop.light).is_red();
        self.decide(&lights, front, speed, is_red)
    }

    fn decide(
        &mut self,
        lights: &RouteLights,
        front: f64,
        speed: f64,
        is_red: impl Fn(&StopPlace) -> bool,
    ) -> Option<RedStop> {
        self.stops.resize(lights.stops().len(), false);
        let mut nearest = None;
        for (stop, stops) in lights.stops().iter().zip(&mut self.stops) {
            let gap = stop.along - front;
            let can_stop = gap > 0.0 && (speed <= CREEPING || self.braking.distance(speed) <= gap);
            *stops = is_red(stop) && (can_stop || (*stops && gap > -OVERSHOOT));
            if *stops && nearest.is_none() {
                nearest = Some(RedStop { along: stop.along, gap: gap.max(0.0) });
            }
        }
        nearest
    }
}

/// Where a car has to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RedStop {
    /// Distance of the stop point along the route, metres.
    pub along: f64,
    /// Distance from the front bumper to it, metres, ≥ 0.
    pub gap: f64,
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use sage_core::geometry::OrientedBox;

    use super::*;

    #[test]
    fn braking_distances_are_those_of_the_closed_form() {
        // 10²/(2·4) = 12.5 m.
        assert_relative_eq!(Braking { deceleration: 4.0, lag: 0.0 }.distance(10.0), 12.5);
        // With a lag of 0.5 s: 4 m/s² down to 2 m/s, (100 − 4)/8 = 12 m, then 2 · 0.5 = 1 m.
        let lagging = Braking { deceleration: 4.0, lag: 0.5 };
        assert_relative_eq!(lagging.distance(10.0), 13.0);
        assert_relative_eq!(lagging.distance(1.0), 0.5);
        assert_eq!(lagging.distance(0.0), 0.0);
    }

    /// Decisions of a driver that brakes by 4 m/s² at a light 20 m along the route.
    fn decisions(frames: &[(f64, f64, bool)]) -> Vec<bool> {
        let lights = RouteLights::of(vec![StopPlace { light: 0, along: 20.0 }]);
        let mut driver = RedLights::new(Braking { deceleration: 4.0, lag: 0.0 });
        let stops = |(front, speed, is_red): &(f64, f64, bool)| {
            driver.decide(&lights, *front, *speed, |_| *is_red).is_some()
        };
        frames.iter().map(stops).collect()
    }

    #[test]
    fn a_driver_stops_if_it_can_and_keeps_to_that() {
        // From 10 m/s it needs 12.5 m.
        assert_eq!(decisions(&[(7.4, 10.0, true), (12.0, 9.9, true)]), [true, true]);
        // It goes on if it cannot stop, until something slows it down.
        assert_eq!(
            decisions(&[(7.6, 10.0, true), (9.0, 10.0, true), (15.0, 6.0, true)]),
            [false, false, true]
        );
        // Green in between: it decides anew.
        assert_eq!(
            decisions(&[(7.6, 10.0, true), (8.0, 9.0, false), (9.0, 9.0, true)]),
            [false, false, true]
        );
        // Past the stop point; creeping; pushed over it by less and by more than a metre.
        assert_eq!(decisions(&[(20.0, 5.0, true)]), [false]);
        assert_eq!(decisions(&[(19.99, 0.5, true)]), [true]);
        assert_eq!(
            decisions(&[(18.0, 0.0, true), (20.9, 1.0, true), (21.1, 1.0, true)]),
            [true, true, false]
        );
    }

    #[test]
    fn the_gap_is_that_of_the_front_bumper() {
        let lights = RouteLights::of(vec![StopPlace { light: 0, along: 20.0 }]);
        let mut driver = RedLights::new(Braking { deceleration: 4.0, lag: 0.0 });
        let stop = driver.decide(&lights, 12.0, 3.0, |_| true).unwrap();
        assert_eq!((stop.along, stop.gap), (20.0, 8.0));
        let area = OrientedBox::new([1.0, 2.0], std::f64::consts::FRAC_PI_2, 4.0, 2.0);
        assert_relative_eq!(front(&area)[0], 1.0, epsilon = 1e-12);
        assert_relative_eq!(front(&area)[1], 4.0, epsilon = 1e-12);
    }
}
