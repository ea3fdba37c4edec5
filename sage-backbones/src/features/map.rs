//! Rows of the map: lanes, lines, edges and areas in short pieces, the nearest to where the target
//! is heading.

use sage_core::scene::{LightState, MapKind, Scene, SceneIndex};

use super::{Frame, Routes, Table, VECTOR_COLUMNS};

/// Most pieces that are looked at.
const PIECES: usize = 128;
/// Rows of a piece.
const ROWS: usize = 5;
/// Length of a row's stretch, metres.
const STRETCH: f64 = 4.0;
/// Pieces farther from the target's way than this are not looked at, metres.
const REACH: f64 = 150.0;
/// Seconds of straight driving that count as the way.
const AHEAD: f64 = 6.0;

/// Columns whose sign changes when left and right change places, agents' rows included.
pub(super) const SIGNED: [usize; 4] = [1, 3, 5, 29];

/// One stretch of a line.
struct Piece {
    rank: f64,
    feature: usize,
    /// Points along it, target frame, with the distance from the line's start; the first `count` of them.
    points: [[f64; 3]; ROWS + 1],
    count: usize,
}

/// Appends the rows of the pieces and the number of rows of each.
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
    let mut pieces = Vec::with_capacity(256);
    for (feature, part) in scene.map.features.iter().enumerate() {
        if column(&part.kind).is_some() {
            let along = &index.along()[part.points.clone()];
            cut(scene.map.points_of(part), along, feature, frame, ahead, &mut pieces);
        }
    }
    // Stable among equals: the order of the file.
    let mut order: Vec<&Piece> = pieces.iter().collect();
    order.sort_by(|a, b| a.rank.total_cmp(&b.rank));
    for piece in order.into_iter().take(PIECES) {
        lengths.push(write(scene, routes, piece, vectors));
    }
}

/// Cuts a polyline, given with the distances along it, into pieces of [`ROWS`] stretches and keeps those
/// within [`REACH`].
fn cut(line: &[[f64; 3]], along: &[f64], feature: usize, frame: &Frame, ahead: f64, pieces: &mut Vec<Piece>) {
    let (mut points, mut count) = ([[0.0; 3]; ROWS + 1], 0);
    let mut last_kept = 0.0;
    let mut push = |points: [[f64; 3]; ROWS + 1], count: usize| {
        let rank = points[..count].iter().map(|p| from_way(p, ahead)).fold(f64::INFINITY, f64::min);
        if rank < REACH {
            pieces.push(Piece { rank, feature, points, count });
        }
    };
    for (k, (point, &along)) in line.iter().zip(along).enumerate() {
        if k > 0 && k + 1 < line.len() && along - last_kept < STRETCH {
            continue;
        }
        let [x, y] = frame.to_local([point[0], point[1]]);
        points[count] = [x, y, along];
        count += 1;
        last_kept = along;
        if count == ROWS + 1 {
            push(points, count);
            (points[0], count) = (points[ROWS], 1);
        }
    }
    if count > 1 || line.len() == 1 {
        push(points, count);
    }
}

/// Distance to the straight way ahead.
fn from_way(p: &[f64; 3], ahead: f64) -> f64 {
    let dx = p[0] - p[0].clamp(0.0, ahead);
    (dx * dx + p[1] * p[1]).sqrt()
}

/// Column of a kind; kinds without one are not looked at.
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

/// Writes the rows of a piece; returns how many.
fn write(scene: &Scene, routes: &Routes, piece: &Piece, vectors: &mut Table) -> usize {
    let part = &scene.map.features[piece.feature];
    let single = [piece.points[0], piece.points[0]];
    let pairs = if piece.count == 1 { &single } else { &piece.points[..piece.count] };
    let light = routes.light(piece.feature);
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
        if let Some(way) = routes.reach(piece.feature) {
            row[27] = 1.0;
            row[30] = ((way.distance + a[2]) / 40.0).clamp(-4.0, 8.0) as f32;
            row[31] = f32::from(way.changes) / 2.0;
        }
        row[28] = (b[0] / 40.0) as f32;
        row[29] = (b[1] / 40.0) as f32;
        vectors.values.extend_from_slice(&row);
    }
    pairs.len() - 1
}
