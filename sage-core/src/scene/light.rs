//! Traffic lights.

/// State of a light in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum LightState {
    /// Not recorded, or an unknown name.
    Unknown,
    /// Red.
    Stop,
    /// Yellow.
    Caution,
    /// Green.
    Go,
}

impl LightState {
    /// Parses a name such as `LANE_STATE_ARROW_STOP` or `TRAFFIC_LIGHT_RED`. Arrows and flashing lights
    /// count as the steady light of the same meaning.
    pub fn from_name(name: &str) -> Self {
        match name {
            n if n.ends_with("STOP") || n.ends_with("RED") => Self::Stop,
            n if n.ends_with("CAUTION") || n.ends_with("YELLOW") => Self::Caution,
            n if n.ends_with("GO") || n.ends_with("GREEN") => Self::Go,
            _ => Self::Unknown,
        }
    }
}

/// A traffic light of one lane.
#[derive(Clone, Debug, PartialEq)]
pub struct TrafficLight {
    /// Id of the lane that it controls.
    pub lane: String,
    /// Stop position of its lane, metres, if recorded.
    pub stop_point: Option<[f64; 3]>,
    /// State a frame, as many as the scene has frames.
    pub states: Vec<LightState>,
}
