//! Lanes, lines, edges and areas.

use std::ops::Range;

/// Largest distance between the end of an edge and the edge that continues it, metres.
pub(super) const JOINED: f64 = 1.0;

/// MetaDrive's sidewalk, an area.
const SIDEWALK: &str = "ROAD_EDGE_SIDEWALK";
/// MetaDrive's guard rail, a sidewalk that nothing penetrates.
const GUARDRAIL: &str = "GUARDRAIL";

/// Kind of a map feature; names are MetaDrive's.
///
/// ```
/// use sage_core::scene::MapKind;
///
/// let lane = MapKind::from_name("LANE_SURFACE_STREET");
/// assert!(lane.is_motor_lane() && !lane.is_edge());
/// // A median is an edge, but not a boundary: the road goes on behind it.
/// assert!(MapKind::EdgeMedian.is_edge() && !MapKind::EdgeMedian.is_boundary());
/// // Names are kept as they are in the file.
/// assert_eq!(MapKind::from_name("ROAD_LINE_SOLID_SINGLE_WHITE").name(), "ROAD_LINE_SOLID_SINGLE_WHITE");
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum MapKind {
    /// LANE_FREEWAY.
    LaneFreeway,
    /// LANE_SURFACE_STREET.
    LaneSurfaceStreet,
    /// LANE_BIKE_LANE.
    LaneBike,
    /// Any other LANE_….
    LaneOther(String),
    /// ROAD_LINE_…, by the whole name, such as ROAD_LINE_SOLID_SINGLE_WHITE.
    Line(String),
    /// ROAD_EDGE_BOUNDARY: the road lies on its left.
    EdgeBoundary,
    /// ROAD_EDGE_MEDIAN.
    EdgeMedian,
    /// Any other ROAD_EDGE_…, such as ROAD_EDGE_SIDEWALK, and GUARDRAIL. Which of its sides is road is unknown.
    EdgeOther(String),
    /// CROSSWALK.
    Crosswalk,
    /// SPEED_BUMP.
    SpeedBump,
    /// DRIVEWAY.
    Driveway,
    /// STOP_SIGN: a single point.
    StopSign,
    /// Any other name of the file.
    Other(String),
}

impl MapKind {
    /// The kind of a MetaDrive type name.
    pub fn from_name(name: &str) -> Self {
        match name {
            "LANE_FREEWAY" => Self::LaneFreeway,
            "LANE_SURFACE_STREET" => Self::LaneSurfaceStreet,
            "LANE_BIKE_LANE" => Self::LaneBike,
            "ROAD_EDGE_BOUNDARY" => Self::EdgeBoundary,
            "ROAD_EDGE_MEDIAN" => Self::EdgeMedian,
            "CROSSWALK" => Self::Crosswalk,
            "SPEED_BUMP" => Self::SpeedBump,
            "DRIVEWAY" => Self::Driveway,
            "STOP_SIGN" => Self::StopSign,
            _ if name.starts_with("LANE_") => Self::LaneOther(name.to_owned()),
            _ if name.starts_with("ROAD_LINE_") => Self::Line(name.to_owned()),
            _ if name.starts_with("ROAD_EDGE_") || name == GUARDRAIL => Self::EdgeOther(name.to_owned()),
            _ => Self::Other(name.to_owned()),
        }
    }

    /// The MetaDrive type name.
    pub fn name(&self) -> &str {
        match self {
            Self::LaneFreeway => "LANE_FREEWAY",
            Self::LaneSurfaceStreet => "LANE_SURFACE_STREET",
            Self::LaneBike => "LANE_BIKE_LANE",
            Self::EdgeBoundary => "ROAD_EDGE_BOUNDARY",
            Self::EdgeMedian => "ROAD_EDGE_MEDIAN",
            Self::Crosswalk => "CROSSWALK",
            Self::SpeedBump => "SPEED_BUMP",
            Self::Driveway => "DRIVEWAY",
            Self::StopSign => "STOP_SIGN",
            Self::LaneOther(name) | Self::Line(name) | Self::EdgeOther(name) | Self::Other(name) => name,
        }
    }

    /// Whether motor vehicles drive on it.
    pub fn is_motor_lane(&self) -> bool {
        matches!(self, Self::LaneFreeway | Self::LaneSurfaceStreet | Self::LaneOther(_))
    }

    /// Whether it is a lane of any kind.
    pub fn is_lane(&self) -> bool {
        self.is_motor_lane() || matches!(self, Self::LaneBike)
    }

