//! Map features of a `Scenario`.

use std::{collections::HashMap, ops::Range};

use super::{
    Scenario,
    budget::Budget,
    lanes::{self, LaneFields},
    lights::point,
    points::{POINT_FIELD, push_point, push_usual_points},
    width,
};
use crate::{
    metadrive::Values,
    pickle::Id,
    womd::{
        message_error::{MessageError, Place},
        wire::Message,
        words::{LANE, MEMBERS, Member, ROAD_EDGE, ROAD_EDGE_TYPES, ROAD_LINE, ROAD_LINE_TYPES, STOP_SIGN},
    },
};

/// The features of a map by id, in the order of the file, and their points.
struct Features {
    all: Vec<Feature>,
    index: HashMap<i64, usize>,
    points: Vec<[f32; 3]>,
}

/// A map feature that is not in the document yet.
struct Feature {
    id: i64,
    /// Number of the feature in the message.
    number: usize,
    kind: &'static str,
    /// Key of the points in the document.
    key: &'static str,
    points: Range<usize>,
    content: Content,
}

enum Content {
    Lane(Box<LaneFields>),
    StopSign(Vec<Id>),
    Line,
}

/// Decodes all features into a dict. The later of two features with one id takes the place of the earlier; a
/// feature of no kind is dropped.
///
/// *Errors*: as [`super::decode`].
pub(super) fn decode(
    scenario: &Scenario,
    values: &mut Values,
    budget: &mut Budget,
) -> Result<Id, MessageError> {
    let bytes: usize = scenario.features.iter().map(|message| message.bytes.len()).sum();
    let points = Vec::with_capacity(bytes / POINT_FIELD);
    let mut features = Features { all: Vec::new(), index: HashMap::new(), points };
    for (number, message) in scenario.features.iter().enumerate() {
        let Some(feature) = features.read(*message, number, values, budget)? else { continue };
        let next = features.all.len();
        match *features.index.entry(feature.id).or_insert(next) {
            known if known < next => features.all[known] = feature,
            _ => features.all.push(feature),
        }
    }
    let mut work = width::Work::of(scenario.record_size);
    let mut entries = Vec::with_capacity(features.all.len());
    for feature in &features.all {
        let widths = match &feature.content {
            Content::Lane(lane) => {
                let polyline = |id| features.polyline(id);
                width::widths(polyline, feature.number, features.points(feature), lane, &mut work)?
            }
            _ => Vec::new(),
        };
        entries.push((values.decimal(feature.id), features.write(feature, &widths, values)));
    }
    Ok(values.entries(entries))
}

impl Features {
    /// Points of a feature.
    fn points(&self, feature: &Feature) -> &[[f32; 3]] {
        &self.points[feature.points.clone()]
    }

    /// The polyline of the feature with an id; `None` without such a feature, or if it has none.
    fn polyline(&self, id: i64) -> Option<&[[f32; 3]]> {
        let feature = &self.all[*self.index.get(&id)?];
        (feature.key == "polyline").then(|| self.points(feature))
    }

    /// Reads a feature; `None` if it is of no kind.
    fn read(
        &mut self,
        message: Message,
        number: usize,
        values: &mut Values,
        budget: &mut Budget,
    ) -> Result<Option<Feature>, MessageError> {
        let place = Place::ROOT.item("map_features", number);
        let (mut id, mut current, mut parts) = (0, None, Vec::with_capacity(1));
        let mut fields = message.fields();
        while let Some(field) = fields.next(&place)? {
            if field.number == 1 {
                id = field.int64(&place.field("id"))?;
            }
            let Some(member) = MEMBERS.iter().find(|member| member.number == field.number) else { continue };
            let part = field.message(&place.field(member.name))?;
            // Parts of one member are merged; another member replaces them.
            if current.is_some_and(|current: &Member| current.number != member.number) {
                parts.clear();
            }
            current = Some(member);
            parts.push(part);
        }
        let Some(member) = current else { return Ok(None) };
        let first = self.points.len();
        let place = place.field(member.name);
        let (kind, content) = match member.number {
            LANE => {
                let (kind, lane) = lanes::read(&parts, &place, values, budget, &mut self.points)?;
                (kind, Content::Lane(Box::new(lane)))
            }
            ROAD_LINE => (self.line(&parts, &place, &ROAD_LINE_TYPES, budget)?, Content::Line),
            ROAD_EDGE => (self.line(&parts, &place, &ROAD_EDGE_TYPES, budget)?, Content::Line),
            STOP_SIGN => (member.kind, Content::StopSign(self.stop_sign(&parts, &place, values, budget)?)),
            _ => {
                self.polygon(&parts, &place, budget)?;
                (member.kind, Content::Line)
            }
        };
        let points = first..self.points.len();
        if points.is_empty() {
            let place = place.field(member.points);
            return Err(MessageError::value(message.offset, &place, "empty", "at least one point"));
        }
        Ok(Some(Feature { id, number, kind, key: member.points, points, content }))
    }

