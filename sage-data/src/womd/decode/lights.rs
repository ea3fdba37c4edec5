//! Traffic lights of a `Scenario`: one per lane, with a state per frame.

use std::collections::HashMap;

use super::{Scenario, budget::Budget, checked};
use crate::{
    metadrive::Values,
    pickle::Id,
    womd::{
        message_error::{MessageError, Place},
        wire::Message,
        words::SIGNAL_STATES,
    },
};

/// A light while its states are collected.
struct Light {
    lane: i64,
    states: Vec<Id>,
    stop_point: [f32; 3],
}

/// Decodes the lights of all frames into a dict of lights, in the order of their first state.
///
/// In one frame, the later of two states of a lane holds; the last stop point of a lane holds for all frames.
///
/// *Errors*: as [`super::decode`].
pub(super) fn decode(
    scenario: &Scenario,
    values: &mut Values,
    budget: &mut Budget,
) -> Result<Id, MessageError> {
    let root = Place::ROOT;
    let frames = scenario.timestamps.len();
    let mut lights: Vec<Light> = Vec::new();
    let mut index: HashMap<i64, usize> = HashMap::new();
    // Steps beyond the last frame are dropped, as by the converter.
    for (frame, step) in scenario.steps.iter().take(frames).enumerate() {
        let place = root.item("dynamic_map_states", frame);
        let (mut fields, mut count) = (step.fields(), 0);
        while let Some(field) = fields.next(&place)? {
            if field.number != 1 {
                continue;
            }
            let place = place.item("lane_states", count);
            count += 1;
            let message = field.message(&place)?;
            let (lane, state, stop_point) = lane_state(message, &place)?;
            let number = match index.get(&lane) {
                Some(number) => *number,
                None => {
                    budget.spend(400 + 5 * frames, message.offset, &place, "lights times frames")?;
                    lights.push(Light { lane, states: vec![values.none(); frames], stop_point });
                    index.insert(lane, lights.len() - 1);
                    lights.len() - 1
                }
            };
            lights[number].states[frame] = values.word(state);
            lights[number].stop_point = stop_point;
        }
    }
    let dataset = values.text(scenario.dataset);
    let entries = lights.into_iter().map(|light| light.write(frames, dataset, values)).collect();
    Ok(values.entries(entries))
}

/// Lane, state and stop point of a `TrafficSignalLaneState`.
fn lane_state(message: Message, place: &Place) -> Result<(i64, &'static str, [f32; 3]), MessageError> {
    let (mut lane, mut state, mut stop_point) = (0, SIGNAL_STATES[0], [0.0; 3]);
    let mut fields = message.fields();
    while let Some(field) = fields.next(place)? {
        match field.number {
            1 => lane = field.int64(&place.field("lane"))?,
            2 => state = field.word(&SIGNAL_STATES, &place.field("state"))?,
            3 => {
                let place = place.field("stop_point");
                point(field.message(&place)?, &place, &mut stop_point)?;
            }
            _ => {}
        }
    }
    Ok((lane, state, stop_point))
}

/// Reads a `MapPoint` into `point`. A field that is absent stays as it is: parts of a message are merged.
#[inline]
pub(super) fn point(message: Message, place: &Place, point: &mut [f32; 3]) -> Result<(), MessageError> {
    let mut fields = message.fields();
    while let Some(field) = fields.next(place)? {
        if let axis @ 1..=3 = field.number as usize {
            let name = ["x", "y", "z"][axis - 1];
            point[axis - 1] = checked(field.double(&place.field(name))?, &field, place, name)? as f32;
        }
    }
    Ok(())
}

impl Light {
    fn write(self, frames: usize, dataset: Id, values: &mut Values) -> (Id, Id) {
        let (name, lane) = (values.decimal(self.lane), values.int(self.lane));
        let kind = values.word("TRAFFIC_LIGHT");
        let states = values.list(self.states);
        let state = values.dict([("object_state", states)]);
        let stop = values.floats(&[3], &self.stop_point);
        let length = values.int(frames as i64);
        let metadata = values.dict([
            ("track_length", length),
            ("type", kind),
            ("object_id", name),
            ("dataset", dataset),
        ]);
        let light = values.dict([
            ("type", kind),
            ("state", state),
            ("lane", lane),
            ("stop_point", stop),
            ("metadata", metadata),
        ]);
        (name, light)
    }
}
