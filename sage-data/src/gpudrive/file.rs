//! What a file says, before anything is made of it.

use std::fmt;

use serde::{
    Deserialize, Deserializer,
    de::{Error, MapAccess, Unexpected, Visitor},
};

use super::{
    OWN,
    keyed::{Key, Keyed, Of, Rest, once},
    lights::Signals,
};

/// A scene.
#[derive(Default)]
pub(super) struct File<'j> {
    pub(super) scenario_id: Option<Name>,
    pub(super) objects: Option<Vec<Of<Object<'j>>>>,
    pub(super) roads: Option<Vec<Of<Road<'j>>>>,
    pub(super) tl_states: Option<Option<Signals>>,
    pub(super) metadata: Option<Of<Metadata<'j>>>,
    pub(super) own: Option<Own>,
    pub(super) rest: Rest<'j>,
}

/// A road user.
#[derive(Default)]
pub(super) struct Object<'j> {
    pub(super) id: Option<Name>,
    pub(super) kind: Option<Key<'j>>,
    pub(super) position: Option<Vec<Point>>,
    pub(super) velocity: Option<Vec<Point>>,
    pub(super) heading: Option<Vec<f64>>,
    pub(super) valid: Option<Vec<Flag>>,
    /// Length, width and height.
    pub(super) size: [Option<f64>; 3],
    pub(super) rest: Rest<'j>,
}

/// A map feature.
#[derive(Default)]
pub(super) struct Road<'j> {
    pub(super) id: Option<Name>,
    pub(super) kind: Option<Key<'j>>,
    pub(super) map_element_id: Option<Whole>,
    pub(super) geometry: Option<Vec<Point>>,
    pub(super) rest: Rest<'j>,
}

/// What names the ego.
#[derive(Default)]
pub(super) struct Metadata<'j> {
    pub(super) sdc_track_index: Option<i64>,
    pub(super) objects_of_interest: Option<Vec<Name>>,
    pub(super) tracks_to_predict: Option<Vec<Prediction>>,
    pub(super) rest: Rest<'j>,
}

/// A road user that the data set chose to predict.
#[derive(Deserialize)]
#[serde(expecting = "an object with `track_index`")]
pub(super) struct Prediction {
    pub(super) track_index: i64,
    #[serde(default)]
    pub(super) difficulty: i64,
}

/// What this project adds to a file that it writes.
#[derive(Default, Deserialize, serde::Serialize)]
#[serde(default)]
pub(super) struct Own {
    /// The data set of the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) dataset: Option<String>,
    /// How the scene was made, as JSON text.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) provenance: Option<String>,
    /// What was assumed of sizes that the data set does not have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) assumed_sizes: Option<String>,
    /// The licence of the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) license: Option<String>,
    /// Ids of road users that are no integers, by the number that takes their place.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) objects: Vec<(i64, String)>,
    /// The same of roads.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) roads: Vec<(i64, String)>,
}

impl<'j> Keyed<'j> for File<'j> {
    const WHAT: &'static str = "a scene: an object with `objects` and `roads`";

    fn take<A: MapAccess<'j>>(&mut self, key: &str, map: &mut A) -> Result<bool, A::Error> {
        match key {
            "scenario_id" => once(&mut self.scenario_id, map),
            "objects" => once(&mut self.objects, map),
            "roads" => once(&mut self.roads, map),
            "tl_states" => once(&mut self.tl_states, map),
            "metadata" => once(&mut self.metadata, map),
            OWN => once(&mut self.own, map),
            _ => Ok(false),
        }
    }

    fn missing(&self) -> Option<&'static str> {
        let needed = [("objects", self.objects.is_none()), ("roads", self.roads.is_none())];
        needed.into_iter().find(|(_, is_missing)| *is_missing).map(|(key, _)| key)
    }

    fn rest(&mut self) -> Option<&mut Rest<'j>> {
        Some(&mut self.rest)
    }
}

impl<'j> Keyed<'j> for Object<'j> {
    const WHAT: &'static str =
        "a road user: an object with `position`, `heading`, `velocity`, `valid` and `type`";

    fn take<A: MapAccess<'j>>(&mut self, key: &str, map: &mut A) -> Result<bool, A::Error> {
        let [length, width, height] = &mut self.size;
        match key {
            "id" => once(&mut self.id, map),
            "type" => once(&mut self.kind, map),
            "position" => once(&mut self.position, map),
            "velocity" => once(&mut self.velocity, map),
            "heading" => once(&mut self.heading, map),
            "valid" => once(&mut self.valid, map),
            "length" => once(length, map),
            "width" => once(width, map),
            "height" => once(height, map),
            _ => Ok(false),
        }
    }

    fn missing(&self) -> Option<&'static str> {
        let needed = [
            ("position", self.position.is_none()),
            ("velocity", self.velocity.is_none()),
            ("heading", self.heading.is_none()),
            ("valid", self.valid.is_none()),
            ("type", self.kind.is_none()),
        ];
        needed.into_iter().find(|(_, is_missing)| *is_missing).map(|(key, _)| key)
    }

    fn rest(&mut self) -> Option<&mut Rest<'j>> {
        Some(&mut self.rest)
    }
}

