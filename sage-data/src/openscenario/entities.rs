//! The road users of a scenario: kind, size, and what stands in their properties.

use sage_core::{
    motion::NOW,
    scene::{Track, TrackKind},
    statistics::median,
};

use super::{Entity, Scenario, Standard, header::write_properties};
use crate::{
    metadrive::ADDED,
    xml::{Xml, number_text},
};

/// Decimals of a length, metres.
const LENGTH: usize = 6;
/// Length above which a vehicle is a truck, metres.
const TRUCK: f64 = 8.0;
/// Change of a size over the recording that a property states, metres.
const CHANGE: f64 = 0.1;

impl Scenario<'_> {
    pub(super) fn write_entities(&self, xml: &mut Xml) {
        xml.element("Entities", |xml| {
            for entity in &self.entities {
                xml.element("ScenarioObject", |xml| {
                    xml.text("name", entity.name);
                    self.write_entity(xml, entity);
                    if self.is_controlled(entity) {
                        xml.element("ObjectController", |xml| write_controller(xml, self.standard()));
                    }
                });
            }
        });
    }

    fn write_entity(&self, xml: &mut Xml, entity: &Entity) {
        let size = size(entity);
        let properties = self.properties(entity);
        let common = |xml: &mut Xml| {
            xml.element("BoundingBox", |xml| {
                xml.element("Center", |xml| {
                    xml.integer("x", 0).integer("y", 0).number("z", 0.5 * size[2], LENGTH);
                });
                xml.element("Dimensions", |xml| {
                    let [length, width, height] = size;
                    xml.number("length", length, LENGTH).number("width", width, LENGTH);
                    xml.number("height", height, LENGTH);
                });
            });
        };
        let write_properties = |xml: &mut Xml| {
            xml.element("Properties", |xml| write_properties(xml, &properties));
        };
        match &entity.track.kind {
            TrackKind::Vehicle | TrackKind::Cyclist => xml.element("Vehicle", |xml| {
                let class = VehicleClass::of(&entity.track.kind, size[0]);
                xml.text("name", entity.name).text("vehicleCategory", class.category);
                common(xml);
                xml.element("Performance", |xml| {
                    xml.integer("maxSpeed", class.max_speed).integer("maxAcceleration", 10);
                    xml.integer("maxDeceleration", class.max_deceleration);
                });
                xml.element("Axles", |xml| write_axles(xml, size));
                write_properties(xml);
            }),
            TrackKind::Pedestrian => xml.element("Pedestrian", |xml| {
                xml.text("name", entity.name).integer("mass", 80);
                xml.text("pedestrianCategory", "pedestrian");
                // Required in 1.0 and deprecated since.
                if self.standard() == Standard::V1_0 {
                    xml.text("model", "pedestrian");
                }
                common(xml);
                write_properties(xml);
            }),
            TrackKind::Other(kind) => xml.element("MiscObject", |xml| {
                let category = if kind.contains("BARRIER") { "barrier" } else { "obstacle" };
                xml.text("name", entity.name).integer("mass", 10).text("miscObjectCategory", category);
                common(xml);
                write_properties(xml);
            }),
        }
    }

    fn properties(&self, entity: &Entity) -> Vec<(String, String)> {
        let property = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        let mut properties = vec![
            property("sage:track", &entity.track.id),
            // How esmini turns the headings of a trajectory exactly.
            property("plineInterpolation", "segment"),
        ];
        let added = self.provenance.facts().find(|(key, _)| *key == ADDED);
        let added =
            added.and_then(|(_, ids)| serde_json::from_str::<Vec<String>>(ids).ok()).unwrap_or_default();
        if added.contains(&entity.track.id) {
            properties.push(property("sage:added", "true"));
        }
        properties.extend(size_range(entity.track).map(|range| property("sage:size_range", &range)));
        if self.is_controlled(entity) {
            // How CARLA's scenario runner finds the ego.
            properties.push(property("type", "ego_vehicle"));
        }
        if entity.is_ego {
            // Before 1.2 the file header holds no properties.
            properties.extend(self.facts());
        }
        properties
    }
}

/// What a vehicle's kind says of its abilities.
struct VehicleClass {
    category: &'static str,
    /// m/s.
    max_speed: i64,
    /// m/s².
    max_deceleration: i64,
}

impl VehicleClass {
    fn of(kind: &TrackKind, length: f64) -> Self {
        match kind {
            TrackKind::Cyclist => Self { category: "bicycle", max_speed: 15, max_deceleration: 6 },
            _ => {
                let category = if length > TRUCK { "truck" } else { "car" };
                Self { category, max_speed: 70, max_deceleration: 10 }
            }
        }
    }
}

/// Axles that put the reference point in the middle of the vehicle: a rear axle elsewhere makes players move
/// the box.
fn write_axles(xml: &mut Xml, [length, width, height]: [f64; 3]) {
    for (tag, position, steering) in [("FrontAxle", 0.6 * length, 0.5), ("RearAxle", 0.0, 0.0)] {
        xml.element(tag, |xml| {
            xml.number("maxSteering", steering, 1).number("wheelDiameter", (0.5 * height).min(0.6), LENGTH);
            xml.number("trackWidth", 0.9 * width, LENGTH).number("positionX", position, LENGTH);
            xml.number("positionZ", (0.25 * height).min(0.3), LENGTH);
        });
    }
}

fn write_controller(xml: &mut Xml, standard: Standard) {
    xml.element("Controller", |xml| {
        xml.text("name", "EgoController");
        if standard >= Standard::V1_2 {
            xml.text("controllerType", "movement");
        }
        let properties = [("esminiController", "ExternalController"), ("module", "external_control")];
        let properties = properties.map(|(name, value)| (name.to_owned(), value.to_owned()));
        xml.element("Properties", |xml| write_properties(xml, &properties));
    });
}

/// Length, width and height: the median over the valid frames. For the ego and the adversary that at *now*,
/// with which attacks are evaluated; if they are not valid then, the last one before.
fn size(entity: &Entity) -> [f64; 3] {
    let track = entity.track;
    let at_now = (entity.is_ego || entity.is_adversary)
        .then(|| (0..=NOW).rev().find(|frame| track.is_valid(*frame)))
        .flatten();
    if let Some(frame) = at_now {
        return track.size[frame];
    }
    [0, 1, 2].map(|side| median(&sizes(track, side).collect::<Vec<_>>()).unwrap_or(1.0))
}

fn sizes(track: &Track, side: usize) -> impl Iterator<Item = f64> {
    track.size.iter().zip(&track.valid).filter(|(_, valid)| **valid).map(move |(size, _)| size[side])
}

/// Smallest and largest length, width and height, if one of them changes by more than 0.1 m.
fn size_range(track: &Track) -> Option<String> {
    let ranges = [0, 1, 2].map(|side| {
        let range = (f64::INFINITY, f64::NEG_INFINITY);
        sizes(track, side).fold(range, |(low, high), size| (low.min(size), high.max(size)))
    });
    let changes = ranges.iter().any(|(low, high)| high - low > CHANGE);
    changes.then(|| ranges.map(|(low, high)| [low, high].map(|x| number_text(x, 3)).join("..")).join(" "))
}
