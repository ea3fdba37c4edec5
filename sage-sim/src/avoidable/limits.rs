//! What a driver can do with the car: the limits of the search for an evasive manoeuvre.

use std::str::FromStr;

use sage_core::Error;
use serde::{Deserialize, Serialize};

/// Limits of the ego's controls and of the search. The car is a kinematic bicycle whose rear axle lies 0.3 of its
/// length behind the centre of its box, with a wheelbase of 0.6 of its length.
///
/// ```
/// use sage_sim::avoidable::AvoidanceOptions;
///
/// // As the command line reads them; what is left out has its default, a brake of 8 m/s².
/// let options: AvoidanceOptions = r#"{"dead_time": 0.5}"#.parse()?;
/// assert_eq!((options.brake, options.dead_time), (8.0, 0.5));
/// // A comfortable driver brakes by half of that.
/// assert_eq!("comfortable".parse::<AvoidanceOptions>()?.brake, 4.05);
/// assert!(r#"{"brake": -1}"#.parse::<AvoidanceOptions>().is_err());
/// # Ok::<(), sage_sim::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AvoidanceOptions {
    /// Largest deceleration, m/s².
    pub brake: f64,
    /// Largest acceleration, m/s².
    pub accelerate: f64,
    /// Largest lateral acceleration, m/s².
    pub lateral: f64,
    /// Largest yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Largest steering angle, rad.
    pub steering: f64,
    /// Whether braking and steering share the grip: `(a / brake)² + (a_lat / lateral)² ≤ 1`.
    pub ellipse: bool,
    /// Largest change of the acceleration along, m/s³; not limited by default.
    pub jerk: Option<f64>,
    /// Time from the decision to the first change of controls, seconds.
    pub dead_time: f64,
    /// How fine the search is: 0 for one phase of 7 accelerations × 7 sidesteps, 1 with two phases, 2 and above with
    /// grids that are halved each time. Each grid contains the coarser ones.
    pub refinement: u32,
}

impl Default for AvoidanceOptions {
    fn default() -> Self {
        Self {
            brake: 8.0,
            accelerate: 3.0,
            lateral: 6.0,
            yaw_rate: 0.95,
            steering: 0.6,
            ellipse: false,
            jerk: None,
            dead_time: 0.0,
            refinement: 1,
        }
    }
}

impl FromStr for AvoidanceOptions {
    type Err = crate::Error;

    /// Options as JSON, or the word `comfortable`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "comfortable" {
            return Ok(Self::comfortable());
        }
        let options: Self =
            serde_json::from_str(text).map_err(|error| crate::Error::Value(error.to_string()))?;
        options.check()?;
        Ok(options)
    }
}

impl AvoidanceOptions {
    /// nuPlan's bounds of comfort, with its limit of the jerk along.
    pub fn comfortable() -> Self {
        Self { brake: 4.05, accelerate: 2.4, lateral: 4.89, jerk: Some(4.13), ..Self::default() }
    }

    /// The limits of the UN R157 driver: 0.75 s until the brake begins to act, 7.593 m/s² along, built up at
    /// 12.65 m/s³, and grip shared between braking and steering. Source: UN R157, table of the reference driver.
    pub fn r157() -> Self {
        Self { brake: 7.593, jerk: Some(12.65), dead_time: 0.75, ellipse: true, ..Self::default() }
    }

    /// Refuses values out of range.
    ///
    /// *Errors*: [`Error::Options`] with the option and its value.
    pub fn check(&self) -> Result<(), Error> {
        let refuse = |problem: String| Error::Options { kind: "search", name: "avoidable", problem };
        let positive = [
            ("brake", self.brake),
            ("accelerate", self.accelerate),
            ("lateral", self.lateral),
            ("yaw_rate", self.yaw_rate),
            ("steering", self.steering),
            ("jerk", self.jerk.unwrap_or(1.0)),
        ];
        for (name, value) in positive {
            if !(value > 0.0 && value <= 100.0) {
                return Err(refuse(format!("`{name}` is {value}; expected a number above 0, up to 100")));
            }
        }
        if self.steering > 1.4 {
            return Err(refuse(format!("`steering` is {}; expected at most 1.4 rad", self.steering)));
        }
        if !(0.0..=8.0).contains(&self.dead_time) {
            return Err(refuse(format!("`dead_time` is {}; expected 0 to 8 seconds", self.dead_time)));
        }
        if self.refinement > 4 {
            return Err(refuse(format!("`refinement` is {}; expected 0 to 4", self.refinement)));
        }
        Ok(())
    }
}
