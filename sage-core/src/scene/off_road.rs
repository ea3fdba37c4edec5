//! Leaving the road: edges that something touches, apart from those that it touches at its start.

use super::{LEVEL_GAP, Map, Scene, SceneIndex, Track, is_one_level};
use crate::{
    geometry::{OrientedBox, distance, sub},
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
    /// edge that continues one of them counts as the same.
    pub fn follow(&mut self, touched: &[u32], map: &Map) -> Option<u32> {
        self.0.retain(|edge| touched.contains(edge));
        for edge in touched {
            let continues = |other: &u32| map.is_continued(*other as usize, *edge as usize);
            if !self.0.contains(edge) && self.0.iter().any(continues) {
                self.0.push(*edge);
            }
        }
        touched.iter().copied().find(|edge| !self.0.contains(edge))
    }
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
    let mut found: Vec<u32> = Vec::new();
    for segment in edges.near(&bounds.grown(EDGE_WIDTH)).flat_map(|run| &edges.segments()[run]) {
        let [dx, dy] = sub(segment.b, segment.a);
        let edge =
            OrientedBox::new(segment.at(0.5), dy.atan2(dx), distance(segment.a, segment.b), EDGE_WIDTH);
        if !found.contains(&segment.feature)
            && edge.intersects(&area)
            && is_level(segment.height(segment.nearest_share(area.center)))
        {
            found.push(segment.feature);
        }
    }
    if !sidewalks.is_empty() {
        let near = sidewalks.near(&bounds).into_iter();
        let on = near.filter(|k| is_level(sidewalks.height(*k)) && sidewalks.meets(*k, &area));
        for feature in on.map(|k| sidewalks.feature(k)) {
            if !found.contains(&feature) {
                found.push(feature);
            }
        }
    }
    found
}
