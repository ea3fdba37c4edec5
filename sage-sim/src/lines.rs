//! Road lines and road edges as thin boxes: what the car may touch, and what its line detectors see.
//!
//! MetaDrive cuts each line into boxes of 1.5 m and each edge into boxes of 4 m; shorter ones vanish.
//! [`LineShapes::Exact`] keeps every segment of the map instead.

use sage_core::{
    geometry::{Aabb, OrientedBox, Point, distance},
    scene::{EDGE_WIDTH, Map, MapKind},
};

use crate::{
    grid::Grid,
    route::{Coordinates, Route},
};

/// Length of the pieces of a line, and of a dash, metres.
const STRIPE: f64 = 1.5;
/// Width of a line, metres.
const LINE_WIDTH: f64 = 0.075;
/// Length of the pieces of an edge, metres.
const EDGE_PIECE: f64 = 4.0;
/// Longest piece, metres: a long diagonal box would lie in many cells of the grid.
const LONGEST: f64 = 20.0;
/// Largest number of pieces besides one for each segment; above it, pieces become longer.
const MAX_PIECES: f64 = 250e3;

/// Shape of lines and edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LineShapes {
    /// Every segment of the map's polylines.
    #[default]
    Exact,
    /// MetaDrive's pieces.
    Pieces,
}

/// Kind of a line or edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineKind {
    /// Solid white, or any solid line that is not yellow.
    SolidWhite,
    /// Solid yellow.
    SolidYellow,
    /// Broken, any colour.
    Broken,
    /// Road boundary, median or other edge.
    Edge,
}

/// A piece of a line or edge.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// Kind.
    pub kind: LineKind,
    /// Index of its feature in the map.
    pub feature: u32,
    /// Area that it covers.
    pub area: OrientedBox,
    /// Height of the map at its centre, metres.
    pub height: f64,
}

/// Lines and edges of a map, indexed by a grid.
#[derive(Clone, Debug)]
pub struct Lines {
    pieces: Vec<Piece>,
    grid: Grid,
}

impl Lines {
    /// All lines and edges of a map.
    pub fn of(map: &Map, shapes: LineShapes) -> Self {
        let mut pieces = Vec::new();
        let length: f64 = map.features.iter().map(|feature| length_of(map.points_of(feature))).sum();
        let least = length / MAX_PIECES;
        for (number, feature) in (0..).zip(&map.features) {
            let kind = match &feature.kind {
                MapKind::Line(name) if name.contains("BROKEN") => LineKind::Broken,
                MapKind::Line(name) if name.contains("YELLOW") => LineKind::SolidYellow,
                MapKind::Line(_) => LineKind::SolidWhite,
                kind if kind.is_edge() => LineKind::Edge,
                _ => continue,
            };
            let points = map.points_of(feature);
            let of = (kind, number);
            match shapes {
                LineShapes::Exact => exact(of, points, LONGEST.max(least), &mut pieces),
                LineShapes::Pieces => cut(of, points, least, &mut pieces),
            }
        }
        let grid = Grid::of(pieces.iter().map(|piece| piece.area.aabb()));
        Self { pieces, grid }
    }

    /// All pieces.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// The grid over the pieces.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Calls `found` with every piece that a box touches.
    pub fn touching(&self, car: &OrientedBox, mut found: impl FnMut(&Piece)) {
        let bounds: Aabb = car.aabb();
        self.grid.near(&bounds, |k| {
            let piece = &self.pieces[k];
            if piece.area.intersects(car) {
                found(piece);
            }
        });
    }
}

/// A piece of a feature, given by its kind and index.
fn between((kind, feature): (LineKind, u32), a: Point, b: Point, height: f64) -> Piece {
    let width = if kind == LineKind::Edge { EDGE_WIDTH } else { LINE_WIDTH };
    let center = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
    let heading = (b[1] - a[1]).atan2(b[0] - a[0]);
    Piece { kind, feature, area: OrientedBox::new(center, heading, distance(a, b), width), height }
}

fn length_of(points: &[[f64; 3]]) -> f64 {
    points.windows(2).map(|pair| distance([pair[0][0], pair[0][1]], [pair[1][0], pair[1][1]])).sum()
}

/// Pieces of each segment, at most `longest` metres long. Broken lines are one line: no gaps.
fn exact(of: (LineKind, u32), points: &[[f64; 3]], longest: f64, pieces: &mut Vec<Piece>) {
    for pair in points.windows(2) {
        let parts = (length_of(pair) / longest).ceil();
        let at = |part: usize| {
            let share = part as f64 / parts;
            [0, 1, 2].map(|axis| pair[0][axis] + share * (pair[1][axis] - pair[0][axis]))
        };
        for part in 0..parts as usize {
            let ([ax, ay, az], [bx, by, bz]) = (at(part), at(part + 1));
            pieces.push(between(of, [ax, ay], [bx, by], 0.5 * (az + bz)));
        }
    }
}

/// MetaDrive's pieces of a line.
fn cut(of: (LineKind, u32), points: &[[f64; 3]], least: f64, pieces: &mut Vec<Piece>) {
    if points.len() < 2 {
        return;
    }
    let kind = of.0;
    let flat: Vec<Point> = points.iter().map(|p| [p[0], p[1]]).collect();
    let line = Route::new(&flat);
    let height = points.iter().map(|p| p[2]).sum::<f64>() / points.len() as f64;
    let (length, every) = match kind {
        LineKind::Edge => (EDGE_PIECE, EDGE_PIECE),
        LineKind::Broken => (STRIPE, 2.0 * STRIPE),
        LineKind::SolidWhite | LineKind::SolidYellow => (STRIPE, STRIPE),
    };
    let every = every.max(least);
    let count = (line.length() / every) as usize;
    let at = |along: f64| line.point_metadrive(Coordinates { along, across: 0.0 });
    for k in 0..count {
        let start = k as f64 * every;
        let end = match (k + 1 == count, kind) {
            (false, _) => start + length,
            (true, LineKind::Broken) => line.length() - STRIPE,
            (true, _) => line.length(),
        };
        let (a, b) = (at(start), at(end));
        if distance(a, b) > 0.0 {
            pieces.push(between(of, a, b, height));
        }
    }
}
