//! Rewards of a driver: terms with weights, each in a file of its own or here.

use std::{fmt, sync::Arc};

use sage_core::{
    Error,
    motion::DT,
    registry::{Entry, NoOptions, Registry},
};
use serde::{Deserialize, Serialize};

use super::Outcome;
use crate::{traffic::speed_limit, vehicle::Action, world::World};

/// All rewards of this crate. Add a line here to make a new one known everywhere.
///
/// *Errors*: two have the same name.
pub fn driving_rewards() -> Result<Registry<dyn DrivingReward>, Error> {
    Registry::new("driving reward")
        .with::<Published>()?
        .with::<ContactEnds>()?
        .with::<Progress>()?
        .with::<OffRoad>()?
        .with::<Smooth>()?
        .with::<SpeedLimit>()
}

/// What a reward is of.
#[derive(Clone, Copy)]
pub struct RewardedStep<'a> {
    /// What happened in the step, with the published reward.
    pub outcome: &'a Outcome,
    /// The world after the step.
    pub world: &'a World,
    /// Action of the step.
    pub action: Action,
    /// Action of the step before; zero in the first one.
    pub action_before: Action,
}

/// A reward of a step.
pub trait DrivingReward: Send + Sync {
    /// The reward.
    fn of(&self, step: &RewardedStep) -> f64;

    /// Whether a contact ends the episode with it.
    fn contact_ends(&self) -> bool {
        false
    }
}

/// A weighted sum of rewards; the published one if it is empty.
#[derive(Clone, Default)]
pub struct RewardSum(Arc<[Term]>);

/// A reward with its weight, and how a user names it.
#[derive(Clone)]
struct Term {
    name: String,
    weight: f64,
    reward: Arc<dyn DrivingReward>,
}

impl RewardSum {
    /// A sum of named rewards with weights.
    pub fn new(terms: Vec<(String, f64, Box<dyn DrivingReward>)>) -> Self {
        let term = |(name, weight, reward): (String, f64, Box<dyn DrivingReward>)| Term {
            name,
            weight,
            reward: reward.into(),
        };
        Self(terms.into_iter().map(term).collect())
    }

    /// The reward of a step; `None` for the published one.
    pub fn of(&self, step: &RewardedStep) -> Option<f64> {
        let sum = || self.0.iter().map(|term| term.weight * term.reward.of(step)).sum();
        (!self.0.is_empty()).then(sum)
    }

    /// Whether a contact ends the episode.
    pub fn contact_ends(&self) -> bool {
        self.0.iter().any(|term| term.reward.contact_ends())
    }
}

impl fmt::Display for RewardSum {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str(Published::NAME);
        }
        for (k, Term { name, weight, .. }) in self.0.iter().enumerate() {
            let comma = if k == 0 { "" } else { "," };
            if *weight == 1.0 { write!(f, "{comma}{name}")? } else { write!(f, "{comma}{weight}*{name}")? }
        }
        Ok(())
    }
}

impl fmt::Debug for RewardSum {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "RewardSum({self})")
    }
}

impl PartialEq for RewardSum {
    fn eq(&self, other: &Self) -> bool {
        self.to_string() == other.to_string()
    }
}

/// The reward `published`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Published;

impl Entry<dyn DrivingReward> for Published {
    const NAME: &'static str = "published";
    const SUMMARY: &'static str = "metres along the route; +10 on arrival, -10 off the road, -1 in contact";
    const SOURCE: &'static str = "MetaDrive; CAT and SAGE train with it";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn DrivingReward>, String> {
        Ok(Box::new(Self))
    }
}

impl DrivingReward for Published {
    fn of(&self, step: &RewardedStep) -> f64 {
        step.outcome.reward
    }
}

/// The reward `contact-ends`.
#[derive(Clone, Copy, Debug)]
pub struct ContactEnds(f64);

/// Options of [`ContactEnds`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactEndsOptions {
    /// Penalty of a contact with a road user.
    pub penalty: f64,
}

impl Default for ContactEndsOptions {
    fn default() -> Self {
        Self { penalty: 10.0 }
    }
}

impl Entry<dyn DrivingReward> for ContactEnds {
    const NAME: &'static str = "contact-ends";
    const SUMMARY: &'static str = "as published, but a contact ends the episode with a penalty";
    const SOURCE: &'static str = "this project";
    type Options = ContactEndsOptions;

    fn build(ContactEndsOptions { penalty }: ContactEndsOptions) -> Result<Box<dyn DrivingReward>, String> {
        if !(penalty >= 0.0 && penalty.is_finite()) {
            return Err(format!("`penalty` is {penalty}; expected a number, at least 0"));
        }
        Ok(Box::new(Self(penalty)))
    }
}

impl DrivingReward for ContactEnds {
    fn of(&self, step: &RewardedStep) -> f64 {
        let Outcome { vehicle_contact, human_contact, object_contact, reward, .. } = *step.outcome;
        if vehicle_contact || human_contact || object_contact { -self.0 } else { reward }
    }

    fn contact_ends(&self) -> bool {
        true
    }
}

/// The reward `progress`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Progress;

impl Entry<dyn DrivingReward> for Progress {
    const NAME: &'static str = "progress";
    const SUMMARY: &'static str = "metres along the route";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn DrivingReward>, String> {
        Ok(Box::new(Self))
    }
}

impl DrivingReward for Progress {
    fn of(&self, step: &RewardedStep) -> f64 {
        step.outcome.progress
    }
}

/// The reward `off-road`.
#[derive(Clone, Copy, Debug, Default)]
pub struct OffRoad;

impl Entry<dyn DrivingReward> for OffRoad {
    const NAME: &'static str = "off-road";
    const SUMMARY: &'static str = "less 1 for each step off the road";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn DrivingReward>, String> {
        Ok(Box::new(Self))
    }
}

impl DrivingReward for OffRoad {
    fn of(&self, step: &RewardedStep) -> f64 {
        -f64::from(u8::from(step.outcome.out_of_road))
    }
}

/// The reward `smooth`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Smooth;

impl Entry<dyn DrivingReward> for Smooth {
    const NAME: &'static str = "smooth";
    const SUMMARY: &'static str = "less the squared change of steering and throttle since the step before";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn DrivingReward>, String> {
        Ok(Box::new(Self))
    }
}

impl DrivingReward for Smooth {
    fn of(&self, step: &RewardedStep) -> f64 {
        let (now, before) = (step.action, step.action_before);
        -(now.steer - before.steer).powi(2) - (now.throttle - before.throttle).powi(2)
    }
}

/// The reward `speed-limit`.
#[derive(Clone, Copy, Debug, Default)]
pub struct SpeedLimit;

impl Entry<dyn DrivingReward> for SpeedLimit {
    const NAME: &'static str = "speed-limit";
    const SUMMARY: &'static str = "less the metres driven above the speed limit, where the map knows one";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn DrivingReward>, String> {
        Ok(Box::new(Self))
    }
}

impl DrivingReward for SpeedLimit {
    fn of(&self, step: &RewardedStep) -> f64 {
        let motion = step.world.motion();
        let limit = speed_limit(step.world.scene(), motion.position).unwrap_or(f64::INFINITY);
        -(motion.speed() - limit).max(0.0) * DT
    }
}
