//! A driving policy: it can be the ego of every command.

use sage_core::{
    geometry::{dot, sub},
    registry::Entry,
};
use sage_sim::{
    Error,
    policy::{Driver, EgoPolicy, Start, View},
    route::{Coordinates, Localization},
    vehicle::Action,
    world::Control,
};
use serde::{Deserialize, Serialize};

/// Follows the route at a constant speed and brakes for nobody. The type is also its own options and its own driver,
/// because it has no state.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Steady {
    /// Speed, m/s, > 0.
    speed: f64,
}

impl Default for Steady {
    fn default() -> Self {
        Self { speed: 6.0 }
    }
}

impl Entry<dyn EgoPolicy> for Steady {
    const NAME: &'static str = "steady";
    const SUMMARY: &'static str = "constant speed along the route, brakes for nobody";
    const SOURCE: &'static str = "own-crate";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn EgoPolicy>, String> {
        if options.speed > 0.0 {
            Ok(Box::new(options))
        } else {
            Err(format!("`speed` is {}; expected a number above 0", options.speed))
        }
    }
}

impl EgoPolicy for Steady {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}

impl Driver for Steady {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let (route, motion) = (view.route(), view.motion());
        // Steer towards a point of the route 6 m ahead.
        let along = route.locate(motion.position, Localization::Nearest).along;
        let to = sub(route.point(Coordinates { along: along + 6.0, across: 0.0 }), motion.position);
        let axis = view.area().axis;
        let angle = (axis[0] * to[1] - axis[1] * to[0]).atan2(dot(axis, to));
        Ok(Control::Drive(Action {
            steer: 1.2 * angle / view.car().max_steering,
            throttle: view.car().throttle_for(self.speed - motion.speed()),
        }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}
