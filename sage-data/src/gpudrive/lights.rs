//! Traffic lights of a file: for each lane, lists of states and stop points, and the frames in which they were seen.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{MapAccess, Visitor},
};

use super::keyed::{Key, Keyed, Of, Rest, once};

/// States, as Waymo names them in lower case, and as MetaDrive values have them.
pub(super) const STATES: [(&str, &str); 9] = [
    ("unknown", "LANE_STATE_UNKNOWN"),
    ("arrow_stop", "LANE_STATE_ARROW_STOP"),
    ("arrow_caution", "LANE_STATE_ARROW_CAUTION"),
    ("arrow_go", "LANE_STATE_ARROW_GO"),
    ("stop", "LANE_STATE_STOP"),
    ("caution", "LANE_STATE_CAUTION"),
    ("go", "LANE_STATE_GO"),
    ("flashing_stop", "LANE_STATE_FLASHING_STOP"),
    ("flashing_caution", "LANE_STATE_FLASHING_CAUTION"),
];

/// The lights by the id of their lane, in the order of the file.
#[derive(Default)]
pub(super) struct Signals(pub(super) Vec<(String, Signal)>);

/// A light: lists of equal length.
#[derive(Default)]
pub(super) struct Signal {
    pub(super) state: Option<Vec<State>>,
    /// Coordinates of the stop point.
    pub(super) stop: [Option<Vec<f64>>; 3],
    /// Frames.
    pub(super) time_index: Option<Vec<u64>>,
}

/// Number of a state in [`STATES`].
#[derive(Clone, Copy)]
pub(super) struct State(pub(super) u8);

impl<'j> Keyed<'j> for Signal {
    const WHAT: &'static str = "a light: an object with `state` and `time_index`";

    fn take<A: MapAccess<'j>>(&mut self, key: &str, map: &mut A) -> Result<bool, A::Error> {
        let [x, y, z] = &mut self.stop;
        match key {
            "state" => once(&mut self.state, map),
            "time_index" => once(&mut self.time_index, map),
            "x" => once(x, map),
            "y" => once(y, map),
            "z" => once(z, map),
            _ => Ok(false),
        }
    }

    fn missing(&self) -> Option<&'static str> {
        let needed = [("state", self.state.is_none()), ("time_index", self.time_index.is_none())];
        needed.into_iter().find(|(_, is_missing)| *is_missing).map(|(key, _)| key)
    }

    fn rest(&mut self) -> Option<&mut Rest<'j>> {
        None
    }
}

impl<'j> Deserialize<'j> for Signals {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct SignalsVisitor;
        impl<'j> Visitor<'j> for SignalsVisitor {
            type Value = Signals;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("an object with a light for each lane")
            }

            fn visit_map<A: MapAccess<'j>>(self, mut map: A) -> Result<Signals, A::Error> {
                let mut all = Vec::new();
                while let Some(Key(lane)) = map.next_key()? {
                    let Of(light) = map.next_value()?;
                    all.push((lane.into_owned(), light));
                }
                Ok(Signals(all))
            }
        }
        deserializer.deserialize_map(SignalsVisitor)
    }
}

impl<'j> Deserialize<'j> for State {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct StateVisitor;
        impl Visitor<'_> for StateVisitor {
            type Value = State;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a state such as `stop`, `arrow_go` or `unknown`")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<State, E> {
                let found = STATES.iter().position(|(word, _)| *word == text);
                let number =
                    found.ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(text), &self))?;
                Ok(State(number as u8))
            }
        }
        deserializer.deserialize_str(StateVisitor)
    }
}
