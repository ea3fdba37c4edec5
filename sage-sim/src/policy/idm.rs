//! Intelligent Driver Model along the logged route, with lane changes by MOBIL.
//!
//! The acceleration follows the textbook formula in SI units, limited to −3 … 1 m/s²; the desired speed is the
//! lane's limit. Leaders are the nearest road users whose boxes overlap the path of the car's width, and red lights
//! ([`crate::red_lights`]).

use sage_core::{
    motion::{
        DT,
        idm::{Idm, Leader},
    },
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use super::minded_lights::{Braking, RedLights};
use super::{
    Driver, EgoPolicy, Start, View,
    lane_change::{LaneChange, MobilOptions},
    people, steering,
};
use crate::{
    Error,
    following::{Follower, areas, leader},
    route::Localization,
    traffic::{DESIRED_SPEED, speed_limit},
    vehicle::Action,
    world::Control,
};

/// The policy `idm`.
#[derive(Clone, Debug, Default)]
pub struct IdmPolicy(IdmOptions);

/// Options of [`IdmPolicy`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IdmOptions {
    /// The model. Its desired speed counts where the lane has no limit.
    pub model: Idm,
    /// Whether a lane's speed limit is the desired speed.
    pub speed_limits: bool,
    /// Lateral acceleration in curves, m/s²: a lower desired speed before and in them. `null` for no such limit.
    pub curves: Option<f64>,
    /// Limits of the acceleration, m/s².
    pub limits: [f64; 2],
    /// Lane changes; `null` for none.
    pub lane_changes: Option<MobilOptions>,
    /// Whether it stops at red lights on its route, if the stronger of `limits` suffices.
    pub red_lights: bool,
    /// Whether it brakes for people who are about to cross its path; without, for those who are on it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub people: bool,
}

impl Default for IdmOptions {
    fn default() -> Self {
        Self {
            model: Idm { desired_speed: DESIRED_SPEED, ..Idm::default() },
            speed_limits: true,
            curves: Some(2.5),
            limits: [-3.0, 1.0],
            lane_changes: Some(MobilOptions::default()),
            red_lights: true,
            people: false,
        }
    }
}

impl Entry<dyn EgoPolicy> for IdmPolicy {
    const NAME: &'static str = "idm";
    const SUMMARY: &'static str = "Intelligent Driver Model along the logged route, lane changes by MOBIL";
    const SOURCE: &'static str = "Treiber et al. (2000); Kesting et al. (2007)";
    type Options = IdmOptions;

    fn build(options: IdmOptions) -> Result<Box<dyn EgoPolicy>, String> {
        options.check()?;
        Ok(Box::new(Self(options)))
    }
}

impl IdmOptions {
    /// Refuses values out of range.
    pub(super) fn check(&self) -> Result<(), String> {
        let m = &self.model;
        let above_0 = [
            ("desired_speed", m.desired_speed),
            ("standing_gap", m.standing_gap),
            ("acceleration", m.acceleration),
            ("deceleration", m.deceleration),
            ("exponent", m.exponent),
        ];
        if let Some((name, value)) =
            above_0.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite()))
        {
            return Err(format!("`model.{name}` is {value}; expected a number above 0"));
        }
        if !(m.time_gap >= 0.0) {
            return Err(format!("`model.time_gap` is {}; expected seconds, at least 0", m.time_gap));
        }
        let [low, high] = self.limits;
        if !(low < 0.0 && high > 0.0) {
            return Err(format!("`limits` is [{low}, {high}]; expected a number below 0 and one above"));
        }
        if let Some(lane_changes) = &self.lane_changes {
            lane_changes.check()?;
        }
        if let Some(lateral) = self.curves.filter(|lateral| !(*lateral > 0.0)) {
            return Err(format!("`curves` is {lateral}; expected m/s² above 0, or null"));
        }
        Ok(())
    }
}

impl EgoPolicy for IdmPolicy {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(IdmDriver::new(self.0.clone())))
    }
}

/// A driver by the model; others build on it.
#[derive(Clone)]
pub(super) struct IdmDriver {
    options: IdmOptions,
    lane_change: Option<LaneChange>,
    red_lights: Option<RedLights>,
}

/// What the model wants in a step.
pub(super) struct Plan {
    /// Acceleration, m/s².
    pub(super) acceleration: f64,
    /// Steering, in [−1, 1].
    pub(super) steer: f64,
    /// Place on the route, metres.
    pub(super) along: f64,
}

impl Driver for IdmDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let Plan { acceleration, steer, .. } = self.plan(view);
        Ok(Control::Drive(Action { steer, throttle: view.car().throttle_for(acceleration) }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl IdmDriver {
    pub(super) fn new(options: IdmOptions) -> Self {
        let lane_change = options.lane_changes.map(LaneChange::new);
        let braking = Braking { deceleration: -options.limits[0], lag: 2.0 * DT };
        let red_lights = options.red_lights.then(|| RedLights::new(braking));
        Self { options, lane_change, red_lights }
    }

    /// The next step by the model.
    pub(super) fn plan(&mut self, view: &View) -> Plan {
        let (route, motion) = (view.route(), view.motion());
        let limit = self.options.speed_limits.then(|| speed_limit(view.scene(), motion.position)).flatten();
        let at = route.locate(motion.position, Localization::Nearest);
        let curve = self.options.curves.map_or(f64::INFINITY, |lateral| {
            steering::curve_speed(route, at.along, lateral, self.options.model.deceleration)
        });
        let desired_speed = limit.unwrap_or(self.options.model.desired_speed).min(curve);
        let model = Idm { desired_speed, ..self.options.model };
        let across = match &mut self.lane_change {
            Some(change) => change.offset(view, &model, at),
            None => 0.0,
        };
        let speed = motion.body_velocity()[0].max(0.0);
        let half = [view.area().half_length, view.area().half_width];
        let own = Follower { along: at.along, across: at.across, half };
        let others: Vec<_> = view.others().copied().collect();
        // While it changes lanes, both the lane that it leaves and the one that it enters count.
        let target = Follower { across, ..own };
        let gaps = [own, target].map(|path| leader(route, path, areas(&others)).map(|(_, leader)| leader));
        let acceleration = gaps.map(|leader| model.acceleration(speed, leader));
        let end = self
            .lane_change
            .as_ref()
            .and_then(LaneChange::stop)
            .map_or(f64::INFINITY, |gap| model.acceleration(speed, Some(Leader { gap, speed: 0.0 })));
        let red = (self.red_lights.as_mut().and_then(|lights| lights.stop(view)))
            .map_or(f64::INFINITY, |stop| {
                model.acceleration(speed, Some(Leader { gap: stop.gap, speed: 0.0 }))
            });
        let person = self.options.people.then(|| people::crossing(view, own)).flatten();
        let person =
            person.map_or(f64::INFINITY, |gap| model.acceleration(speed, Some(Leader { gap, speed: 0.0 })));
        let [low, high] = self.options.limits;
        let acceleration =
            acceleration[0].min(acceleration[1]).min(end).min(red).min(person).clamp(low, high);
        let steer = steering::along(view.car(), motion, route, at.along, across);
        Plan { acceleration, steer, along: at.along }
    }
}
