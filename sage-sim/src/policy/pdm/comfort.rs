//! Comfort of a driven proposal by nuPlan's bounds: accelerations and jerk from one parabola through all states, as in the
//! planner but for its first smoothing over eight states.

use std::sync::LazyLock;

use sage_core::motion::DT;

use super::{proposals::STEPS, tracker::Driven};
use crate::{
    comfort::{ACCELERATION, JERK, JERK_OF_MAGNITUDE, turns_gently},
    smoothing::Filter,
};

static PARABOLA: LazyLock<Filter> = LazyLock::new(|| Filter::new(STEPS + 1, 2, 0));
static SLOPE: LazyLock<Filter> = LazyLock::new(|| Filter::new(STEPS + 1, 2, 1));

/// Whether all bounds hold. The lateral acceleration of these states is 0, as in the published planner.
pub(super) fn is_comfortable(states: &[Driven]) -> bool {
    let along: Vec<f64> = states.iter().map(|state| state.acceleration).collect();
    let magnitude: Vec<f64> = along.iter().map(|a| a.abs()).collect();
    let is_smooth = |series: &[f64], most: f64| SLOPE.apply(series).iter().all(|x| x.abs() <= most * DT);
    let headings: Vec<f64> = states.iter().map(|state| state.heading).collect();
    PARABOLA.apply(&along).iter().all(|a| (ACCELERATION[0]..=ACCELERATION[1]).contains(a))
        && is_smooth(&along, JERK)
        && is_smooth(&magnitude, JERK_OF_MAGNITUDE)
        && turns_gently(&headings)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn holds(of: impl Fn(f64) -> (f64, f64)) -> bool {
        let state = |k: usize| {
            let (acceleration, heading) = of(DT * k as f64);
            Driven { axle: [0.0; 2], heading, speed: 10.0, acceleration, steering: 0.0 }
        };
        is_comfortable(&(0..=STEPS).map(state).collect::<Vec<_>>())
    }

    #[test]
    fn bounds_are_nuplans() {
        assert!(holds(|_| (-4.0, 0.0)) && !holds(|_| (-4.1, 0.0)));
        assert!(holds(|t| (-4.0 + t, 0.0)));
        // The slope of the parabola is largest at the ends.
        let parabola = |a: f64| move |t: f64| (-4.0 + a * (t - 2.0) * (t - 2.0), 0.0);
        assert!(holds(parabola(1.0)) && !holds(parabola(1.1)));
        assert!(holds(|t| (0.0, 0.94 * t)) && !holds(|t| (0.0, 0.96 * t)));
        let bend = |a: f64| move |t: f64| (0.0, 0.5 * a * (t - 2.0) * (t - 2.0));
        assert!(holds(bend(0.45)) && !holds(bend(2.0)));
    }
}