impl<'j> Keyed<'j> for Road<'j> {
    const WHAT: &'static str = "a road: an object with `geometry` and `type`";

    fn take<A: MapAccess<'j>>(&mut self, key: &str, map: &mut A) -> Result<bool, A::Error> {
        match key {
            "id" => once(&mut self.id, map),
            "type" => once(&mut self.kind, map),
            "map_element_id" => once(&mut self.map_element_id, map),
            "geometry" => once(&mut self.geometry, map),
            _ => Ok(false),
        }
    }

    fn missing(&self) -> Option<&'static str> {
        let needed = [("geometry", self.geometry.is_none()), ("type", self.kind.is_none())];
        needed.into_iter().find(|(_, is_missing)| *is_missing).map(|(key, _)| key)
    }

    fn rest(&mut self) -> Option<&mut Rest<'j>> {
        Some(&mut self.rest)
    }
}

impl<'j> Keyed<'j> for Metadata<'j> {
    const WHAT: &'static str = "the metadata: an object with `sdc_track_index`";

    fn take<A: MapAccess<'j>>(&mut self, key: &str, map: &mut A) -> Result<bool, A::Error> {
        match key {
            "sdc_track_index" => once(&mut self.sdc_track_index, map),
            "objects_of_interest" => once(&mut self.objects_of_interest, map),
            "tracks_to_predict" => once(&mut self.tracks_to_predict, map),
            _ => Ok(false),
        }
    }

    fn missing(&self) -> Option<&'static str> {
        None
    }

    fn rest(&mut self) -> Option<&mut Rest<'j>> {
        Some(&mut self.rest)
    }
}

/// A position or velocity: an object with `x`, `y` and perhaps `z`.
#[derive(Clone, Copy)]
pub(super) struct Point(pub(super) [f64; 3]);

impl<'j> Deserialize<'j> for Point {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(expecting = "a point: an object with `x` and `y`")]
        struct Axes {
            x: f64,
            y: f64,
            #[serde(default)]
            z: f64,
        }
        let Axes { x, y, z } = Axes::deserialize(deserializer)?;
        Ok(Self([x, y, z]))
    }
}

/// An id: an integer or a text.
#[derive(Clone)]
pub(super) struct Name(pub(super) String);

impl<'j> Deserialize<'j> for Name {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct NameVisitor;
        impl Visitor<'_> for NameVisitor {
            type Value = Name;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("an integer or a text")
            }

            fn visit_i64<E>(self, number: i64) -> Result<Name, E> {
                Ok(Name(number.to_string()))
            }

            fn visit_u64<E>(self, number: u64) -> Result<Name, E> {
                Ok(Name(number.to_string()))
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Name, E> {
                let number = whole(value).ok_or_else(|| E::invalid_value(Unexpected::Float(value), &self))?;
                Ok(Name(number.to_string()))
            }

            fn visit_str<E>(self, text: &str) -> Result<Name, E> {
                Ok(Name(text.to_owned()))
            }
        }
        deserializer.deserialize_any(NameVisitor)
    }
}

/// An integer; some writers write all numbers as floats.
#[derive(Clone, Copy)]
pub(super) struct Whole(pub(super) i64);

/// The integer that a float is.
fn whole(value: f64) -> Option<i64> {
    (value.fract() == 0.0 && value.abs() < 1e15).then_some(value as i64)
}

impl<'j> Deserialize<'j> for Whole {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct WholeVisitor;
        impl Visitor<'_> for WholeVisitor {
            type Value = Whole;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("an integer")
            }

            fn visit_i64<E>(self, value: i64) -> Result<Whole, E> {
                Ok(Whole(value))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Whole, E> {
                i64::try_from(value)
                    .map(Whole)
                    .map_err(|_| E::invalid_value(Unexpected::Unsigned(value), &self))
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Whole, E> {
                whole(value).map(Whole).ok_or_else(|| E::invalid_value(Unexpected::Float(value), &self))
            }
        }
        deserializer.deserialize_any(WholeVisitor)
    }
}

/// Whether a road user is there: a bool, or 0 or 1.
#[derive(Clone, Copy)]
pub(super) struct Flag(pub(super) bool);

impl<'j> Deserialize<'j> for Flag {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct FlagVisitor;
        impl Visitor<'_> for FlagVisitor {
            type Value = Flag;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("true or false")
            }

            fn visit_bool<E>(self, value: bool) -> Result<Flag, E> {
                Ok(Flag(value))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Flag, E> {
                self.visit_f64(value as f64)
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Flag, E> {
                match whole(value) {
                    Some(number @ (0 | 1)) => Ok(Flag(number == 1)),
                    _ => Err(E::invalid_value(Unexpected::Float(value), &self)),
                }
            }
        }
        deserializer.deserialize_any(FlagVisitor)
    }
}
