//! The features of the published network: CAT's input of one target, without raster.
//!
//! The published weights depend on the following properties of that code, so they are reproduced:
//!
//! - agents' headings and velocities are in the world frame;
//! - only map points are scaled;
//! - two kinds of road line have no kind column;
//! - only the first 20 000 map points of a file are read;
//! - goals are a 1 m lattice in a disc.

use std::sync::Arc;

use sage_core::{
    geometry::Point,
    motion::{HISTORY, NOW},
    scene::{MapKind, Scene, Track, TrackKind},
};

use super::{AgentForecasts, EdgeGrid, EdgeKinds, Features, Frame, Layout, Table};
use crate::{Error, nn::Groups};

/// Numbers per row.
pub const COLUMNS: usize = 128;
/// Maximum number of agents, in the file's order.
const AGENTS: usize = 128;
/// Maximum number of map points, in the file's order.
const MAP_POINTS: usize = 20_000;
/// Centre of the disc of map points and goals, target frame, metres.
const CENTRE: Point = [0.0, 30.0];
/// Radius of the disc, metres.
const RADIUS: f64 = 80.0;
/// Factor of the map coordinates.
const SCALE: f64 = 0.03;
/// Points from the start of one map row to the next.
const STRIDE: usize = 10;
/// Points of a map row.
const ROW_POINTS: usize = 12;

/// Features of one target, as the published code computes them without a batch. The y axis is along the
/// target's heading. Each polyline shorter than the longest has one row of padding, because the published
/// maxima include it.
///
/// *Errors*: [`Error::Core`] if the target is not valid *now*.
pub fn features(scene: &Scene, target: usize) -> Result<Features, Error> {
    let scene = &*scene.as_observed();
    let (ours, _) = super::target_frame(scene, target)?;
    let frame = Frame::new(ours.origin(), ours.heading() - std::f64::consts::FRAC_PI_2);
    let track = &scene.tracks[target];
    let mut rows = Table { columns: COLUMNS, values: Vec::new() };
    let mut lengths = Vec::new();
    for agent in agents(scene, target) {
        append_agent(agent, &frame, &mut rows);
        lengths.push(HISTORY - 1);
    }
    let agents = lengths.len();
    append_map(scene, &frame, &mut rows, &mut lengths);
    let longest = lengths.iter().copied().max().unwrap_or(0);
    let (vectors, groups) = with_padding_row(&rows, &lengths, longest);
    let goals = lattice();
    let goal_features = Table { columns: 2, values: goals.iter().flatten().copied().collect() };
    Ok(Features {
        layout: Layout::Published,
        frame,
        velocity: frame.direction_from_world(track.velocity[NOW]).map(|v| v as f32),
        vectors,
        groups,
        agents,
        goals,
        goal_features,
        half: [0.0; 2],
        agent_forecasts: AgentForecasts::default(),
        edges: Arc::new(EdgeGrid::empty()),
        edge_kinds: EdgeKinds::default(),
        has_lanes: true,
        label: None,
    })
}

/// The lattice of goals: 20 069 points at 1 m.
pub fn lattice() -> Vec<[f32; 2]> {
    let all = (0..224).flat_map(|i| (0..224).map(move |j| [f64::from(i - 112), f64::from(j - 56)]));
    all.filter(|[x, y]| (x - CENTRE[0]).hypot(y - CENTRE[1]) < RADIUS).map(|p| p.map(|x| x as f32)).collect()
}

/// Radius of CAT's suppression at a speed *now* (m/s), metres.
pub fn suppression_radius(speed: f32) -> f32 {
    7.2 * (0.5 + 0.5 * (speed - 1.4) / 9.6).clamp(0.5, 1.0)
}

/// Appends one row of zeros to each polyline that is shorter than `longest`, the longest of its batch. The
/// other rows of the polyline do not read it.
pub fn with_padding_row(rows: &Table, lengths: &[usize], longest: usize) -> (Table, Groups) {
    let mut padded = Table { columns: rows.columns, values: Vec::with_capacity(rows.values.len() * 5 / 4) };
    let mut at = 0;
    for length in lengths {
        let end = at + length * rows.columns;
        padded.values.extend_from_slice(&rows.values[at..end]);
        if *length < longest {
            padded.values.resize(padded.values.len() + rows.columns, 0.0);
        }
        at = end;
    }
    let groups = lengths.iter().map(|&length| (length, usize::from(length < longest)));
    (padded, Groups::with_unseen(groups))
}

