//! The map around the drives as simplified lines.

use sage_core::{
    geometry::{Aabb, Point, cross, dot, norm, sub},
    scene::{MapFeature, MapKind, Scene},
};
use serde::Serialize;

use super::encoding::{differences, hundredths};
use crate::drawing::lane_width;

/// A map feature: its kind on the page, its points, and the width of a lane, in centimetres.
#[derive(Serialize)]
pub(crate) struct EncodedFeature {
    kind: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    width: Option<i64>,
    x: Vec<i64>,
    y: Vec<i64>,
}

/// The features in an area, with lines simplified up to an error, metres.
pub(crate) fn encoded(scene: &Scene, area: &Aabb, error: f64, origin: Point) -> Vec<EncodedFeature> {
    let mut all = Vec::new();
    for feature in &scene.map.features {
        let is_sidewalk = scene.map.is_sidewalk_area(feature);
        let Some(kind) = is_sidewalk.then_some("sidewalk").or_else(|| kind(&feature.kind)) else { continue };
        let points: Vec<Point> = scene.map.points_of(feature).iter().map(|p| [p[0], p[1]]).collect();
        let is_area = matches!(kind, "driveway" | "crosswalk" | "bump" | "sidewalk");
        let parts = if is_area { vec![points] } else { parts_inside(&points, area) };
        for part in parts.iter().filter(|part| part.len() > 1 && Aabb::of(part.iter().copied()).meets(area)) {
            let kept = simplified(part, error);
            let column = |k: usize| differences(kept.iter().map(|p| p[k] - origin[k]));
            let (x, y) = (column(0), column(1));
            all.push(EncodedFeature { kind, width: width(feature), x, y });
        }
    }
    all
}

fn kind(kind: &MapKind) -> Option<&'static str> {
    Some(match kind {
        MapKind::LaneBike => "bike",
        kind if kind.is_lane() => "lane",
        MapKind::Line(name) => match (name.contains("YELLOW"), name.contains("BROKEN")) {
            (true, true) => "yellow-broken",
            (true, false) => "yellow",
            (false, true) => "white-broken",
            (false, false) => "white",
        },
        MapKind::EdgeMedian => "median",
        kind if kind.is_edge() => "edge",
        MapKind::Crosswalk => "crosswalk",
        MapKind::SpeedBump => "bump",
        MapKind::Driveway => "driveway",
        _ => return None,
    })
}

fn width(feature: &MapFeature) -> Option<i64> {
    feature.kind.is_lane().then(|| hundredths(lane_width(feature)))
}

/// The pieces of a line whose segments come into an area.
pub fn parts_inside(points: &[Point], area: &Aabb) -> Vec<Vec<Point>> {
    let mut parts: Vec<Vec<Point>> = Vec::new();
    let mut is_open = false;
    for pair in points.windows(2) {
        let is_inside = Aabb::of(pair.iter().copied()).meets(area);
        if is_inside && !is_open {
            parts.push(vec![pair[0]]);
        }
        if let Some(part) = parts.last_mut().filter(|_| is_inside) {
            part.push(pair[1]);
        }
        is_open = is_inside;
    }
    parts
}

/// Points of a line that are simplified together: the worst case is quadratic in them.
const CHUNK: usize = 2048;

/// A line with fewer points, none of the others farther than `error` from it (Ramer, Douglas and Peucker).
pub fn simplified(points: &[Point], error: f64) -> Vec<Point> {
    let mut keeps = vec![false; points.len()];
    let end = points.len() - 1;
    let mut spans: Vec<_> = (0..=end).step_by(CHUNK).map(|first| (first, (first + CHUNK).min(end))).collect();
    while let Some((first, last)) = spans.pop() {
        (keeps[first], keeps[last]) = (true, true);
        let gaps = (first + 1..last).map(|k| (distance_to(points[k], points[first], points[last]), k));
        let Some((gap, k)) = gaps.max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        if gap > error {
            keeps[k] = true;
            spans.extend([(first, k), (k, last)]);
        }
    }
    points.iter().zip(keeps).filter(|(_, keeps)| *keeps).map(|(p, _)| *p).collect()
}

/// Distance of a point from a segment.
fn distance_to(p: Point, a: Point, b: Point) -> f64 {
    let (d, r) = (sub(b, a), sub(p, a));
    let along = dot(r, d);
    if along <= 0.0 {
        norm(r)
    } else if along >= dot(d, d) {
        norm(sub(p, b))
    } else {
        cross(d, r).abs() / norm(d)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_simplified_line_stays_within_the_error() {
        let points: Vec<Point> = (0..200).map(|k| f64::from(k) * 0.5).map(|x| [x, (0.1 * x).sin()]).collect();
        let kept = simplified(&points, 0.05);
        assert!(kept.len() < 40 && kept.first() == points.first() && kept.last() == points.last());
        for p in &points {
            let gap = kept.windows(2).map(|pair| distance_to(*p, pair[0], pair[1])).fold(f64::MAX, f64::min);
            assert!(gap <= 0.05 + 1e-12, "{gap}");
        }
        // A closed line keeps more than its coinciding ends.
        assert_eq!(simplified(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]], 0.05).len(), 4);
    }

    #[test]
    fn only_segments_near_the_area_stay() {
        let area = Aabb::of([[0.0, -1.0], [10.0, 1.0]]);
        let line =
            [[-20.0, 0.0], [-10.0, 0.0], [-5.0, 0.0], [5.0, 0.0], [15.0, 0.0], [20.0, 0.0], [20.0, 9.0]];
        assert_eq!(parts_inside(&line, &area), [[[-5.0, 0.0], [5.0, 0.0], [15.0, 0.0]]]);
    }
}
