//! Acceleration profiles: how a moving agent may drive on, for its forecast.

/// A constant acceleration with its probability.
#[derive(Clone, Copy)]
pub(super) struct AccelerationProfile {
    /// Its probability.
    pub(super) weight: f32,
    /// m/s²; an agent that brakes stops and stays.
    acceleration: f64,
}

/// The profiles of a moving agent. Set by hand.
pub(super) const ACCELERATION_PROFILES: [AccelerationProfile; 3] = [
    AccelerationProfile { weight: 0.5, acceleration: 0.0 },
    AccelerationProfile { weight: 0.3, acceleration: -1.5 },
    AccelerationProfile { weight: 0.2, acceleration: 1.0 },
];

impl AccelerationProfile {
    /// The only profile of a standing agent.
    pub(super) const CONSTANT_SPEED: Self = Self { weight: 1.0, acceleration: 0.0 };

    /// Distance driven after some seconds from a speed in m/s, metres.
    pub(super) fn distance(&self, speed: f64, seconds: f64) -> f64 {
        let acceleration = self.acceleration;
        let seconds = if acceleration < 0.0 { seconds.min(speed / -acceleration) } else { seconds };
        speed * seconds + 0.5 * acceleration * seconds * seconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_braking_agent_stops_and_stays() {
        let braking = ACCELERATION_PROFILES[1];
        // 6 m/s at −1.5 m/s²: 4 s and 12 m to a stop.
        assert!((braking.distance(6.0, 2.0) - 9.0).abs() < 1e-12);
        assert!((braking.distance(6.0, 4.0) - 12.0).abs() < 1e-12);
        assert!((braking.distance(6.0, 8.0) - 12.0).abs() < 1e-12);
    }
}
