//! Rows of the map: lanes, lines, edges and areas as short polylines, the nearest to the target's straight
//! extrapolation first.

use sage_core::scene::{LightState, MapKind, Scene, SceneIndex};

use super::{Frame, Routes, Table, VECTOR_COLUMNS};

/// Maximum number of polylines, the nearest first.
const POLYLINES: usize = 128;
/// Maximum number of rows of a polyline.
const ROWS: usize = 5;
/// Least length of a row's segment, metres; the last segment of a feature may be shorter.
const SEGMENT: f64 = 4.0;
/// Polylines farther from the target's straight extrapolation than this are left out, metres.
const REACH: f64 = 150.0;
/// Duration of the straight extrapolation, seconds.
const AHEAD: f64 = 6.0;

/// Columns whose sign changes in the mirrored scene, agents' rows included.
pub(super) const SIGNED: [usize; 4] = [1, 3, 5, 29];

/// A short part of a map feature.
struct Polyline {
    /// Distance to the target's straight extrapolation, metres.
    rank: f64,
    feature: usize,
    /// The first `count` are its points, target frame, each with the distance from the feature's start.
    points: [[f64; 3]; ROWS + 1],
    count: usize,
}

/// Appends the rows of the polylines and the number of rows of each.
pub(super) fn append(
    scene: &Scene,
    index: &SceneIndex,
    routes: &Routes,
    frame: &Frame,
    speed: f32,
    vectors: &mut Table,
    lengths: &mut Vec<usize>,
) {
    let ahead = (AHEAD * f64::from(speed)).clamp(0.0, REACH);
    let mut polylines = Vec::with_capacity(256);
    for (feature, part) in scene.map.features.iter().enumerate() {
        if column(&part.kind).is_some() {
            let along = &index.along()[part.points.clone()];
            cut(scene.map.points_of(part), along, feature, frame, ahead, &mut polylines);
        }
    }
    // A stable sort: polylines of equal rank stay in the order of the file.
    let mut order: Vec<&Polyline> = polylines.iter().collect();
    order.sort_by(|a, b| a.rank.total_cmp(&b.rank));
    for polyline in order.into_iter().take(POLYLINES) {
        lengths.push(write(scene, routes, polyline, vectors));
    }
}

/// Cuts the line of a map feature, given with the distances along it, into polylines of up to [`ROWS`]
/// segments. Keeps those within [`REACH`].
fn cut(
    line: &[[f64; 3]],
    along: &[f64],
    feature: usize,
    frame: &Frame,
    ahead: f64,
    polylines: &mut Vec<Polyline>,
) {
    let (mut points, mut count) = ([[0.0; 3]; ROWS + 1], 0);
    let mut last = 0.0;
    let mut push = |points: [[f64; 3]; ROWS + 1], count: usize| {
        let rank = points[..count].iter().map(|p| from_extrapolation(p, ahead)).fold(f64::INFINITY, f64::min);
        if rank < REACH {
            polylines.push(Polyline { rank, feature, points, count });
        }
    };
    for (k, (point, &along)) in line.iter().zip(along).enumerate() {
        if k > 0 && k + 1 < line.len() && along - last < SEGMENT {
            continue;
        }
        let [x, y] = frame.frame_from_world([point[0], point[1]]);
        points[count] = [x, y, along];
        count += 1;
        last = along;
        if count == ROWS + 1 {
            push(points, count);
            (points[0], count) = (points[ROWS], 1);
        }
    }
    if count > 1 || line.len() == 1 {
        push(points, count);
    }
}

/// Distance to the target's straight extrapolation, which ends at x = `ahead`.
fn from_extrapolation(p: &[f64; 3], ahead: f64) -> f64 {
    let dx = p[0] - p[0].clamp(0.0, ahead);
    (dx * dx + p[1] * p[1]).sqrt()
}

/// Column of a kind; kinds without a column are left out.
fn column(kind: &MapKind) -> Option<usize> {
    Some(match kind {
        kind if kind.is_motor_lane() => 15,
        MapKind::LaneBike => 16,
        MapKind::Line(name) if name.contains("BROKEN") => 17,
        MapKind::Line(_) => 18,
        kind if kind.is_edge() => 19,
        MapKind::Crosswalk | MapKind::SpeedBump => 20,
        MapKind::StopSign => 21,
        _ => return None,
    })
}

/// Writes the rows of a polyline; returns their number.
fn write(scene: &Scene, routes: &Routes, polyline: &Polyline, vectors: &mut Table) -> usize {
    let part = &scene.map.features[polyline.feature];
    let single = [polyline.points[0], polyline.points[0]];
    let pairs = if polyline.count == 1 { &single } else { &polyline.points[..polyline.count] };
    let light = routes.light(polyline.feature);
    for (k, pair) in pairs.windows(2).enumerate() {
        let [a, b] = [pair[0], pair[1]];
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let length = dx.hypot(dy).max(1e-6);
        let mut row = [0.0; VECTOR_COLUMNS];
        row[0] = (a[0] / 40.0) as f32;
        row[1] = (a[1] / 40.0) as f32;
        row[2] = (dx / length) as f32;
        row[3] = (dy / length) as f32;
        if let Some(column) = column(&part.kind) {
            row[column] = 1.0;
        }
        match light {
            Some(LightState::Stop) => row[22] = 1.0,
            Some(LightState::Caution) => row[23] = 1.0,
            Some(LightState::Go) => row[24] = 1.0,
            _ => {}
        }
        if let Some(limit) = part.lane.as_ref().and_then(|lane| lane.speed_limit) {
            row[25] = (limit / 20.0).clamp(0.0, 4.0) as f32;
        }
        row[26] = k as f32 / ROWS as f32;
        if let Some(route) = routes.reach(polyline.feature) {
            row[27] = 1.0;
            row[30] = ((route.distance + a[2]) / 40.0).clamp(-4.0, 8.0) as f32;
            row[31] = f32::from(route.changes) / 2.0;
        }
        row[28] = (b[0] / 40.0) as f32;
        row[29] = (b[1] / 40.0) as f32;
        vectors.values.extend_from_slice(&row);
    }
    pairs.len() - 1
}
