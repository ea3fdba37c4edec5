//! Tracks of a `Scenario`.

use std::collections::HashSet;

use sage_core::motion::MAX_COORDINATE;

use super::{Scenario, TrackEntry, budget::Budget, checked, object_type};
use crate::{
    metadrive::Values,
    pickle::Id,
    womd::{
        message_error::{MessageError, Place},
        wire::Message,
    },
};

/// Numbers of a state after `center_x`, in the order of the columns.
const COLUMNS: usize = 9;
/// Memory of a frame: the columns as 32-bit floats, and `valid`.
const FRAME: usize = 4 * COLUMNS + 1;

/// Bytes of a state with all its fields.
const USUAL_STATE: usize = 59;

/// The columns of one track, reused for the next.
struct Columns {
    frames: usize,
    /// x, y, z per frame; then length, width, height, heading; then the velocity.
    position: Vec<[f32; 3]>,
    scalars: [Vec<f32>; 4],
    velocity: Vec<[f32; 2]>,
    valid: Vec<u8>,
}

/// Decodes all tracks, in their order.
///
/// *Errors*: as [`super::decode`].
pub(super) fn decode(
    scenario: &Scenario,
    values: &mut Values,
    budget: &mut Budget,
) -> Result<Vec<TrackEntry>, MessageError> {
    let root = Place::ROOT;
    let frames = scenario.timestamps.len();
    let mut columns = Columns {
        frames,
        position: Vec::new(),
        scalars: [const { Vec::new() }; 4],
        velocity: Vec::new(),
        valid: Vec::new(),
    };
    let (length, dataset) = (values.int(frames as i64), values.text(scenario.dataset));
    let mut known = HashSet::with_capacity(scenario.tracks.len());
    let mut tracks = Vec::with_capacity(scenario.tracks.len());
    for (k, message) in scenario.tracks.iter().enumerate() {
        let place = root.item("tracks", k);
        budget.spend(frames * FRAME, message.offset, &place, "tracks times frames")?;
        let (id, kind) = columns.fill(message, &place, budget)?;
        if !known.insert(id) {
            let found = format!("{id}, which occurs twice");
            return Err(MessageError::value(message.offset, &place.field("id"), found, "one track per id"));
        }
        let (name, kind) = (values.decimal(id.into()), values.word(kind));
        let state = columns.state(values);
        let metadata = values.dict([
            ("track_length", length),
            ("type", kind),
            ("object_id", name),
            ("dataset", dataset),
        ]);
        let value = values.dict([("type", kind), ("state", state), ("metadata", metadata)]);
        tracks.push(TrackEntry { name, kind, value });
    }
    Ok(tracks)
}

impl Columns {
    /// Reads the states of a track. Returns its id and type.
    fn fill(
        &mut self,
        message: &Message,
        place: &Place,
        budget: &mut Budget,
    ) -> Result<(i32, &'static str), MessageError> {
        self.position.clear();
        self.position.resize(self.frames, [0.0; 3]);
        for column in &mut self.scalars {
            column.clear();
            column.resize(self.frames, 0.0);
        }
        self.velocity.clear();
        self.velocity.resize(self.frames, [0.0; 2]);
        self.valid.clear();
        self.valid.resize(self.frames, 0);
        let (mut id, mut kind, mut count) = (0, None, 0);
        let mut fields = message.fields();
        while let Some(field) = fields.next(place)? {
            match field.number {
                1 => id = field.int32(&place.field("id"))?,
                2 => kind = Some(object_type(&field, place)?),
                3 => {
                    let state_place = place.item("states", count);
                    let state = field.message(&state_place)?;
                    // States beyond the last frame are dropped, as by the converter.
                    if count < self.frames {
                        self.read_state(count, state, &state_place)?;
                    } else {
                        budget.spend(FRAME, field.offset, &state_place, "states")?;
                    }
                    count += 1;
                }
                _ => {}
            }
        }
        let kind = kind.ok_or_else(|| {
            MessageError::value(message.offset, &place.field("object_type"), "missing", "1 to 4")
        })?;
        Ok((id, kind))
    }

