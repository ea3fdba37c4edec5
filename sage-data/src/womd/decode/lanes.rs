//! Lanes of a `Scenario`.

use super::{
    budget::{Budget, DICT, ENTRY},
    points::{push_point, push_usual_points, speed_limit},
};
use crate::{
    metadrive::Values,
    pickle::Id,
    womd::{
        message_error::{MessageError, Place},
        wire::{Field, Message},
        words::{LANE_TYPES, MILE, ROAD_LINE_TYPES},
    },
};

/// A lane without its points.
#[derive(Default)]
pub(super) struct LaneFields {
    speed_limit_mph: f64,
    interpolating: bool,
    entries: Vec<Id>,
    exits: Vec<Id>,
    /// Of the left and of the right side.
    pub(super) boundaries: [Vec<Boundary>; 2],
    neighbors: [Vec<Id>; 2],
}

/// A part of a lane and the feature that bounds it.
pub(super) struct Boundary {
    /// First and last point of the lane.
    pub(super) own: [i32; 2],
    pub(super) feature: i64,
    kind: &'static str,
    /// Offset in the record.
    pub(super) offset: usize,
}

/// Reads the parts of a lane; its points are added to `points`. Returns its type and its other fields.
///
/// *Errors*: as [`super::decode`].
pub(super) fn read(
    parts: &[Message],
    place: &Place,
    values: &mut Values,
    budget: &mut Budget,
    points: &mut Vec<[f32; 3]>,
) -> Result<(&'static str, LaneFields), MessageError> {
    let (mut kind, mut lane) = (LANE_TYPES[0], LaneFields::default());
    for part in parts {
        let mut fields = part.fields();
        loop {
            push_usual_points(&mut fields, 8, points, place, budget)?;
            let Some(field) = fields.next(place)? else { break };
            match field.number {
                1 => lane.speed_limit_mph = speed_limit(&field, place)?,
                2 => kind = field.word(&LANE_TYPES, &place.field("type"))?,
                3 => lane.interpolating = field.bool(&place.field("interpolating"))?,
                8 => push_point(field.message(&place.field("polyline"))?, "polyline", place, points, budget)?,
                9 => ids(&field, &place.field("entry_lanes"), &mut lane.entries, values, budget)?,
                10 => ids(&field, &place.field("exit_lanes"), &mut lane.exits, values, budget)?,
                11 | 12 => {
                    let side = field.number as usize - 11;
                    let name = ["left_neighbors", "right_neighbors"][side];
                    let place = place.item(name, lane.neighbors[side].len());
                    let neighbor = neighbor(field.message(&place)?, &place, values, budget)?;
                    lane.neighbors[side].push(neighbor);
                }
                13 | 14 => {
                    let side = field.number as usize - 13;
                    let name = ["left_boundaries", "right_boundaries"][side];
                    let place = place.item(name, lane.boundaries[side].len());
                    let boundary = boundary(field.message(&place)?, &place, budget)?;
                    lane.boundaries[side].push(boundary);
                }
                _ => {}
            }
        }
    }
    Ok((kind, lane))
}

/// Ids of lanes, as ints.
fn ids(
    field: &Field,
    place: &Place,
    list: &mut Vec<Id>,
    values: &mut Values,
    budget: &mut Budget,
) -> Result<(), MessageError> {
    field.integers(place, |lane| {
        list.push(values.int(lane));
        budget.spend(size_of::<Id>(), field.offset, place, "lanes")
    })
}

fn boundary(message: Message, place: &Place, budget: &mut Budget) -> Result<Boundary, MessageError> {
    budget.spend(size_of::<Boundary>() + DICT + 4 * ENTRY, message.offset, place, "boundaries")?;
    let mut found = Boundary { own: [0; 2], feature: 0, kind: ROAD_LINE_TYPES[0], offset: message.offset };
    let mut fields = message.fields();
    while let Some(field) = fields.next(place)? {
        match field.number {
            1 => found.own[0] = field.int32(&place.field("lane_start_index"))?,
            2 => found.own[1] = field.int32(&place.field("lane_end_index"))?,
            3 => found.feature = field.int64(&place.field("boundary_feature_id"))?,
            4 => found.kind = field.word(&ROAD_LINE_TYPES, &place.field("boundary_type"))?,
            _ => {}
        }
    }
    Ok(found)
}

fn neighbor(
    message: Message,
    place: &Place,
    values: &mut Values,
    budget: &mut Budget,
) -> Result<Id, MessageError> {
    const INDICES: [&str; 4] =
        ["self_start_index", "self_end_index", "neighbor_start_index", "neighbor_end_index"];
    budget.spend(2 * DICT + 6 * ENTRY, message.offset, place, "neighbors")?;
    let (mut feature, mut indices, mut boundaries) = (0, [0; 4], Vec::new());
    let mut fields = message.fields();
    while let Some(field) = fields.next(place)? {
        match field.number {
            1 => feature = field.int64(&place.field("feature_id"))?,
            2..=5 => {
                let k = field.number as usize - 2;
                indices[k] = field.int32(&place.field(INDICES[k]))?;
            }
            6 => {
                let place = place.item("boundaries", boundaries.len());
                boundaries.push(boundary(field.message(&place)?, &place, budget)?.write(values));
            }
            _ => {}
        }
    }
    let (id, boundaries) = (values.decimal(feature), values.list(boundaries));
    let [a, b, c, d] = indices.map(|index| values.decimal(index.into()));
    Ok(values.dict([
        ("feature_id", id),
        (INDICES[0], a),
        (INDICES[1], b),
        (INDICES[2], c),
        (INDICES[3], d),
        ("boundaries", boundaries),
    ]))
}

impl Boundary {
    fn write(&self, values: &mut Values) -> Id {
        let [first, last] = self.own.map(|index| values.decimal(index.into()));
        let (kind, feature) = (values.word(self.kind), values.decimal(self.feature));
        values.dict([
            ("lane_start_index", first),
            ("lane_end_index", last),
            ("boundary_type", kind),
            ("boundary_feature_id", feature),
        ])
    }
}

impl LaneFields {
    /// The lane in the document.
    pub(super) fn write(&self, kind: Id, polyline: Id, width: Id, values: &mut Values) -> Id {
        let mph = values.float(self.speed_limit_mph);
        let kmh = values.float(self.speed_limit_mph * MILE);
        let interpolating = values.bool(self.interpolating);
        let boundaries = [0, 1].map(|side| {
            let items = self.boundaries[side].iter().map(|boundary| boundary.write(values)).collect();
            values.list(items)
        });
        let [entries, exits, left, right] =
            [&self.entries, &self.exits, &self.neighbors[0], &self.neighbors[1]]
                .map(|list| values.list(list.clone()));
        values.dict([
            ("speed_limit_mph", mph),
            ("speed_limit_kmh", kmh),
            ("type", kind),
            ("polyline", polyline),
            ("interpolating", interpolating),
            ("entry_lanes", entries),
            ("exit_lanes", exits),
            ("left_boundaries", boundaries[0]),
            ("right_boundaries", boundaries[1]),
            ("left_neighbor", left),
            ("right_neighbor", right),
            ("width", width),
        ])
    }
}
