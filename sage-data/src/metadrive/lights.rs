//! Traffic lights of a file. MetaDrive writes names of states, a lane and a stop point; its version 0.3 wrote Waymo's
//! numbers, and lane and stop point for each frame inside `state`.
//!
//! A light with an unusable value is left out and noted; the file keeps it.

use sage_core::{
    scene::Note,
    scene::{LightState, TrafficLight},
};

use super::fields::{Field, Fields};
use crate::{
    Error,
    pickle::{Id, Node},
    repairs::Repair,
};

/// States by the number that Waymo's `TrafficSignalLaneState` gives them.
const NUMBERED: [LightState; 9] = [
    LightState::Unknown,
    LightState::Stop,
    LightState::Caution,
    LightState::Go,
    LightState::Stop,
    LightState::Caution,
    LightState::Go,
    LightState::FlashingStop,
    LightState::Caution,
];
/// Number of lights that are named when they are left out.
const NAMED: usize = 5;

/// Reads the lights of a file, and notes what was left out.
///
/// *Errors*: they are no dict; with `strict` also an unusable value of a light.
pub(super) fn lights(
    fields: &Fields,
    top: Id,
    frames: usize,
    strict: bool,
    notes: &mut Vec<Note>,
) -> Result<Vec<TrafficLight>, Error> {
    let Some(id) = fields.optional(top, "dynamic_map_states") else { return Ok(Vec::new()) };
    let field = Field::ROOT.key("dynamic_map_states");
    let (mut lights, mut left_out) = (Vec::new(), Vec::new());
    for (key, value) in fields.entries(id, &field)? {
        let name = fields.identifier(*key, &field)?;
        let field = field.key(&name);
        match light(fields, *value, &field, &name, frames) {
            Ok(light) => lights.push(light),
            Err(Error::Field { field: found_at, found, expected, .. }) if !strict && !fields.is_used_up() => {
                let at = found_at.strip_prefix(&format!("{field}/")).unwrap_or(&found_at);
                let text = format!("light `{name}` is left out: `{at}` is {found}; expected {expected}");
                left_out.push(Repair::LightLeftOut.note(text));
            }
            Err(error) => return Err(error),
        }
    }
    let more = left_out.len().saturating_sub(NAMED);
    notes.extend(left_out.into_iter().take(NAMED));
    if more > 0 {
        let text = format!("{more} more lights are left out, because a value of theirs is unusable");
        notes.push(Repair::LightLeftOut.note(text));
    }
    Ok(lights)
}

fn light(
    fields: &Fields,
    value: Id,
    field: &Field,
    name: &str,
    frames: usize,
) -> Result<TrafficLight, Error> {
    let state = fields.required(value, field, "state", "a dict with `object_state`")?;
    let of_state = field.key("state");
    let list = fields.required(state, &of_state, "object_state", "one state per frame")?;
    let states = states(fields, list, &of_state.key("object_state"), frames)?;
    let is_known = |frame: usize| states.get(frame).is_some_and(|state| *state != LightState::Unknown);
    let lane = match (fields.optional(value, "lane"), fields.optional(state, "lane")) {
        (Some(lane), _) => fields.identifier(lane, &field.key("lane"))?,
        (None, Some(lanes)) => {
            lane(fields, lanes, &of_state.key("lane"), frames, is_known)?.unwrap_or_else(|| name.to_owned())
        }
        (None, None) => name.to_owned(),
    };
    let stop_point = match (fields.optional(value, "stop_point"), fields.optional(state, "stop_point")) {
        (Some(id), _) => point(fields, id, &field.key("stop_point"))?,
        (None, Some(id)) => {
            let field = of_state.key("stop_point");
            match fields.row_width(id) {
                None => point(fields, id, &field)?,
                Some(_) => {
                    let rows = fields.rows::<3>(id, &field, &[3, 2])?;
                    fields.check_length(&field, rows.len(), frames)?;
                    of_known_frame(&rows, |row| *row == [0.0; 3], is_known)
                }
            }
        }
        (None, None) => None,
    };
    Ok(TrafficLight { lane, stop_point, states })
}

