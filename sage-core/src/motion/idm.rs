//! Intelligent Driver Model: acceleration of a car behind another car (Treiber et al., 2000), SI units.
//!
//! `a [1 − (v/v₀)^δ − (s*/s)²]` with `s* = s₀ + max(0, v T + v Δv / (2 √(a b)))`.

use serde::{Deserialize, Serialize};

/// Parameters of the model; the defaults are the textbook values for city traffic.
///
/// ```
/// use sage_core::motion::idm::{Idm, Leader};
///
/// let idm = Idm::default();
/// // At its desired speed on a free road it neither accelerates nor brakes.
/// assert_eq!(idm.acceleration(idm.desired_speed, None), 0.0);
/// // 5 m behind a standing car at 10 m/s it brakes harder than is comfortable.
/// assert!(idm.acceleration(10.0, Some(Leader { gap: 5.0, speed: 0.0 })) < -idm.deceleration);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Idm {
    /// Speed on a free road v₀, m/s, > 0.
    pub desired_speed: f64,
    /// Time gap to the leader T, s, ≥ 0.
    pub time_gap: f64,
    /// Gap at a standstill s₀, m, > 0.
    pub standing_gap: f64,
    /// Largest acceleration a, m/s², > 0.
    pub acceleration: f64,
    /// Comfortable deceleration b, m/s², > 0.
    pub deceleration: f64,
    /// Exponent δ of the free road, > 0.
    pub exponent: f64,
}

impl Default for Idm {
    fn default() -> Self {
        Self {
            desired_speed: 13.9,
            time_gap: 1.5,
            standing_gap: 2.0,
            acceleration: 1.0,
            deceleration: 3.0,
            exponent: 4.0,
        }
    }
}

/// The car ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leader {
    /// Free distance bumper to bumper, m.
    pub gap: f64,
    /// Its speed along the follower's heading, m/s.
    pub speed: f64,
}

impl Idm {
    /// Smallest gap in the formula, m. It prevents a division by zero at contact.
    const LEAST_GAP: f64 = 0.01;

    /// Acceleration at speed `v` (m/s, ≥ 0), m/s²; negative is braking, without a lower limit.
    pub fn acceleration(&self, v: f64, leader: Option<Leader>) -> f64 {
        let free = 1.0 - (v / self.desired_speed).powf(self.exponent);
        let interaction = leader.map_or(0.0, |leader| {
            let ratio = self.desired_gap(v, leader.speed) / leader.gap.max(Self::LEAST_GAP);
            ratio * ratio
        });
        self.acceleration * (free - interaction)
    }

    /// Desired gap s* at speed `v` behind a car of speed `leader`, m.
    pub fn desired_gap(&self, v: f64, leader: f64) -> f64 {
        let braking = v * (v - leader) / (2.0 * (self.acceleration * self.deceleration).sqrt());
        self.standing_gap + (v * self.time_gap + braking).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_free_road_is_driven_at_the_desired_speed() {
        let idm = Idm::default();
        assert_relative_eq!(idm.acceleration(0.0, None), idm.acceleration);
        assert_relative_eq!(idm.acceleration(idm.desired_speed, None), 0.0);
    }

    #[test]
    fn the_equilibrium_gap_needs_no_acceleration() {
        let idm = Idm::default();
        let v = 8.0;
        // Equal speeds: s_e = (s₀ + v T) / sqrt(1 − (v/v₀)^δ).
        let gap = (2.0 + 1.5 * v) / (1.0 - (v / idm.desired_speed).powi(4)).sqrt();
        assert_relative_eq!(idm.acceleration(v, Some(Leader { gap, speed: v })), 0.0, epsilon = 1e-12);
    }

    #[test]
    fn a_follower_stops_behind_a_standing_car_without_contact() {
        let idm = Idm::default();
        let (mut x, mut v) = (0.0, 13.0);
        for _ in 0..600 {
            let a = idm.acceleration(v, Some(Leader { gap: 100.0 - x, speed: 0.0 }));
            v = (v + a * 0.1).max(0.0);
            x += v * 0.1;
        }
        assert!((96.0..100.0).contains(&x) && v < 0.1, "x {x}, v {v}");
    }
}
