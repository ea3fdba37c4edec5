//! Road edges whose heights cannot be true: some files write them at height 0 under a road that is tens of metres up.

use std::{
    collections::{HashMap, HashSet},
    sync::Arc,
};

use sage_core::{
    geometry::distance,
    scene::{MapKind, Scene, is_one_level},
};

use super::Repair;

/// Distance in the plane within which an edge is beside a lane or a road user, metres.
const BESIDE: f64 = 15.0;
/// What the note says.
const NOTE: &str = "all road edges beside the lanes are more than 3 m above or below them, so their heights cannot be true; \
                    they are left out, and off road is not measured";

/// Leaves edges out that are beside lanes and road users in the plane and at another height everywhere: as features that are
/// no edges.
pub(super) fn leave_out(scene: &mut Scene) {
    let map = &scene.map;
    let edges = || map.features.iter().filter(|feature| feature.kind.is_edge());
    let points = || edges().flat_map(|feature| map.points_of(feature));
    if points().next().is_none() {
        return;
    }
    // Nearly every scene has an edge at the ego's height beside it.
    let ego = scene.ego();
    let (here, ground) = (ego.point(sage_core::motion::NOW), ego.ground(sage_core::motion::NOW));
    if points().any(|[x, y, z]| is_one_level(*z, ground) && distance([*x, *y], here) <= 2.0 * BESIDE) {
        return;
    }
    let cell = |x: f64, y: f64| [x, y].map(|at| (at / BESIDE).floor() as i64);
    let mut heights: HashMap<[i64; 2], Vec<f64>> = HashMap::new();
    let mut known: HashSet<([i64; 2], i64)> = HashSet::new();
    let mut add = |x: f64, y: f64, z: f64| {
        let cell = cell(x, y);
        if known.insert((cell, z.floor() as i64)) {
            heights.entry(cell).or_default().push(z);
        }
    };
    let lanes = map.features.iter().filter(|feature| feature.kind.is_motor_lane());
    lanes.flat_map(|feature| map.points_of(feature)).for_each(|[x, y, z]| add(*x, *y, *z));
    for track in &scene.tracks {
        for frame in (0..track.valid.len()).filter(|frame| track.valid[*frame]) {
            let [x, y] = track.point(frame);
            add(x, y, track.ground(frame));
        }
    }
    heights.values_mut().for_each(|all| all.sort_by(f64::total_cmp));
    // The height nearest to one of a cell, in order.
    let nearest = |all: &[f64], z: f64| {
        let k = all.partition_point(|height| *height < z);
        let beside = [k.checked_sub(1), Some(k)].into_iter().flatten().filter_map(|k| all.get(k)).copied();
        beside.min_by(|a, b| (a - z).abs().total_cmp(&(b - z).abs()))
    };
    let (mut is_beside, mut is_level) = (false, false);
    for [x, y, z] in points() {
        let [i, j] = cell(*x, *y);
        let near = (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| [i, j]));
        for height in near.filter_map(|cell| nearest(heights.get(&cell)?, *z)) {
            is_beside = true;
            is_level |= is_one_level(*z, height);
        }
        if is_level {
            return;
        }
    }
    if !is_beside {
        return;
    }
    for feature in &mut Arc::make_mut(&mut scene.map).features {
        if feature.kind.is_edge() {
            feature.kind = MapKind::Other(feature.kind.name().to_owned());
        }
    }
    let note = Repair::MapValues.note(NOTE);
    if !scene.notes.contains(&note) {
        scene.notes.push(note);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

    use super::*;
    use crate::procedural::{Kind, generate};

    #[test]
    fn edges_stay_where_other_lanes_or_road_users_have_their_height() {
        let mut scene = generate(Kind::Straight, 0, 0).unwrap();
        let ego = scene.ego;
        scene.tracks[ego].position.iter_mut().for_each(|position| position[2] += 10.0);
        leave_out(&mut scene);
        assert!(scene.map.has_edges(), "the ego alone is on another level");
        let map = Arc::make_mut(&mut scene.map);
        for feature in map.features.iter().filter(|feature| feature.kind.is_edge()) {
            map.points[feature.points.clone()].iter_mut().for_each(|point| point[2] -= 30.0);
        }
        leave_out(&mut scene);
        assert!(!scene.map.has_edges());
    }
}
