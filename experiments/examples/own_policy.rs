//! `sage` with your own driving policy: it drives along the route and brakes for anything in a cone ahead.
//!
//! ```sh
//! cargo run --release -p experiments --example own_policy -- bench drivers \
//!     --ego replay,cautious,idm --out drivers
//! ```

use std::process::ExitCode;

use sage_core::{
    geometry::{dot, norm, sub},
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

/// Drives at a constant speed and brakes for road users ahead. The type is also its own options and its own
/// driver, because it has no state.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Cautious {
    /// Speed on a free road, m/s.
    speed: f64,
    /// Deceleration that must suffice to stop, m/s².
    braking: f64,
}

impl Default for Cautious {
    fn default() -> Self {
        Self { speed: 8.0, braking: 4.0 }
    }
}

impl Entry<dyn EgoPolicy> for Cautious {
    const NAME: &'static str = "cautious";
    const SUMMARY: &'static str = "constant speed, brakes for road users in a cone ahead";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn EgoPolicy>, String> {
        if options.speed > 0.0 && options.braking > 0.0 {
            Ok(Box::new(options))
        } else {
            Err(format!(
                "`speed` is {}, `braking` {}; expected numbers above 0",
                options.speed, options.braking
            ))
        }
    }
}

/// It declares that it knows nothing beyond now, so its view holds neither recordings nor plans.
impl EgoPolicy for Cautious {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}

impl Driver for Cautious {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let (route, motion) = (view.route(), view.motion());
        // Steer towards a point of the route 6 m ahead.
        let along = route.locate(motion.position, Localization::Nearest).along;
        let d = sub(route.point(Coordinates { along: along + 6.0, across: 0.0 }), motion.position);
        let axis = view.area().axis;
        let angle = (axis[0] * d[1] - axis[1] * d[0]).atan2(dot(axis, d));
        // Brake if the distance to stop is longer than the gap to somebody within 15° of the heading.
        let speed = motion.speed();
        let stop = speed * speed / (2.0 * self.braking) + 3.0;
        let is_blocked = view.others().any(|other| {
            let d = sub(other.area.center, motion.position);
            let gap = norm(d) - view.area().half_length - other.area.half_length;
            gap < stop && dot(axis, d) > norm(d) * 15f64.to_radians().cos()
        });
        let acceleration = if is_blocked { -self.braking } else { self.speed - speed };
        Ok(Control::Drive(Action {
            steer: 1.2 * angle / view.car().max_steering,
            throttle: view.car().throttle_for(acceleration),
        }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.policies = registries.parts.policies.with::<Cautious>()?;
        Ok(registries)
    })
}
