//! Options of the environment, and the preset of MetaDrive.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::RewardSum;
use crate::{
    lines::LineShapes,
    observation::ObservationKind,
    traffic::{TrafficMode, TrafficOptions},
    world::WorldOptions,
};

/// Rewards and costs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rewards {
    /// Reward on arrival.
    pub success: f64,
    /// Penalty off the road.
    pub out_of_road: f64,
    /// Penalty of each further step off the road, where leaving it does not end the episode.
    pub staying_out_of_road: f64,
    /// Penalty of a step in contact with a vehicle.
    pub vehicle_contact: f64,
    /// Penalty of a step in contact with an object.
    pub object_contact: f64,
    /// Reward of a metre along the route.
    pub progress: f64,
    /// Cost of a step off the road.
    pub out_of_road_cost: f64,
    /// Cost of a step in contact with a vehicle.
    pub vehicle_contact_cost: f64,
    /// Cost of a step in contact with an object.
    pub object_contact_cost: f64,
}

impl Default for Rewards {
    fn default() -> Self {
        Self {
            success: 10.0,
            out_of_road: 10.0,
            staying_out_of_road: 1.0,
            vehicle_contact: 1.0,
            object_contact: 1.0,
            progress: 1.0,
            out_of_road_cost: 1.0,
            vehicle_contact_cost: 1.0,
            object_contact_cost: 1.0,
        }
    }
}

/// Options of an [`Environment`](super::Environment).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvironmentOptions {
    /// The world.
    #[serde(with = "shared")]
    pub world: Arc<WorldOptions>,
    /// Rewards and costs.
    pub rewards: Rewards,
    /// Terms of the reward; the published one if there are none.
    #[serde(skip)]
    pub reward: RewardSum,
    /// The observation.
    pub observation: ObservationKind,
    /// Whether arrival and leaving the road do not end the episode: it lasts to the limit of steps, and the route goes on
    /// along the lanes. Arrival is rewarded once.
    pub goes_on: bool,
    /// Largest number of steps; the end of the log ends an episode earlier.
    pub max_steps: usize,
    /// Whether contact with a vehicle ends the episode.
    pub contact_ends: bool,
    /// Whether contact with any road user or object ends the episode.
    pub any_contact_ends: bool,
    /// MetaDrive: episodes continue after the end of the log, without traffic.
    pub outlast_log: bool,
    /// MetaDrive: a solid yellow line is off the road.
    pub yellow_ends: bool,
    /// MetaDrive: a road edge that is touched at the start is off the road before the car has left it.
    pub start_edge_ends: bool,
    /// MetaDrive: positions are located on the nearest *line* of the route ([`crate::route::Localization`]).
    pub line_localization: bool,
    /// MetaDrive: under replay the navigation numbers are those of the pose before the step.
    pub late_navigation: bool,
    /// MetaDrive: the limit of steps counts as a termination.
    pub limit_terminates: bool,
    /// MetaDrive: contact with a vehicle is reported only if it ends the episode.
    pub contact_hidden: bool,
    /// MetaDrive: a recording that stands, with a route below 1 m, has arrived in the first step.
    pub short_route_arrives: bool,
    /// MetaDrive: NaN in an action counts as 0; otherwise it is an error.
    pub nan_is_zero: bool,
}

impl Default for EnvironmentOptions {
    fn default() -> Self {
        Self {
            world: Arc::default(),
            rewards: Rewards::default(),
            reward: RewardSum::default(),
            observation: ObservationKind::Corrected,
            goes_on: false,
            max_steps: 90,
            contact_ends: false,
            any_contact_ends: false,
            outlast_log: false,
            yellow_ends: false,
            start_edge_ends: false,
            line_localization: false,
            late_navigation: false,
            limit_terminates: false,
            contact_hidden: false,
            short_route_arrives: false,
            nan_is_zero: false,
        }
    }
}

impl EnvironmentOptions {
    /// Training as published: no parked cars; every oddity of MetaDrive 0.3 off.
    pub fn training() -> Self {
        let traffic = TrafficOptions { parked: false, ..TrafficOptions::default() };
        let world = WorldOptions { traffic, strength: None, ..WorldOptions::default() };
        Self { world: Arc::new(world), ..Self::default() }
    }

    /// With parked cars, or without.
    pub fn with_parked(self, parked: bool) -> Self {
        let traffic = TrafficOptions { parked, ..self.world.traffic.clone() };
        Self { world: Arc::new(WorldOptions { traffic, ..(*self.world).clone() }), ..self }
    }

    /// MetaDrive 0.3.0.1 as configured for training, with all its oddities.
    pub fn metadrive() -> Self {
        let traffic = TrafficOptions {
            mode: TrafficMode::Replay,
            parked: false,
            class_sizes: true,
            skip_close: true,
            late_plan: true,
            dynamic: true,
            ..TrafficOptions::default()
        };
        let world = WorldOptions {
            traffic,
            strength: None,
            lines: LineShapes::Pieces,
            late_pose: true,
            airborne_start: true,
            flat: true,
            whole_physics: false,
        };
        Self {
            world: Arc::new(world),
            rewards: Rewards::default(),
            reward: RewardSum::default(),
            observation: ObservationKind::MetaDrive,
            goes_on: false,
            max_steps: 251,
            contact_ends: false,
            any_contact_ends: false,
            outlast_log: true,
            yellow_ends: true,
            start_edge_ends: true,
            line_localization: true,
            late_navigation: true,
            limit_terminates: true,
            contact_hidden: true,
            short_route_arrives: true,
            nan_is_zero: true,
        }
    }

    /// Options of a preset: `default`, `training` or `metadrive`.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "default" => Some(Self::default()),
            "training" => Some(Self::training()),
            "metadrive" => Some(Self::metadrive()),
            _ => None,
        }
    }
}

/// Serde for values behind an [`Arc`].
mod shared {
    use std::sync::Arc;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::world::WorldOptions;

    pub(super) fn serialize<S: Serializer>(value: &Arc<WorldOptions>, to: S) -> Result<S::Ok, S::Error> {
        value.as_ref().serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Arc<WorldOptions>, D::Error> {
        WorldOptions::deserialize(from).map(Arc::new)
    }
}
