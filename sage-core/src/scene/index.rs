//! Trees over the map, each built when it is first asked for.

use std::sync::{Arc, OnceLock};

use super::{Map, MapKind};
use crate::geometry::SegmentIndex;

/// Search structures over one map. Build it once a scene and share it.
pub struct SceneIndex {
    map: Arc<Map>,
    boundaries: OnceLock<SegmentIndex>,
    medians: OnceLock<SegmentIndex>,
    motor_lanes: OnceLock<SegmentIndex>,
}

impl SceneIndex {
    /// An index of a map; costs nothing until it is asked.
    pub fn new(map: Arc<Map>) -> Self {
        Self { map, boundaries: OnceLock::new(), medians: OnceLock::new(), motor_lanes: OnceLock::new() }
    }

    /// The map that is indexed.
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// Road boundaries (`ROAD_EDGE_BOUNDARY`).
    pub fn boundaries(&self) -> &SegmentIndex {
        self.boundaries.get_or_init(|| self.build(|kind| *kind == MapKind::EdgeBoundary))
    }

    /// Medians (`ROAD_EDGE_MEDIAN`).
    pub fn medians(&self) -> &SegmentIndex {
        self.medians.get_or_init(|| self.build(|kind| *kind == MapKind::EdgeMedian))
    }

    /// Centre lines of lanes for motor vehicles.
    pub fn motor_lanes(&self) -> &SegmentIndex {
        self.motor_lanes.get_or_init(|| self.build(MapKind::is_motor_lane))
    }

    fn build(&self, wanted: impl Fn(&MapKind) -> bool) -> SegmentIndex {
        SegmentIndex::build(self.map.polylines(wanted))
    }
}
