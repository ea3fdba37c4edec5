//! A canonical order of the features of a map.
//!
//! Equal distances are frequent in maps: lanes begin at one point, and lines touch. The first feature then wins, in
//! features, routes and searches. If the file's order decided, another order of the same file would give another attack.

use std::cmp::Ordering;

use super::{Map, MapFeature};
use crate::text::natural_order;

impl Map {
    /// The map with its features by id: numbers within ids by value, so `lane_9` is before `lane_10`. Waymo's files have
    /// this order already.
    pub fn in_order_of_ids(self) -> Self {
        if self.features.is_sorted_by(|a, b| by_id(a, b).is_le()) {
            return self;
        }
        let Self { points, mut features } = self;
        let mut order: Vec<usize> = (0..features.len()).collect();
        order.sort_by(|a, b| by_id(&features[*a], &features[*b]));
        let mut place = vec![0; order.len()];
        for (new, old) in order.iter().enumerate() {
            place[*old] = new;
        }
        let mut sorted = Self { points: Vec::with_capacity(points.len()), features: Vec::new() };
        for old in order {
            let vacant =
                MapFeature { id: String::new(), kind: features[old].kind.clone(), points: 0..0, lane: None };
            let mut feature = std::mem::replace(&mut features[old], vacant);
            let first = sorted.points.len();
            sorted.points.extend_from_slice(&points[feature.points.clone()]);
            feature.points = first..sorted.points.len();
            if let Some(lane) = feature.lane.as_deref_mut() {
                let neighbors = lane.neighbors.iter_mut().flatten().map(|neighbor| &mut neighbor.lane);
                let boundaries = lane.boundaries.iter_mut().flatten().map(|boundary| &mut boundary.feature);
                let links = lane.entries.iter_mut().chain(&mut lane.exits).chain(&mut lane.stop_signs);
                for link in links.chain(neighbors).chain(boundaries) {
                    // A link to nothing stays one.
                    *link = place.get(*link).copied().unwrap_or(*link);
                }
            }
            sorted.features.push(feature);
        }
        sorted
    }
}

fn by_id(a: &MapFeature, b: &MapFeature) -> Ordering {
    natural_order(&a.id, &b.id)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Boundary, Lane, MapKind, Neighbor};

    #[test]
    fn numbers_within_ids_count_by_value() {
        let sorted =
            ["", "2", "02", "10", "a", "lane_9", "lane_9b", "lane_10", "lane_10_1", "lane_10_12", "lane_b"];
        let feature =
            |id: &str| MapFeature { id: id.into(), kind: MapKind::StopSign, points: 0..0, lane: None };
        for (k, a) in sorted.iter().enumerate() {
            for (other, b) in sorted.iter().enumerate() {
                let [a, b] = [feature(a), feature(b)];
                // `02` is the number 2, and as a text before it.
                let expected =
                    if [k, other] == [1, 2] || [k, other] == [2, 1] { other.cmp(&k) } else { k.cmp(&other) };
                assert_eq!(by_id(&a, &b), expected, "{} and {}", a.id, b.id);
            }
        }
    }

    #[test]
    fn every_order_of_a_file_gives_the_same_map() {
        let names = ["7", "12", "3"];
        // The map that lists its features in some order; each links to all others by name.
        let map = |order: [usize; 3]| {
            let mut map = Map::default();
            let place = |name: usize| order.iter().position(|other| *other == name).unwrap();
            for name in order {
                let first = map.points.len();
                map.points.extend((0..=name).map(|k| [name as f64, k as f64, 0.0]));
                let other = place((name + 1) % 3);
                let lane = Lane {
                    entries: vec![other],
                    exits: vec![place(name), other],
                    stop_signs: vec![other],
                    neighbors: [vec![Neighbor { lane: other, own: [0, 0], other: [0, 0] }], Vec::new()],
                    boundaries: [Vec::new(), vec![Boundary { feature: other, own: [0, 0] }]],
                    ..Lane::default()
                };
                let (id, points) = (names[name].to_owned(), first..map.points.len());
                map.features.push(MapFeature {
                    id,
                    kind: MapKind::LaneFreeway,
                    points,
                    lane: Some(lane.into()),
                });
            }
            map
        };
        let sorted = map([2, 0, 1]);
        for order in [[0, 1, 2], [1, 0, 2], [1, 2, 0], [2, 1, 0], [0, 2, 1], [2, 0, 1]] {
            assert_eq!(map(order).in_order_of_ids(), sorted);
        }
        assert_eq!(sorted.features[0].id, "3");
        assert_ne!(map([0, 1, 2]), sorted);
    }
}
