//! What `log_map_archive_<id>.json` says: lanes, drivable areas and crossings.

use std::{fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer,
    de::{MapAccess, Visitor},
};

/// The map of a scenario. Keys that are not named here are of no use for a scene.
#[derive(Deserialize)]
#[serde(expecting = "a map of Argoverse 2: an object with `lane_segments` and `drivable_areas`")]
pub(super) struct MapFile {
    pub(super) lane_segments: Values<LaneSegment>,
    pub(super) drivable_areas: Values<Area>,
    #[serde(default)]
    pub(super) pedestrian_crossings: Values<Crossing>,
}

/// A lane.
#[derive(Deserialize)]
#[serde(expecting = "a lane segment: an object with `id` and boundaries")]
pub(super) struct LaneSegment {
    pub(super) id: i64,
    #[serde(default)]
    pub(super) centerline: Option<Vec<Point>>,
    pub(super) left_lane_boundary: Vec<Point>,
    pub(super) right_lane_boundary: Vec<Point>,
    pub(super) lane_type: String,
    #[serde(default)]
    pub(super) left_lane_mark_type: Option<String>,
    #[serde(default)]
    pub(super) right_lane_mark_type: Option<String>,
    #[serde(default)]
    pub(super) left_neighbor_id: Option<i64>,
    #[serde(default)]
    pub(super) right_neighbor_id: Option<i64>,
    #[serde(default)]
    pub(super) predecessors: Vec<i64>,
    #[serde(default)]
    pub(super) successors: Vec<i64>,
}

/// Road on which vehicles may drive.
#[derive(Deserialize)]
#[serde(expecting = "a drivable area: an object with `area_boundary`")]
pub(super) struct Area {
    pub(super) area_boundary: Vec<Point>,
}

/// A crossing between two edges.
#[derive(Deserialize)]
#[serde(expecting = "a crossing: an object with `id`, `edge1` and `edge2`")]
pub(super) struct Crossing {
    pub(super) id: i64,
    pub(super) edge1: Vec<Point>,
    pub(super) edge2: Vec<Point>,
}

/// A place; its height is not used.
#[derive(Clone, Copy, Deserialize)]
#[serde(expecting = "a point: an object with `x` and `y`")]
pub(super) struct Point {
    x: f64,
    y: f64,
}

impl Point {
    pub(super) fn place(self) -> [f64; 2] {
        [self.x, self.y]
    }
}

/// The values of an object, in the order of the file.
pub(super) struct Values<T>(pub(super) Vec<T>);

impl<T> Default for Values<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<'j, T: Deserialize<'j>> Deserialize<'j> for Values<T> {
    fn deserialize<D: Deserializer<'j>>(deserializer: D) -> Result<Self, D::Error> {
        struct ValuesVisitor<T>(PhantomData<T>);
        impl<'j, T: Deserialize<'j>> Visitor<'j> for ValuesVisitor<T> {
            type Value = Values<T>;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("an object of features by their id")
            }

            fn visit_map<A: MapAccess<'j>>(self, mut map: A) -> Result<Values<T>, A::Error> {
                let mut all = Vec::new();
                while map.next_key::<serde::de::IgnoredAny>()?.is_some() {
                    all.push(map.next_value()?);
                }
                Ok(Values(all))
            }
        }
        deserializer.deserialize_map(ValuesVisitor(PhantomData))
    }
}
