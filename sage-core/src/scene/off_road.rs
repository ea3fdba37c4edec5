//! Leaving the road: edges that something touches, apart from those that it touches at its start.

use std::collections::{HashMap, HashSet};

use super::{LEVEL_GAP, Map, Scene, SceneIndex, Track, is_one_level, map::JOINED};
use crate::{
    geometry::{OrientedBox, Point, distance, sub},
    motion::{HORIZON, NOW},
};

/// Width of an edge, metres.
pub const EDGE_WIDTH: f64 = 0.2;

/// The edges (map features) that are touched since the start. Recorded boxes overlap kerbs, so these do not count until they
/// are left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EdgesSinceStart(Vec<u32>);

impl EdgesSinceStart {
    /// Those that are touched at the start.
    pub fn new(touched: &[u32]) -> Self {
        Self(touched.to_vec())
    }

    /// Goes on with the edges that are touched at the next step. Returns the first one that was not touched all the time. An
    /// edge that continues one of them counts as the same: a line whose end meets one of its ends within a metre, or a sidewalk
    /// whose outline meets its outline; both must be boundaries, or both medians.
    pub fn follow(&mut self, touched: &[u32], map: &Map) -> Option<u32> {
        if touched.is_empty() || self.0.is_empty() {
            self.0.clear();
            return touched.first().copied();
        }
        let now: HashSet<u32> = touched.iter().copied().collect();
        self.0.retain(|edge| now.contains(edge));
        let mut since: HashSet<u32> = self.0.iter().copied().collect();
        if now.len() > since.len() {
            let mut joints = Joints { map, cells: HashMap::new() };
            self.0.iter().for_each(|edge| joints.add(*edge));
            for edge in touched {
                if !since.contains(edge) && joints.meet(*edge) {
                    since.insert(*edge);
                    self.0.push(*edge);
                    joints.add(*edge);
                }
            }
        }
        touched.iter().copied().find(|edge| !since.contains(edge))
    }
}

/// Where edges can be continued, in cells of [`JOINED`]: a car that is wider than a road may touch thousands.
struct Joints<'m> {
    map: &'m Map,
    cells: HashMap<[i64; 2], Vec<(Point, [bool; 2])>>,
}

impl Joints<'_> {
    /// The ends of a line, or the outline of a sidewalk, and the kind: edges of two kinds do not continue each other.
    fn of(&self, edge: u32) -> (impl Iterator<Item = Point>, [bool; 2]) {
        let feature = &self.map.features[edge as usize];
        let points = self.map.points_of(feature);
        let is_area = self.map.is_sidewalk_area(feature);
        let step = if is_area { 1 } else { points.len().saturating_sub(1).max(1) };
        (points.iter().step_by(step).map(|[x, y, _]| [*x, *y]), [feature.kind.is_boundary(), is_area])
    }

    fn add(&mut self, edge: u32) {
        let (points, kind) = self.of(edge);
        for point in points.collect::<Vec<_>>() {
            self.cells.entry(cell(point)).or_default().push((point, kind));
        }
    }

    /// Whether an edge continues one of them.
    fn meet(&self, edge: u32) -> bool {
        let (mut points, kind) = self.of(edge);
        points.any(|point| {
            let [i, j] = cell(point);
            let near = (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| [i, j]));
            let mut all = near.filter_map(|cell| self.cells.get(&cell)).flatten();
            all.any(|(other, of)| *of == kind && distance(*other, point) <= JOINED)
        })
    }
}

fn cell(point: Point) -> [i64; 2] {
    point.map(|x| (x / JOINED).floor() as i64)
}

/// First frame, and edge, at which the ego's recording leaves the road, up to frame 90: the map lacks an entrance there, or
/// its edges are misplaced.
pub fn recording_off_road(scene: &Scene, index: &SceneIndex) -> Option<(usize, u32)> {
    let ego = scene.ego();
    let last = (NOW + HORIZON).min(scene.frames.saturating_sub(1));
    let mut valid = (0..=last).filter(|frame| ego.is_valid(*frame));
    let mut since = EdgesSinceStart::new(&touched(ego, valid.next()?, index));
    valid.find_map(|frame| Some((frame, since.follow(&touched(ego, frame, index), index.map())?)))
}

/// Edges that a track's box touches at a frame, and sidewalks that it is on.
fn touched(track: &Track, frame: usize, index: &SceneIndex) -> Vec<u32> {
    let (edges, sidewalks, area) = (index.edges(), index.sidewalks(), track.oriented_box(frame));
    let bounds = area.aabb();
    let is_level = |height: f64| is_one_level(height, track.ground(frame)) || !index.has_levels(LEVEL_GAP);
    let (mut found, mut known): (Vec<u32>, HashSet<u32>) = Default::default();
    for segment in edges.near(&bounds.grown(EDGE_WIDTH)).flat_map(|run| &edges.segments()[run]) {
        let [dx, dy] = sub(segment.b, segment.a);
        let edge =
            OrientedBox::new(segment.at(0.5), dy.atan2(dx), distance(segment.a, segment.b), EDGE_WIDTH);
        if !known.contains(&segment.feature)
            && edge.intersects(&area)
            && is_level(segment.height(segment.nearest_share(area.center)))
        {
            known.insert(segment.feature);
            found.push(segment.feature);
        }
    }
    if !sidewalks.is_empty() {
        let near = sidewalks.near(&bounds).into_iter();
        let on = near.filter(|k| is_level(sidewalks.height(*k)) && sidewalks.meets(*k, &area));
        for feature in on.map(|k| sidewalks.feature(k)) {
            if known.insert(feature) {
                found.push(feature);
            }
        }
    }
    found
}