    #[inline]
    fn read_state(&mut self, frame: usize, state: Message, place: &Place) -> Result<(), MessageError> {
        let is_read = match *state.bytes {
            // Waymo's files keep only the height of a state that is not valid.
            [0x21, a, b, c, d, e, f, g, h, 0x58, 0] => {
                let z = f64::from_le_bytes([a, b, c, d, e, f, g, h]);
                self.position[frame][2] = z as f32;
                z.abs() <= MAX_COORDINATE
            }
            _ => state.bytes.try_into().is_ok_and(|bytes| self.read_usual_state(frame, bytes)),
        };
        if is_read {
            return Ok(());
        }
        let mut fields = state.fields();
        while let Some(field) = fields.next(place)? {
            let float = |name| checked(field.float(&place.field(name))?.into(), &field, place, name);
            match field.number {
                2..=4 => {
                    let axis = field.number as usize - 2;
                    let name = ["center_x", "center_y", "center_z"][axis];
                    let value = checked(field.double(&place.field(name))?, &field, place, name)?;
                    self.position[frame][axis] = value as f32;
                }
                5..=8 => {
                    let column = field.number as usize - 5;
                    let value = float(["length", "width", "height", "heading"][column])?;
                    self.scalars[column][frame] = value as f32;
                }
                9 | 10 => {
                    let axis = field.number as usize - 9;
                    self.velocity[frame][axis] = float(["velocity_x", "velocity_y"][axis])? as f32;
                }
                11 => self.valid[frame] = u8::from(field.bool(&place.field("valid"))?),
                _ => {}
            }
        }
        for (name, column) in ["length", "width"].into_iter().zip(&self.scalars) {
            if self.valid[frame] != 0 && column[frame] <= 0.0 {
                let expected = "metres above 0 where the state is valid";
                return Err(MessageError::value(state.offset, &place.field(name), column[frame], expected));
            }
        }
        Ok(())
    }

    /// Reads a state as Waymo's files have it: all fields in the order of their numbers. Returns false, and reads
    /// nothing, if it is another, or if a number is none that a scene has.
    #[inline]
    fn read_usual_state(&mut self, frame: usize, bytes: &[u8; USUAL_STATE]) -> bool {
        const KEYS: [(usize, u8); 10] = [
            (0, 0x11),
            (9, 0x19),
            (18, 0x21),
            (27, 0x2d),
            (32, 0x35),
            (37, 0x3d),
            (42, 0x45),
            (47, 0x4d),
            (52, 0x55),
            (57, 0x58),
        ];
        let double = |at: usize| f64::from_le_bytes(std::array::from_fn(|k| bytes[at + k]));
        let float = |at: usize| f32::from_le_bytes(std::array::from_fn(|k| bytes[at + k]));
        let position = [1, 10, 19].map(double);
        let [length, width, height, heading, vx, vy] = [28, 33, 38, 43, 48, 53].map(float);
        let limit = MAX_COORDINATE;
        let is_usual = KEYS.iter().all(|(at, key)| bytes[*at] == *key)
            && position.iter().all(|x| x.abs() <= limit)
            && [length, width, height, heading, vx, vy].iter().all(|x| f64::from(x.abs()) <= limit)
            && (bytes[58] == 0 || bytes[58] == 1 && length > 0.0 && width > 0.0);
        if is_usual {
            self.position[frame] = position.map(|x| x as f32);
            for (column, value) in self.scalars.iter_mut().zip([length, width, height, heading]) {
                column[frame] = value;
            }
            self.velocity[frame] = [vx, vy];
            self.valid[frame] = bytes[58];
        }
        is_usual
    }

    /// The columns as the `state` of a track.
    fn state(&self, values: &mut Values) -> Id {
        let n = self.frames;
        let position = values.floats(&[n, 3], self.position.as_flattened());
        let scalars = [0, 1, 2, 3].map(|k| values.floats(&[n], &self.scalars[k]));
        let [length, width, height, heading] = scalars;
        let velocity = values.floats(&[n, 2], self.velocity.as_flattened());
        let valid = values.bools(&self.valid);
        values.dict([
            ("position", position),
            ("length", length),
            ("width", width),
            ("height", height),
            ("heading", heading),
            ("velocity", velocity),
            ("valid", valid),
        ])
    }
}
