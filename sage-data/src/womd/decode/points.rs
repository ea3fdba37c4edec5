//! Points and numbers of map features.

use super::{budget::Budget, checked, lights::point};
use crate::womd::{
    message_error::{MessageError, Place},
    wire::{Field, Fields, Message},
};
use sage_core::motion::MAX_COORDINATE;

/// Memory of a point: in the document, and in the scene.
const POINT: usize = 36;

/// Bytes of a point of a message, with its key and length.
pub(super) const POINT_FIELD: usize = 29;

/// Reads a point of a polyline or polygon.
#[inline]
pub(super) fn push_point(
    message: Message,
    name: &'static str,
    place: &Place,
    points: &mut Vec<[f32; 3]>,
    budget: &mut Budget,
) -> Result<(), MessageError> {
    let place = place.field(name);
    budget.spend(POINT, message.offset, &place, "points")?;
    let mut new = [0.0; 3];
    point(message, &place, &mut new)?;
    points.push(new);
    Ok(())
}

/// Reads points as Waymo's files have them, with x, y and z in this order, up to another field.
#[inline]
pub(super) fn push_usual_points(
    fields: &mut Fields,
    number: u8,
    points: &mut Vec<[f32; 3]>,
    place: &Place,
    budget: &mut Budget,
) -> Result<(), MessageError> {
    let (first, offset) = (points.len(), fields.offset());
    while let Some(bytes) = fields.peek::<POINT_FIELD>() {
        let numbers = [3, 12, 21].map(|at| f64::from_le_bytes(std::array::from_fn(|k| bytes[at + k])));
        let keys = [bytes[0], bytes[1], bytes[2], bytes[11], bytes[20]];
        let is_usual = keys == [number << 3 | 2, 27, 0x09, 0x11, 0x19];
        if !is_usual || !numbers.iter().all(|x| x.abs() <= MAX_COORDINATE) {
            break;
        }
        points.push(numbers.map(|x| x as f32));
        fields.advance(POINT_FIELD);
    }
    budget.spend(POINT * (points.len() - first), offset, place, "points")
}

/// A speed limit, miles per hour.
pub(super) fn speed_limit(field: &Field, place: &Place) -> Result<f64, MessageError> {
    checked(field.double(&place.field("speed_limit_mph"))?, field, place, "speed_limit_mph")
}