    /// Reads a road line or a road edge. Returns its type.
    fn line(
        &mut self,
        parts: &[Message],
        place: &Place,
        words: &'static [&'static str],
        budget: &mut Budget,
    ) -> Result<&'static str, MessageError> {
        let mut kind = words[0];
        for part in parts {
            let mut fields = part.fields();
            loop {
                push_usual_points(&mut fields, 2, &mut self.points, place, budget)?;
                let Some(field) = fields.next(place)? else { break };
                match field.number {
                    1 => kind = field.word(words, &place.field("type"))?,
                    2 => {
                        push_point(
                            field.message(&place.field("polyline"))?,
                            "polyline",
                            place,
                            &mut self.points,
                            budget,
                        )?;
                    }
                    _ => {}
                }
            }
        }
        Ok(kind)
    }

    fn polygon(&mut self, parts: &[Message], place: &Place, budget: &mut Budget) -> Result<(), MessageError> {
        for part in parts {
            let mut fields = part.fields();
            loop {
                push_usual_points(&mut fields, 1, &mut self.points, place, budget)?;
                let Some(field) = fields.next(place)? else { break };
                if field.number == 1 {
                    push_point(
                        field.message(&place.field("polygon"))?,
                        "polygon",
                        place,
                        &mut self.points,
                        budget,
                    )?;
                }
            }
        }
        Ok(())
    }

    /// Reads a stop sign. Returns its lanes.
    fn stop_sign(
        &mut self,
        parts: &[Message],
        place: &Place,
        values: &mut Values,
        budget: &mut Budget,
    ) -> Result<Vec<Id>, MessageError> {
        let (mut lanes, mut position) = (Vec::new(), [0.0; 3]);
        for part in parts {
            let mut fields = part.fields();
            while let Some(field) = fields.next(place)? {
                match field.number {
                    1 => field.integers(&place.field("lane"), |lane| {
                        lanes.push(values.int(lane));
                        budget.spend(size_of::<Id>(), field.offset, place, "lanes")
                    })?,
                    2 => {
                        let place = place.field("position");
                        point(field.message(&place)?, &place, &mut position)?;
                    }
                    _ => {}
                }
            }
        }
        self.points.push(position);
        Ok(lanes)
    }

    /// The feature in the document.
    fn write(&self, feature: &Feature, widths: &[[f32; 2]], values: &mut Values) -> Id {
        let points = self.points(feature);
        let n = points.len();
        let shape: &[usize] = if feature.key == "position" { &[3] } else { &[n, 3] };
        let points = values.floats(shape, points.as_flattened());
        let kind = values.word(feature.kind);
        match &feature.content {
            Content::Line => values.dict([("type", kind), (feature.key, points)]),
            Content::StopSign(lanes) => {
                let lanes = values.list(lanes.clone());
                values.dict([("type", kind), ("lane", lanes), ("position", points)])
            }
            Content::Lane(lane) => {
                let widths = values.floats(&[n, 2], widths.as_flattened());
                lane.write(kind, points, widths, values)
            }
        }
    }
}