    /// Whether it is a solid line that is painted on the road, single or double.
    pub fn is_solid_line(&self) -> bool {
        matches!(self, Self::Line(name) if name.contains("SOLID"))
    }

    /// Whether it bounds the road.
    pub fn is_edge(&self) -> bool {
        matches!(self, Self::EdgeBoundary | Self::EdgeMedian | Self::EdgeOther(_))
    }

    /// Whether it bounds the road from the side: an edge of any kind but a median.
    pub fn is_boundary(&self) -> bool {
        matches!(self, Self::EdgeBoundary | Self::EdgeOther(_))
    }

    /// Whether it is a sidewalk or a guard rail. Closed ones are areas that are not road.
    pub fn is_sidewalk(&self) -> bool {
        matches!(self, Self::EdgeOther(name) if name == SIDEWALK || name == GUARDRAIL)
    }
}

/// A stretch along which another lane runs beside this one, as point indices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Neighbor {
    /// Index of the other lane in [`Map::features`].
    pub lane: usize,
    /// First and last point of this lane.
    pub own: [usize; 2],
    /// First and last point of the other lane.
    pub other: [usize; 2],
}

/// A stretch along which a line or edge bounds a lane.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Boundary {
    /// Index of the line or edge in [`Map::features`].
    pub feature: usize,
    /// First and last point of the lane.
    pub own: [usize; 2],
}

/// Attributes of a lane besides its centre line.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lane {
    /// Speed limit, m/s, if there is one.
    pub speed_limit: Option<f64>,
    /// Lanes that lead into this one (indices into [`Map::features`]).
    pub entries: Vec<usize>,
    /// Lanes that follow.
    pub exits: Vec<usize>,
    /// Neighbours on the left and on the right.
    pub neighbors: [Vec<Neighbor>; 2],
    /// Boundaries on the left and on the right.
    pub boundaries: [Vec<Boundary>; 2],
    /// Stop signs that hold for it (indices into [`Map::features`]).
    pub stop_signs: Vec<usize>,
    /// Width to the left and to the right per point, metres; empty if unknown.
    pub width: Vec<[f64; 2]>,
}

/// One feature of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapFeature {
    /// Identifier, unique in the map.
    pub id: String,
    /// Kind.
    pub kind: MapKind,
    /// Its points in [`Map::points`]: a polyline, the corners of a polygon, or one point.
    pub points: Range<usize>,
    /// Attributes, if it is a lane.
    pub lane: Option<Box<Lane>>,
}

/// The map of a scene. All points lie in one buffer; a file without heights gives 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Map {
    /// Points of all features, metres, with height.
    pub points: Vec<[f64; 3]>,
    /// Features; readers sort them by id ([`Map::in_order_of_ids`]).
    pub features: Vec<MapFeature>,
}

/// Fewest points of a closed outline, with the repeated first one.
const FEWEST_OF_OUTLINE: usize = 4;

impl Map {
    /// Points of a feature.
    pub fn points_of(&self, feature: &MapFeature) -> &[[f64; 3]] {
        &self.points[feature.points.clone()]
    }

    /// Whether a feature is an area that is not road: a sidewalk with a closed outline.
    pub fn is_sidewalk_area(&self, feature: &MapFeature) -> bool {
        let points = self.points_of(feature);
        let plane = |p: &[f64; 3]| [p[0], p[1]];
        feature.kind.is_sidewalk()
            && points.len() >= FEWEST_OF_OUTLINE
            && points.first().map(plane) == points.last().map(plane)
    }

    /// Whether the map has an edge of any kind. Without one, nothing says where the road ends.
    pub fn has_edges(&self) -> bool {
        self.features.iter().any(|feature| feature.kind.is_edge() && feature.points.len() > 1)
    }

    /// Whether a feature has both points of an index range.
    pub fn has_points(&self, feature: usize, range: [usize; 2]) -> bool {
        self.features.get(feature).is_some_and(|feature| range[0].max(range[1]) < feature.points.len())
    }

    /// Features of the accepted kinds, with their index and points.
    pub fn polylines(&self, accept: impl Fn(&MapKind) -> bool) -> impl Iterator<Item = (u32, &[[f64; 3]])> {
        self.features
            .iter()
            .enumerate()
            .filter(move |(_, feature)| accept(&feature.kind))
            .map(|(k, feature)| (k as u32, self.points_of(feature)))
    }
}