/// The states of all frames: names, or Waymo's numbers.
fn states(fields: &Fields, list: Id, field: &Field, frames: usize) -> Result<Vec<LightState>, Error> {
    let document = fields.document;
    let odd = |id: Id| fields.wrong(field, id, "names, or Waymo's numbers from 0 to 8");
    let numbered =
        |x: f64| (x.fract() == 0.0 && x >= 0.0).then(|| NUMBERED.get(x as usize).copied()).flatten();
    if let Node::Array(_) = document.node(list) {
        let numbers = fields.column(list, field, frames)?;
        return numbers.into_iter().map(|x| numbered(x).ok_or_else(|| odd(list))).collect();
    }
    let items = document.items(list).ok_or_else(|| fields.wrong(field, list, "a list of names"))?;
    fields.check_length(field, items.len(), frames)?;
    fields.spend(field, items.len())?;
    let mut last: Option<(Id, LightState)> = None;
    let mut states = Vec::with_capacity(frames);
    for item in items {
        let state = match (last, document.node(*item)) {
            // Consecutive frames often share one value.
            (Some((id, state)), _) if id == *item => state,
            (_, Node::None) => LightState::Unknown,
            (_, Node::Bytes(span)) => {
                let name = std::str::from_utf8(document.bytes(*span)).ok();
                fields.spend(field, name.map_or(0, str::len))?;
                LightState::from_name(name.ok_or_else(|| odd(*item))?)
            }
            (_, Node::Str(_)) => LightState::from_name(fields.text(*item, field)?),
            _ => document.number(*item).and_then(numbered).ok_or_else(|| odd(*item))?,
        };
        last = Some((*item, state));
        states.push(state);
    }
    Ok(states)
}

/// The lane of a light that says it for each frame, or once.
fn lane(
    fields: &Fields,
    lanes: Id,
    field: &Field,
    frames: usize,
    is_known: impl Fn(usize) -> bool,
) -> Result<Option<String>, Error> {
    if let Node::Array(_) = fields.document.node(lanes) {
        let numbers = fields.column(lanes, field, frames)?;
        let found = of_known_frame(&numbers, |x| *x == 0.0, is_known);
        return Ok(found.map(|x| format!("{x:.0}")));
    }
    let Some(items) = fields.document.items(lanes) else { return fields.identifier(lanes, field).map(Some) };
    fields.check_length(field, items.len(), frames)?;
    let is_absent =
        |id: &Id| matches!(fields.document.node(*id), Node::None) || fields.document.number(*id) == Some(0.0);
    of_known_frame(items, is_absent, is_known).map(|id| fields.identifier(id, field)).transpose()
}

/// The first value of a frame with a known state, or of any frame. Absent frames hold zeros.
fn of_known_frame<T: Copy>(
    values: &[T],
    is_absent: impl Fn(&T) -> bool,
    is_known: impl Fn(usize) -> bool,
) -> Option<T> {
    let mut present = values.iter().enumerate().filter(|(_, value)| !is_absent(value));
    let first = present.clone().next();
    present.find(|(frame, _)| is_known(*frame)).or(first).map(|(_, value)| *value)
}

/// A single position of two or three numbers; `None` if it is empty.
pub(super) fn point(fields: &Fields, id: Id, field: &Field) -> Result<Option<[f64; 3]>, Error> {
    let numbers = fields.rows::<1>(id, field, &[1])?;
    match numbers[..] {
        [] => Ok(None),
        [[x], [y]] => Ok(Some([x, y, 0.0])),
        [[x], [y], [z]] => Ok(Some([x, y, z])),
        _ => Err(fields.wrong(field, id, "a position of 2 or 3 numbers")),
    }
}
