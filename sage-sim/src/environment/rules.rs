//! Reward, cost and endings of a step, as functions of what happened in it.

use super::{EnvironmentOptions, Outcome};
use crate::route::Coordinates;

/// Share of the route at which the car has arrived.
pub(crate) const ARRIVED: f64 = 0.95;
/// A shorter route has no completion, metres.
const SHORTEST_ROUTE: f64 = 1.0;
/// Distance across the route at which the car is off the road, metres.
const FARTHEST: f64 = 10.0;
/// Completion below which the episode ends: the car drove backwards.
pub(crate) const BACKWARDS: f64 = -0.1;

/// What happened in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// Number of the step, 1 the first.
    pub step: usize,
    /// Last frame of the log.
    pub last_frame: usize,
    /// Distance along the route before the step, metres.
    pub along_before: f64,
    /// Coordinates on the route after the step.
    pub at: Coordinates,
    /// Length of the route, metres.
    pub route_length: f64,
    /// Contact with a vehicle in the step.
    pub vehicle_contact: bool,
    /// Contact with a pedestrian or cyclist: reported, without consequence.
    pub human_contact: bool,
    /// Contact with a cone, barrier or other object.
    pub object_contact: bool,
    /// On a solid yellow line at the end.
    pub on_yellow: bool,
    /// Whether the car had arrived before.
    pub had_arrived: bool,
    /// Whether it was off the road before.
    pub was_off_road: bool,
    /// On a road edge at the end that counts ([`EnvironmentOptions::start_edge_ends`]).
    pub on_edge: bool,
}

/// Assesses a step.
pub fn assess(options: &EnvironmentOptions, situation: &Situation) -> Outcome {
    let s = situation;
    let rewards = &options.rewards;
    let progress = s.at.along - s.along_before;
    let completion = s.at.along / s.route_length;
    // A recording that stands has no route to complete.
    let is_short = s.route_length < SHORTEST_ROUTE;
    let arrived = if is_short { options.short_route_arrives } else { completion > ARRIVED };
    let out_of_road = s.at.across.abs() > FARTHEST || s.on_edge || (options.yellow_ends && s.on_yellow);
    // The first that applies decides the cost, arrived or not, and the reward unless the car arrived.
    let (penalty, cost) = if out_of_road {
        let stays = options.goes_on && s.was_off_road;
        let penalty = if stays { rewards.staying_out_of_road } else { rewards.out_of_road };
        (Some(penalty), rewards.out_of_road_cost)
    } else if s.vehicle_contact {
        (Some(rewards.vehicle_contact), rewards.vehicle_contact_cost)
    } else if s.object_contact {
        (Some(rewards.object_contact), rewards.object_contact_cost)
    } else {
        (None, 0.0)
    };
    let reward = match penalty {
        _ if arrived && !(options.goes_on && s.had_arrived) => rewards.success,
        Some(penalty) => -penalty,
        None => rewards.progress * progress,
    };
    let any_contact = s.vehicle_contact || s.human_contact || s.object_contact;
    let contact_ends =
        (options.contact_ends && s.vehicle_contact) || (options.any_contact_ends && any_contact);
    let failed = out_of_road || (!is_short && completion < BACKWARDS) || s.object_contact || contact_ends;
    let mut terminated =
        if options.goes_on { contact_ends } else { arrived || (!is_short && completion > 1.0) || failed };
    let is_last = options.is_last(s.step, s.last_frame);
    terminated |= is_last && options.limit_terminates;
    Outcome {
        reward,
        cost,
        terminated,
        truncated: is_last && !terminated,
        arrived,
        out_of_road,
        vehicle_contact: s.vehicle_contact
            && (options.contact_ends || options.any_contact_ends || !options.contact_hidden),
        human_contact: s.human_contact,
        object_contact: s.object_contact,
        completion,
        progress,
        distance_to_log: 0.0,
    }
}
