//! Result of a step.

/// Result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Outcome {
    /// Reward.
    pub reward: f64,
    /// Cost.
    pub cost: f64,
    /// Whether the episode ended by arrival or failure.
    pub terminated: bool,
    /// Whether the episode was cut off by the limit of steps or the end of the log.
    pub truncated: bool,
    /// Whether the car arrived.
    pub arrived: bool,
    /// Whether it is off the road.
    pub out_of_road: bool,
    /// Whether it touched a vehicle.
    pub vehicle_contact: bool,
    /// Whether it touched a pedestrian or cyclist.
    pub human_contact: bool,
    /// Whether it touched an object.
    pub object_contact: bool,
    /// Share of the route behind the car; below 0 before the start, above 1 beyond the end.
    pub completion: f64,
    /// Progress along the route in the step, metres: the reward before it is replaced.
    pub progress: f64,
    /// Distance to the logged position at the same frame, metres.
    pub distance_to_log: f64,
}
