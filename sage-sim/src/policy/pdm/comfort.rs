//! Comfort of a driven proposal by nuPlan's bounds.
//!
//! The planner smooths accelerations with one parabola through all states, and differences of headings with the
//! polynomial through five of them (Savitzky and Golay).

use sage_core::motion::DT;

use super::tracker::Driven;

/// Range of the longitudinal acceleration, m/s².
const ACCELERATION: [f64; 2] = [-4.05, 2.40];
/// Largest longitudinal jerk, and jerk of the acceleration's magnitude, m/s³.
const JERK: f64 = 4.13;
const JERK_OF_MAGNITUDE: f64 = 8.37;
/// Largest yaw rate, rad/s, and yaw acceleration, rad/s².
const YAW_RATE: f64 = 0.95;
const YAW_ACCELERATION: f64 = 1.93;

/// Whether all bounds hold. The lateral acceleration of these states is 0, as in the published planner.
pub(super) fn is_comfortable(states: &[Driven]) -> bool {
    let along: Vec<f64> = states.iter().map(|state| state.acceleration).collect();
    let magnitude: Vec<f64> = along.iter().map(|a| a.abs()).collect();
    let smooth = Parabola::through(&along);
    let last = (states.len() - 1) as f64;
    let bounded = |k: usize| (ACCELERATION[0]..=ACCELERATION[1]).contains(&smooth.value(k as f64));
    // The slope of a parabola is largest at an end.
    let is_smooth =
        |parabola: &Parabola, most: f64| [0.0, last].iter().all(|k| (parabola.slope(*k) / DT).abs() <= most);
    (0..states.len()).all(bounded)
        && is_smooth(&smooth, JERK)
        && is_smooth(&Parabola::through(&magnitude), JERK_OF_MAGNITUDE)
        && turns_gently(states)
}

fn turns_gently(states: &[Driven]) -> bool {
    let heading = |k: usize| states[k].heading - states[0].heading;
    let count = states.len();
    (0..count).all(|k| {
        // The window of five states around the state, or at the end of the series.
        let center = k.clamp(2, count.max(5) - 3);
        if center + 2 >= count {
            return true;
        }
        let y: [f64; 5] = std::array::from_fn(|n| heading(center + n - 2));
        let offset = k as f64 - center as f64;
        let slope = (2.0 * (y[4] - y[0]) + y[3] - y[1]) / 10.0;
        let bend = (2.0 * (y[0] + y[4]) - y[1] - 2.0 * y[2] - y[3]) / 7.0;
        let third = (y[4] - y[0] - 2.0 * (y[3] - y[1])) / 2.0;
        let rate = (slope + offset * bend) / DT;
        let acceleration = (bend + offset * third) / (DT * DT);
        rate.abs() <= YAW_RATE && acceleration.abs() <= YAW_ACCELERATION
    })
}

/// The parabola nearest to a series, over the index.
struct Parabola([f64; 3]);

impl Parabola {
    fn through(series: &[f64]) -> Self {
        let n = series.len() as f64;
        let middle = 0.5 * (n - 1.0);
        // Polynomials that are orthogonal on the series: 1, x, x² − mean of x².
        let square = (n * n - 1.0) / 12.0;
        let mut sums = [0.0; 3];
        let mut norms = [0.0; 3];
        for (k, y) in series.iter().enumerate() {
            let x = k as f64 - middle;
            for (i, basis) in [1.0, x, x * x - square].into_iter().enumerate() {
                sums[i] += y * basis;
                norms[i] += basis * basis;
            }
        }
        let [a, b, c] = [0, 1, 2].map(|i| sums[i] / f64::max(norms[i], 1e-12));
        // Around the start of the series.
        Self([a - b * middle + c * (middle * middle - square), b - 2.0 * c * middle, c])
    }

    fn value(&self, k: f64) -> f64 {
        let [a, b, c] = self.0;
        a + k * (b + k * c)
    }

    fn slope(&self, k: f64) -> f64 {
        self.0[1] + 2.0 * k * self.0[2]
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    fn states(of: impl Fn(f64) -> (f64, f64)) -> Vec<Driven> {
        let state = |k: usize| {
            let (acceleration, heading) = of(DT * k as f64);
            Driven { axle: [0.0; 2], heading, speed: 10.0, acceleration, steering: 0.0 }
        };
        (0..=40).map(state).collect()
    }

    #[test]
    fn a_parabola_comes_back() {
        let series: Vec<f64> = (0..41).map(|k| 1.0 - 0.3 * f64::from(k) + 0.02 * f64::from(k * k)).collect();
        let found = Parabola::through(&series);
        assert_relative_eq!(found.value(7.0), series[7], epsilon = 1e-9);
        assert_relative_eq!(found.slope(7.0), -0.3 + 0.04 * 7.0, epsilon = 1e-9);
    }

    #[test]
    fn bounds_are_nuplans() {
        assert!(is_comfortable(&states(|_| (-4.0, 0.0))));
        assert!(!is_comfortable(&states(|_| (-4.1, 0.0))));
        assert!(is_comfortable(&states(|t| (-4.0 + 1.0 * t, 0.0))));
        // A jerk of 4.2 m/s³ around 0, whose magnitude changes more slowly.
        assert!(!is_comfortable(&states(|t| (0.6 * (7.0 * (t - 2.0)).clamp(-4.0, 4.0) / 4.0 * 4.0, 0.0))));
        assert!(is_comfortable(&states(|t| (0.0, 0.94 * t))));
        assert!(!is_comfortable(&states(|t| (0.0, 0.96 * t))));
        assert!(is_comfortable(&states(|t| (0.0, 0.5 * 0.45 * (t - 2.0) * (t - 2.0)))));
        assert!(!is_comfortable(&states(|t| (0.0, 0.5 * 2.0 * (t - 2.0) * (t - 2.0)))));
    }
}
