//! Names of the enum values of a `Scenario`, by number, as ScenarioNet's converter writes them.

/// Kilometres of a mile, in which records state speed limits.
pub(super) const MILE: f64 = 1.609_344;

/// Words of `Track.ObjectType`.
pub(super) const OBJECT_TYPES: [&str; 5] = ["UNSET", "VEHICLE", "PEDESTRIAN", "CYCLIST", "OTHER"];

/// Words of `RequiredPrediction.DifficultyLevel`.
pub(super) const DIFFICULTIES: [&str; 3] = ["NONE", "LEVEL_1", "LEVEL_2"];

/// Words of `LaneCenter.LaneType`.
pub(crate) const LANE_TYPES: [&str; 4] =
    ["LANE_UNKNOWN", "LANE_FREEWAY", "LANE_SURFACE_STREET", "LANE_BIKE_LANE"];

/// Words of `RoadLine.RoadLineType`, also of boundaries of lanes.
pub(crate) const ROAD_LINE_TYPES: [&str; 9] = [
    "UNKNOWN",
    "ROAD_LINE_BROKEN_SINGLE_WHITE",
    "ROAD_LINE_SOLID_SINGLE_WHITE",
    "ROAD_LINE_SOLID_DOUBLE_WHITE",
    "ROAD_LINE_BROKEN_SINGLE_YELLOW",
    "ROAD_LINE_BROKEN_DOUBLE_YELLOW",
    "ROAD_LINE_SOLID_SINGLE_YELLOW",
    "ROAD_LINE_SOLID_DOUBLE_YELLOW",
    "ROAD_LINE_PASSING_DOUBLE_YELLOW",
];

/// Words of `RoadEdge.RoadEdgeType`.
pub(super) const ROAD_EDGE_TYPES: [&str; 3] = ["UNKNOWN", "ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN"];

/// Words of `TrafficSignalLaneState.State`.
pub(super) const SIGNAL_STATES: [&str; 9] = [
    "LANE_STATE_UNKNOWN",
    "LANE_STATE_ARROW_STOP",
    "LANE_STATE_ARROW_CAUTION",
    "LANE_STATE_ARROW_GO",
    "LANE_STATE_STOP",
    "LANE_STATE_CAUTION",
    "LANE_STATE_GO",
    "LANE_STATE_FLASHING_STOP",
    "LANE_STATE_FLASHING_CAUTION",
];

/// Member of `MapFeature.feature_data`: field number, field name, type of the converter, and the name of the
/// points.
pub(super) struct Member {
    pub(super) number: u32,
    pub(super) name: &'static str,
    pub(super) kind: &'static str,
    pub(super) points: &'static str,
}

const fn member(number: u32, name: &'static str, kind: &'static str, points: &'static str) -> Member {
    Member { number, name, kind, points }
}

/// Number of a lane among [`MEMBERS`].
pub(super) const LANE: u32 = 3;
/// Number of a road line.
pub(super) const ROAD_LINE: u32 = 4;
/// Number of a road edge.
pub(super) const ROAD_EDGE: u32 = 5;
/// Number of a stop sign.
pub(super) const STOP_SIGN: u32 = 7;

/// The members of `MapFeature.feature_data`. The first three have a type of their own instead of `kind`.
pub(super) const MEMBERS: [Member; 7] = [
    member(LANE, "lane", "", "polyline"),
    member(ROAD_LINE, "road_line", "", "polyline"),
    member(ROAD_EDGE, "road_edge", "", "polyline"),
    member(STOP_SIGN, "stop_sign", "STOP_SIGN", "position"),
    member(8, "crosswalk", "CROSSWALK", "polygon"),
    member(9, "speed_bump", "SPEED_BUMP", "polygon"),
    member(10, "driveway", "DRIVEWAY", "polygon"),
];