/// Ego, adversary, then the others in the file's order; the target is put first.
fn agents(scene: &Scene, target: usize) -> impl Iterator<Item = &Track> {
    let mut order = vec![scene.ego];
    order.extend(scene.adversary);
    let others = (0..scene.tracks.len()).filter(|k| *k != scene.ego && Some(*k) != scene.adversary);
    order.extend(others);
    order.truncate(AGENTS);
    order.retain(|&k| (0..HISTORY).any(|f| scene.tracks[k].is_valid(f)));
    match order.iter().position(|&k| k == target) {
        Some(position) => order.swap(0, position),
        None => order.insert(0, target),
    }
    order.into_iter().map(|k| &scene.tracks[k])
}

fn append_agent(track: &Track, frame: &Frame, rows: &mut Table) {
    let state = |f: usize| {
        if !track.is_valid(f) {
            return [0.0; 7];
        }
        let [x, y] = frame.frame_from_world(track.point(f));
        let [length, width, _] = track.size[f];
        let [vx, vy] = track.velocity[f];
        [x, y, length, width, track.heading[f], vx, vy]
    };
    let kind = match track.kind {
        TrackKind::Vehicle => 1,
        TrackKind::Pedestrian => 2,
        TrackKind::Cyclist => 3,
        TrackKind::Other(_) => 4,
    };
    for f in 0..HISTORY - 1 {
        let mut row = [0.0_f32; COLUMNS];
        for (k, (a, b)) in state(f).into_iter().zip(state(f + 1)).enumerate() {
            row[k] = a as f32;
            row[20 + k] = b as f32;
        }
        row[30] = f as f32;
        row[31 + f] = 1.0;
        row[50] = kind as f32;
        row[51 + kind] = 1.0;
        rows.values.extend_from_slice(&row);
    }
}

/// The published number of a kind of map feature; `None` for kinds that are not read.
fn kind_number(kind: &MapKind) -> Option<usize> {
    Some(match kind {
        MapKind::LaneFreeway => 1,
        MapKind::LaneSurfaceStreet => 2,
        MapKind::LaneBike => 3,
        MapKind::Line(name) => match name.trim_start_matches("ROAD_LINE_") {
            "BROKEN_SINGLE_WHITE" => 6,
            "SOLID_SINGLE_WHITE" => 7,
            "SOLID_DOUBLE_WHITE" => 8,
            "BROKEN_SINGLE_YELLOW" => 9,
            "BROKEN_DOUBLE_YELLOW" => 10,
            "SOLID_SINGLE_YELLOW" => 11,
            "SOLID_DOUBLE_YELLOW" => 12,
            "PASSING_DOUBLE_YELLOW" => 13,
            _ => return None,
        },
        MapKind::EdgeBoundary => 15,
        MapKind::EdgeMedian => 16,
        MapKind::StopSign => 17,
        MapKind::Crosswalk => 18,
        MapKind::SpeedBump => 19,
        _ => return None,
    })
}

fn append_map(scene: &Scene, frame: &Frame, rows: &mut Table, lengths: &mut Vec<usize>) {
    let mut left = MAP_POINTS;
    // Keyed as the published code sorts: by id, which is a number there.
    let mut lines: Vec<((u64, usize), usize, Vec<Point>)> = Vec::new();
    for (k, feature) in scene.map.features.iter().enumerate() {
        let Some(kind) = kind_number(&feature.kind) else { continue };
        let points = scene.map.points_of(feature);
        // A stop sign is stored as three equal points.
        let copies = if kind == 17 { 3 } else { 1 };
        let read: Vec<Point> = points
            .iter()
            .flat_map(|p| std::iter::repeat_n(p, copies))
            .take(left)
            .map(|p| frame.frame_from_world([p[0], p[1]]))
            .collect();
        left -= read.len();
        let is_inside = |p: &Point| (p[0] - CENTRE[0]).hypot(p[1] - CENTRE[1]) < RADIUS;
        let inside: Vec<Point> = read.into_iter().filter(is_inside).collect();
        if !inside.is_empty() {
            lines.push(((feature.id.parse().unwrap_or(u64::MAX), k), kind, inside));
        }
    }
    lines.sort_by_key(|line| line.0);
    if lines.is_empty() {
        rows.values.resize(rows.values.len() + COLUMNS, 0.0);
        lengths.push(1);
    }
    for (_, kind, points) in &lines {
        let n = points.len();
        for start in (0..n).step_by(STRIDE) {
            let mut row = [0.0_f32; COLUMNS];
            for k in 0..ROW_POINTS {
                let [x, y] = points[(start + k).min(n - 1)];
                row[2 * k] = (x * SCALE) as f32;
                row[2 * k + 1] = (y * SCALE) as f32;
            }
            row[30 + kind] = 1.0;
            // As published, this overwrites the columns of kinds 10 and 11.
            row[40] = start as f32;
            row[41] = start as f32 / n as f32;
            rows.values.extend_from_slice(&row);
        }
        lengths.push(n.div_ceil(STRIDE));
    }
}
