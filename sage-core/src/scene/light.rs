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
    /// Flashing red: stop, then go when the way is free.
    FlashingStop,
}

impl LightState {
    /// A word for it, as planners are told it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Stop => "red",
            Self::Caution => "yellow",
            Self::Go => "green",
            Self::FlashingStop => "flashing red",
        }
    }

    /// Parses a name such as `LANE_STATE_ARROW_STOP` or `TRAFFIC_LIGHT_RED`. Arrows count as the full light
    /// of the same meaning, and so does flashing yellow.
    pub fn from_name(name: &str) -> Self {
        match name {
            n if n.ends_with("STOP") || n.ends_with("RED") => {
                if n.contains("FLASHING") {
                    Self::FlashingStop
                } else {
                    Self::Stop
                }
            }
            n if n.ends_with("CAUTION") || n.ends_with("YELLOW") => Self::Caution,
            n if n.ends_with("GO") || n.ends_with("GREEN") => Self::Go,
            _ => Self::Unknown,
        }
    }

    /// The state without flashing: what networks see, and what pictures and lamps show.
    pub fn steady(self) -> Self {
        if self == Self::FlashingStop { Self::Stop } else { self }
    }

    /// Whether a car must wait at the light: red, and not flashing.
    pub fn is_red(self) -> bool {
        self == Self::Stop
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_are_red_and_flashing_and_unknown_lights_are_not() {
        for name in ["LANE_STATE_STOP", "LANE_STATE_ARROW_STOP", "TRAFFIC_LIGHT_RED"] {
            assert!(LightState::from_name(name).is_red(), "{name}");
        }
        for name in [
            "LANE_STATE_FLASHING_STOP",
            "LANE_STATE_FLASHING_CAUTION",
            "LANE_STATE_UNKNOWN",
            "LANE_STATE_ARROW_CAUTION",
            "TRAFFIC_LIGHT_YELLOW",
            "TRAFFIC_LIGHT_GREEN",
            "",
        ] {
            assert!(!LightState::from_name(name).is_red(), "{name}");
        }
    }

    #[test]
    fn a_flashing_light_is_its_steady_one_for_networks_and_pictures() {
        let flashing = LightState::from_name("LANE_STATE_FLASHING_STOP");
        assert_eq!((flashing, flashing.steady()), (LightState::FlashingStop, LightState::Stop));
        for state in [LightState::Unknown, LightState::Stop, LightState::Caution, LightState::Go] {
            assert_eq!(state.steady(), state);
        }
    }
}
