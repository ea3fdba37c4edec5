//! The road of a thumbnail as simplified lines.

use sage_core::{
    geometry::{Aabb, Point},
    scene::{Map, MapKind},
};
use serde::Serialize;

use super::car::decimetres;
use crate::player::map::{parts_inside, simplified};

/// Largest error of a line, metres.
const ERROR: f64 = 0.3;

/// A line of the map, or an area: its kind, and its points in decimetres as differences.
#[derive(Serialize)]
pub struct RoadLine {
    kind: &'static str,
    points: Vec<i64>,
}

/// The lines of a map in an area.
pub fn lines(map: &Map, area: &Aabb) -> Vec<RoadLine> {
    let mut all = Vec::new();
    for feature in &map.features {
        let kind = match &feature.kind {
            kind if kind.is_motor_lane() => "lane",
            kind if kind.is_edge() => "edge",
            MapKind::Line(_) => "line",
            MapKind::Crosswalk => "crosswalk",
            _ => continue,
        };
        let points: Vec<Point> = map.points_of(feature).iter().map(|p| [p[0], p[1]]).collect();
        let parts = if kind == "crosswalk" { vec![points] } else { parts_inside(&points, area) };
        let is_near = |part: &&Vec<Point>| part.len() > 1 && Aabb::of(part.iter().copied()).meets(area);
        for part in parts.iter().filter(is_near) {
            all.push(RoadLine { kind, points: decimetres(&simplified(part, ERROR)) });
        }
    }
    all
}
