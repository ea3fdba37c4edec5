//! The lanes of a scene that become roads.

use std::collections::HashMap;

use sage_core::scene::{Lane, Map, MapKind};

use super::{center_line::CenterLine, width};

/// Length of the shortest lane that is written, metres.
const SHORTEST: f64 = 0.2;

/// A lane on its way into the file.
pub(super) struct RoadLane<'s> {
    /// Index of the lane in [`Map::features`].
    pub(super) feature: usize,
    pub(super) kind: &'s MapKind,
    pub(super) recorded: &'s Lane,
    pub(super) line: CenterLine,
    /// Width to the left and to the right of the centre line at the start, metres.
    pub(super) start: [f64; 2],
    /// The same at the end; between them the width is linear.
    pub(super) end: [f64; 2],
    /// Lane that this one continues, joined directly.
    pub(super) previous_road: Option<usize>,
    /// Lane that continues this one, joined directly.
    pub(super) next_road: Option<usize>,
    /// Junction that leads into this lane.
    pub(super) previous_junction: Option<usize>,
    /// Junction that this lane leads into.
    pub(super) next_junction: Option<usize>,
}

/// The lanes that are long enough, in the order of the map, and their indices by feature.
pub(super) fn collect<'s>(
    map: &'s Map,
    origin: [f64; 3],
    notes: &mut Vec<String>,
) -> (Vec<RoadLane<'s>>, HashMap<usize, usize>) {
    let (mut lanes, mut written) = (Vec::new(), HashMap::new());
    for (index, feature) in map.features.iter().enumerate() {
        let (true, Some(recorded)) = (feature.kind.is_lane(), feature.lane.as_deref()) else { continue };
        let line = CenterLine::new(map.points_of(feature), origin).filter(|line| line.length() >= SHORTEST);
        let Some(line) = line else {
            notes.push(format!("lane `{}`: left out, shorter than {SHORTEST} m", feature.id));
            continue;
        };
        let halves = width::halves(recorded, feature.kind == MapKind::LaneBike);
        written.insert(index, lanes.len());
        lanes.push(RoadLane {
            feature: index,
            kind: &feature.kind,
            recorded,
            line,
            start: halves,
            end: halves,
            previous_road: None,
            next_road: None,
            previous_junction: None,
            next_junction: None,
        });
    }
    (lanes, written)
}
